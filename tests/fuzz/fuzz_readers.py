"""Throw coverage-guided bytes at the readers: their own errors are the only ones allowed.

    python tests/fuzz/fuzz_readers.py TARGET [libFuzzer options] [CORPUS]

With atheris installed (it is no dependency of the project: `pip install atheris` into any venv) the
inputs are guided by the code they reach; -max_total_time, -timeout, -rss_limit_mb and the like are
libFuzzer's. Without atheris the same targets get mutated seeds for `-max_total_time` seconds. An
input that raises anything but a `PhotogrammetryError`, or whose complaint is not one line, ends the
run and is written to a file.
"""

from __future__ import annotations

import contextlib
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

try:
    import atheris
except ImportError:
    atheris = None

with (
    atheris.instrument_imports(include=["photogrammetry"]) if atheris else contextlib.nullcontext()
):
    from photogrammetry.errors import PhotogrammetryError
    from photogrammetry.pds3.detached import with_attached_label
    from photogrammetry.pds3.file_names import parse_file_name
    from photogrammetry.pds3.label import parse_label
    from photogrammetry.pds3.m2020 import camera_of_metadata, rover_image_of_metadata
    from photogrammetry.pds3.pds4 import parse_pds4_label
    from photogrammetry.pds3.pictures import read_picture
    from photogrammetry.pds3.places import parse_localisations
    from photogrammetry.pds3.rasters import read_raster
    from photogrammetry.pds3.reading import read_image
    from photogrammetry.pds3.vector_files import lsl_tree, parse_vector_file, poses
    from photogrammetry.pds3.vicar import parse_vicar_label

NAME = "2n292280938effb100p0703l0m1.img"
SHARED = Path(os.environ.get("SOLMAP_SHARED", ROOT.parent / "shared")) / "data"
MAX_SEED = 60_000


def chain(text: str) -> None:
    """A vector file down to its frame tree."""
    lsl_tree(poses([parse_vector_file(text, "x.svf")]))


def image(data: bytes) -> None:
    """An image with whatever label it starts with."""
    read_image(data, NAME)


def detached(data: bytes) -> None:
    """A label and pixels in two files, cut at a NUL byte."""
    label, _, pixels = data.partition(b"\0")
    read_image(with_attached_label(pixels, label.decode("latin-1"), NAME), NAME)


def text_of(parse: Callable[[str, str], object]) -> Callable[[bytes], None]:
    """A reader of texts, for bytes."""

    def read(data: bytes) -> None:
        parse(data.decode("utf-8", "replace"), "x")

    return read


TARGETS: dict[str, tuple[Callable[[bytes], object], tuple[str, ...]]] = {
    "label": (lambda data: parse_label(data.decode("latin-1"), "x"), ("labels/*.lbl",)),
    "vicar": (lambda data: parse_vicar_label(data, "x"), ("labels/*.vicar_header.txt",)),
    "image": (image, ("labels/*.lbl", "labels/*.vicar_header.txt")),
    "detached": (detached, ("labels/*.LBL",)),
    "raster": (lambda data: read_raster(data, "x.img"), ("labels/*.lbl",)),
    "pds4": (text_of(parse_pds4_label), ("*.xml",)),
    "metadata": (text_of(rover_image_of_metadata), ("m2020*/*.json",)),
    "camera": (text_of(camera_of_metadata), ("m2020*/*.json",)),
    "vectors": (lambda data: chain(data.decode("utf-8", "replace")), ("traverse/*/*.?vf",)),
    "localisations": (text_of(parse_localisations), ("traverse/msl/*.xml",)),
    "picture": (lambda data: read_picture(data, "x.png"), ("terrain_reference/*.png",)),
    "names": (lambda data: parse_file_name(data.decode("latin-1")), ()),
}
"""Name -> reader of bytes, and where seeds are among the shared data."""


def seeds(patterns: tuple[str, ...]) -> list[bytes]:
    """Beginnings of real files, and nothing at all."""
    folders = (SHARED, ROOT / "tests" / "unit" / "pds3")
    paths = [path for pattern in patterns for folder in folders for path in folder.glob(pattern)]
    found = [path.read_bytes()[:MAX_SEED] for path in paths]
    return [b"", NAME.encode(), *found]


def guarded(read: Callable[[bytes], object]) -> Callable[[bytes], None]:
    """The reader, with its own errors taken as answers."""

    def once(data: bytes) -> None:
        try:
            read(data)
        except PhotogrammetryError as error:
            if "\n" in str(error) or not str(error):
                raise AssertionError(f"a complaint is one line: {error!r}") from error

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
    if atheris is None:
        limits = [a for a in options if a.startswith("-max_total_time=")]
        unguided(once, seeds(patterns), float(limits[-1].partition("=")[2]) if limits else 30)
        return
    corpus = Path(tempfile.mkdtemp(prefix=f"fuzz-{arguments[0]}-"))
    for number, seed in enumerate(seeds(patterns)):
        (corpus / f"seed-{number}").write_bytes(seed)
    atheris.Setup([sys.argv[0], *options, str(corpus)], once)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
