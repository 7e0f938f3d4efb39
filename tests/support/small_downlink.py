"""Downlinks small enough to be processed hundreds of times: thumbnails and coarse maps.

The images are those of a simulated traverse averaged over 4 x 4 pixels, as the rovers sent them
when the link was short; the pipeline maps them with cells of decimetres. Every stage takes part.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from solmap.photogrammetry.synthetic.downlink import DownlinkFile, simulate_downlink
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / ".cache" / "downlinks"
COARSE = """\
[dtm]
cell_m = 0.16
[orthophoto]
cell_m = 0.16
[region.fusion]
cell_m = 0.16
[wide]
enabled = true
[models]
dips_of_facets = true
"""
"""A pipeline of all stages, on cells that thumbnails fill."""
FEW_LAYERS = """\
[dtm]
cell_m = 0.32
[orthophoto]
cell_m = 0.32
[region.fusion]
cell_m = 0.32
[wide]
enabled = true
[panoramas]
enabled = false
[models]
of_terrain = false
of_views = false
of_points = false
"""
"""The same without models and panoramas, for many sols."""


def write_small_downlink(folder: Path, *, stops: int = 2, pairs: int = 3, seed: int = 3) -> Path:
    """Write a traverse of one stop a sol, two or three metres apart; the folder."""
    traverse = TraverseParams(stops=stops, spacing_m=(2.0, 3.0))
    world = WorldParams("hills", traverse, pairs=pairs, averaging=4)
    return shutil.copytree(kept(_simulate, world, seed), folder, dirs_exist_ok=True)


def rendered_images(params: WorldParams, seed: int) -> list[DownlinkFile]:
    """The images of a simulated downlink, in the order of their names."""
    folder = kept(_simulate, params, seed)
    paths = sorted(folder.rglob("*.img"))
    return [DownlinkFile(str(path.relative_to(folder)), path.read_bytes()) for path in paths]


def kept(write: Callable[[Path, WorldParams, int], object], params: WorldParams, seed: int) -> Path:
    """The folder that `write` makes and fills for a world, to be copied.

    Rendering takes seconds, so the files are kept for other tests as long as the science and the
    module of `write` stay.
    """
    of_what = Path(inspect.getfile(write)).read_text(), write.__name__, params, seed
    name = hashlib.sha256(repr(of_what).encode()).hexdigest()[:16]
    folder = KEPT / _version() / name
    if not folder.is_dir():
        for outdated in set(KEPT.glob("*")) - {folder.parent}:
            shutil.rmtree(outdated, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as draft:
            write(Path(draft) / name, params, seed)
            with contextlib.suppress(OSError):  # another worker was first
                (Path(draft) / name).rename(folder)
    return folder


def _simulate(folder: Path, params: WorldParams, seed: int) -> None:
    for file in simulate_downlink(params, seed):
        path = folder / file.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.data)


@cache
def _version() -> str:
    """A digest of all that files of a simulation depend on."""
    packages = (ROOT / "photogrammetry", ROOT / "products" / "formats" / "raster")
    files = [file for package in packages for file in sorted(package.rglob("*.py"))]
    files += [ROOT / "requirements.lock", ROOT / "tasks" / "images" / "pairs.py"]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def write_coarse_pipeline(path: Path, text: str = COARSE) -> Path:
    """Write the pipeline, or another, to a file; its path."""
    path.write_text(text)
    return path
