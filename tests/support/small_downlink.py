"""Downlinks small enough to be processed hundreds of times: thumbnails and coarse maps.

The images are those of a simulated traverse averaged over 4 x 4 pixels, as the rovers sent them
when the link was short; the pipeline maps them with cells of decimetres. Every stage takes part.
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
import tempfile
from functools import cache
from pathlib import Path

from solmap.photogrammetry.synthetic.downlink import simulate_downlink
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / ".cache" / "small_downlinks"
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
    """Write a traverse of one stop a sol, two or three metres apart; the folder.

    Rendering takes seconds, so the files are kept for other tests as long as the science stays.
    """
    kept = KEPT / _version() / f"{stops}-{pairs}-{seed}"
    if not kept.is_dir():
        for outdated in set(KEPT.glob("*")) - {kept.parent}:
            shutil.rmtree(outdated, ignore_errors=True)
        kept.parent.mkdir(parents=True, exist_ok=True)
        traverse = TraverseParams(stops=stops, spacing_m=(2.0, 3.0))
        world = WorldParams("hills", traverse, pairs=pairs, averaging=4)
        with tempfile.TemporaryDirectory(dir=kept.parent) as draft:
            for file in simulate_downlink(world, seed):
                path = Path(draft) / kept.name / file.path
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(file.data)
            with contextlib.suppress(OSError):  # another worker was first
                (Path(draft) / kept.name).rename(kept)
    return shutil.copytree(kept, folder, dirs_exist_ok=True)


@cache
def _version() -> str:
    """A digest of all that images of a simulation depend on."""
    files = [ROOT / "requirements.lock", *sorted((ROOT / "photogrammetry").rglob("*.py"))]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def write_coarse_pipeline(path: Path, text: str = COARSE) -> Path:
    """Write the pipeline, or another, to a file; its path."""
    path.write_text(text)
    return path
