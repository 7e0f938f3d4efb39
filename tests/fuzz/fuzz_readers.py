"""Throw coverage-guided bytes at the readers: their own errors are the only ones allowed.

    python tests/fuzz/fuzz_readers.py TARGET [libFuzzer options] [CORPUS]

With atheris installed (it is not a dependency of the project: `pip install atheris` into any venv)
the inputs are guided by the code they reach; -max_total_time, -timeout, -rss_limit_mb and the like
are libFuzzer's. Without atheris the same targets get mutated seeds for `-max_total_time` seconds.
An input that raises anything but a `PhotogrammetryError`, or whose message is not one line, ends
the run and is written to a file.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

try:
    import atheris
except ImportError:
    atheris = None

with (
    atheris.instrument_imports(include=["photogrammetry"]) if atheris else contextlib.nullcontext()
):
    from solmap.photogrammetry.archive.file_names import parse_file_name
    from solmap.photogrammetry.archive.images.derived_rasters import read_raster
    from solmap.photogrammetry.archive.images.json_metadata import (
        camera_of_metadata,
        rover_image_of_metadata,
    )
    from solmap.photogrammetry.archive.images.pixels import read_image_file
    from solmap.photogrammetry.archive.images.reading import read_image
    from solmap.photogrammetry.archive.labels.detached import join_label
    from solmap.photogrammetry.archive.labels.label import parse_label
    from solmap.photogrammetry.archive.labels.pds4 import parse_pds4_label
    from solmap.photogrammetry.archive.labels.vicar import parse_vicar_label
    from solmap.photogrammetry.archive.tables.places import parse_localisations
    from solmap.photogrammetry.archive.tables.vector_files import (
        best_poses,
        lsl_tree,
        parse_vector_file,
    )
    from solmap.photogrammetry.archive.times import time_text
    from solmap.photogrammetry.errors import PhotogrammetryError
    from solmap.products.formats.documents.edit_requests import parse_edit_requests

NAME = "2n292280938effb100p0703l0m1.img"
SHARED = Path(os.environ.get("SOLMAP_SHARED", ROOT.parent / "shared")) / "data"
MAX_SEED = 60_000


def small_image() -> bytes:
    """The complete image of a few pixels that the unit tests change."""
    path = ROOT / "tests" / "unit" / "archive" / "conftest.py"
    spec = importlib.util.spec_from_file_location("small_image", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path} is not there")
    module = importlib.util.module_from_spec(spec)
    sys.modules["small_image"] = module
    spec.loader.exec_module(module)
    pixels = module.np.arange(1, 2401).reshape(40, 60)
    return module.SmallImage(pixels).data


def small_raster() -> bytes:
    """The same as a range raster."""
    data = small_image()
    group = b"GROUP = DERIVED_IMAGE_PARMS\n DERIVED_IMAGE_TYPE = RANGE_MAP\nEND_GROUP\n"
    label, pixels = data[:4096].rstrip(), data[4096:]
    label = label.replace(b"OBJECT  ", group + b"OBJECT  ", 1)
    label = label.replace(b"MSB_INTEGER", b"IEEE_REAL").replace(b"= 16", b"= 32")
    label = label.replace(b"= 9\n", b"= 11\n")
    return label.ljust(5120) + pixels + pixels


def small_joined() -> list[bytes]:
    """Data joined to a label of each kind."""
    xml = (
        ROOT / "tests" / "unit" / "archive" / "labels" / "navcam_of_perseverance.xml"
    ).read_bytes()
    vectors = "(1,0,0);(0,1,0);(9,0,5);(0,9,5);(0,1,0);(0,0,0)"
    metadata = {
        "sol": 1,
        "instrument": "NAVCAM_LEFT",
        "sclk": 1.5,
        "dimension": "(3,2)",
        "site": 1,
        "drive": 2,
        "xyz": "(1,2,3)",
        "attitude": "(1,0,0,0)",
        "camera_model_type": "CAHVOR",
        "camera_model_component_list": vectors,
    }
    png = cv2.imencode(".png", np.full((2, 3), 7, np.uint8))[1].tobytes()
    return [
        join_label(small_image()[:4096].rstrip(), small_image(), NAME),
        join_label(xml, bytes(range(1, 35)), NAME),
        join_label(json.dumps(metadata).encode(), png, NAME),
    ]


def vicar(data: bytes) -> None:
    """A VICAR label as it stands, and behind system items that are whole."""
    head = b"LBLSIZE=%d FORMAT='HALF' NL=4 NS=5 NB=1 RECSIZE=10 N2=4 N3=1 " % (len(data) + 70)
    with contextlib.suppress(PhotogrammetryError):
        parse_vicar_label(data, "x")
    parse_vicar_label(head.ljust(70) + data, "x")


PLACES = (
    b"frame,site,drive,pose,landing_x,landing_y,landing_z,quat_s,quat_v1,quat_v2,quat_v3\n"
    b"SITE,3,-1,-1,10.5,-4.25,0.5,1,0,0,0\nROVER,3,308,2,12.5,-1.25,0.75,0.8,0,0,0.6\n"
)
LOCATIONS = (
    b"<msl><location><site>0</site><drive>0</drive><x>1</x><y>2</y><z>0</z><lat>-4.6</lat>"
    b"<rot>0,0,0,1</rot></location><location><site>1</site><drive>8</drive><x>3</x><y>2</y>"
    b"<z>0</z><lat>-4.6</lat><rot>0,0,0.6,0.8</rot></location></msl>"
)
TIES_CSV = (
    b"action,first_image,first_sample,first_line,second_image,second_sample,second_line,note\n"
    b'add,2N1,10.5,7,2N2,11,7.25,"by hand"\nveto,2N1,,,mer2-site0010-drive0064,,,\n'
)
TIES_GEOJSON = (
    b'{"features": [{"properties": {"action": "move", "first_image": "A", "first_sample": 1,'
    b' "first_line": 2, "second_image": "B", "second_sample": 3, "second_line": 1e4}}]}'
)
SMALL: dict[str, Callable[[], list[bytes]]] = {
    "vicar": lambda: [b"PROPERTY='A' B=(1,'it''s') B__UNIT=('m','') EOL=1 LBLSIZE=9 C='x' "],
    "image": lambda: [small_image()],
    "detached": lambda: [small_image()[:4096].rstrip() + b"\0" + small_image(), *small_joined()],
    "raster": lambda: [small_raster()],
    "localisations": lambda: [PLACES, LOCATIONS],
    "times": lambda: [b"2004-162T08:00:36.816Z", b"2005-12-31T23:59:60", b"UNK"],
    "ties": lambda: [TIES_CSV, TIES_GEOJSON],
}
"""Seeds that are whole: real files are cut off, which XML does not forgive."""


def chain(text: str) -> None:
    """A vector file down to its frame tree."""
    lsl_tree(best_poses([parse_vector_file(text, "x.svf")]))


def image(data: bytes) -> None:
    """An image with whatever label it starts with."""
    read_image(data, NAME)


def detached(data: bytes) -> None:
    """A label and pixels in two files, cut at a NUL byte."""
    label, _, pixels = data.partition(b"\0")
    read_image(join_label(label, pixels, NAME), NAME)
    read_image(data, NAME)


def text_of(parse: Callable[[str, str], object]) -> Callable[[bytes], None]:
    """A reader of texts, for bytes."""

    def read(data: bytes) -> None:
        parse(data.decode("utf-8", "replace"), "x")

    return read


TARGETS: dict[str, tuple[Callable[[bytes], object], tuple[str, ...]]] = {
    "label": (lambda data: parse_label(data.decode("latin-1"), "x"), ("labels/*.lbl",)),
    "vicar": (vicar, ("labels/*.vicar_header.txt",)),
    "image": (image, ("labels/*.lbl", "labels/*.vicar_header.txt")),
    "detached": (detached, ("labels/*.LBL",)),
    "raster": (lambda data: read_raster(data, "x.img"), ("labels/*.lbl",)),
    "pds4": (text_of(parse_pds4_label), ("*.xml",)),
    "metadata": (text_of(rover_image_of_metadata), ("m2020*/*.json",)),
    "camera": (text_of(camera_of_metadata), ("m2020*/*.json",)),
    "vectors": (lambda data: chain(data.decode("utf-8", "replace")), ("traverse/*/*.?vf",)),
    "localisations": (text_of(parse_localisations), ("traverse/msl/*.xml",)),
    "picture": (lambda data: read_image_file(data, "x.png"), ("terrain_reference/*.png",)),
    "names": (lambda data: parse_file_name(data.decode("latin-1")), ()),
    "times": (lambda data: time_text(data.decode("latin-1")), ()),
    "ties": (text_of(parse_edit_requests), ()),
}
"""Name -> reader of bytes, and where seeds are among the shared data."""


def seeds(patterns: tuple[str, ...], whole: list[bytes]) -> list[bytes]:
    """Beginnings of real files, whole small ones, and nothing at all."""
    folders = (SHARED, ROOT / "tests" / "unit" / "archive" / "labels")
    paths = [path for pattern in patterns for folder in folders for path in folder.glob(pattern)]
    found = [path.read_bytes()[:MAX_SEED] for path in paths]
    return [b"", NAME.encode(), *found, *whole]


def guarded(read: Callable[[bytes], object]) -> Callable[[bytes], None]:
    """The reader, with its own errors taken as answers."""

    def once(data: bytes) -> None:
        try:
            read(data)
        except PhotogrammetryError as error:
            if "\n" in str(error) or not str(error):
                raise AssertionError(f"a message is one line: {error!r}") from error

    return once


def mutated(seed: bytes, chance: random.Random) -> bytes:
    """A seed with pieces changed, moved, doubled and cut."""
    data = bytearray(seed)
    for _ in range(chance.randint(1, 12)):
        if not data:
            return bytes(chance.randrange(256) for _ in range(chance.randrange(60)))
        at, size = chance.randrange(len(data)), chance.choice((1, 1, 2, 8, 64, 512))
        change = chance.randrange(4)
        if change == 0:
            data[at] = chance.randrange(256)
        elif change == 1:
            del data[at : at + size]
        elif change == 2:
            data[at:at] = data[at : at + size]
        else:
            other = chance.randrange(len(data))
            data[at : at + size] = data[other : other + size]
    return bytes(data)


def unguided(once: Callable[[bytes], None], start: list[bytes], seconds: float) -> None:
    """Mutated seeds for some time, where atheris is not installed."""
    chance = random.Random(2004)  # noqa: S311 - no secrets
    count, longest, until = 0, 0.0, time.monotonic() + seconds
    while time.monotonic() < until:
        data = mutated(chance.choice(start), chance)
        began = time.monotonic()
        try:
            once(data)
        except BaseException:
            crash = Path(tempfile.gettempdir()) / f"crash-{count}"
            crash.write_bytes(data)
            sys.stderr.write(f"crash: {crash}\n")
            raise
        longest = max(longest, time.monotonic() - began)
        count += 1
    sys.stdout.write(f"{count} inputs, 0 crashes, the slowest took {longest:.3f} s\n")


def main(arguments: list[str]) -> None:
    """Fuzz one target."""
    if not arguments or arguments[0] not in TARGETS:
        raise SystemExit(f"usage: fuzz_readers.py {'|'.join(TARGETS)} [-max_total_time=S] ...")
    read, patterns = TARGETS[arguments[0]]
    once, options = guarded(read), arguments[1:]
    start = seeds(patterns, SMALL.get(arguments[0], list)())
    if atheris is None:
        limits = [a for a in options if a.startswith("-max_total_time=")]
        unguided(once, start, float(limits[-1].partition("=")[2]) if limits else 30)
        return
    corpus = Path(tempfile.mkdtemp(prefix=f"fuzz-{arguments[0]}-"))
    for number, seed in enumerate(start):
        (corpus / f"seed-{number}").write_bytes(seed)
    atheris.Setup([sys.argv[0], *options, str(corpus)], once)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
