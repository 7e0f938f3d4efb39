"""Deliveries in disorder: late, twice, broken, and in any order."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.support.store_checks import Contents

BROKEN = 0.15
TWICE = 0.2
"""Shares of the files that come broken before they come whole, and that come once more."""


def deliveries(
    downlink: Path, folder: Path, count: int, rng: np.random.Generator
) -> Iterator[Path]:
    """The files of a downlink in a number of folders, in any order.

    Some come twice, some broken at first: cut off, empty, or with text that is not a label. Files
    that never come whole are among them. What is broken is delivered before or with what is whole,
    in a folder of its own, so that the whole file comes last.
    """
    files = sorted(
        file for file in downlink.rglob("*") if file.is_file() and "truth" not in file.parts
    )
    turn = rng.integers(0, count, len(files))
    folders = [folder / f"{number:02d}" for number in range(count)]
    for file, first in zip(files, turn, strict=True):
        name = file.relative_to(downlink)
        _deliver(file, folders[first] / name)
        if rng.random() < TWICE:
            _deliver(file, folders[int(rng.integers(first, count))] / "again" / name)
        if first and rng.random() < BROKEN:
            data = broken(file.read_bytes(), rng)
            target = folders[int(rng.integers(0, first))] / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
    for number, one in enumerate(folders):
        one.mkdir(exist_ok=True)
        (one / f"2n14{number:07d}eff1000p1500l0m1.img").write_bytes(rng.bytes(3000))
        yield one


def broken(data: bytes, rng: np.random.Generator) -> bytes:
    """A file as a bad link leaves it."""
    damaged = (data[: len(data) // 2], b"", data[:200], rng.bytes(len(data)))
    return damaged[int(rng.integers(len(damaged)))]


def _deliver(file: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(file, target)


def published(contents: Contents) -> dict[str, dict[str, object]]:
    """The latest products of the catalogue, and how every sol ended; files' outcomes left out."""
    rows = contents.rows
    latest = {f"{key}/{digest}": key for key, digest in rows["latest"].items()}
    layers = {key: row for key, row in rows["layers"].items() if key in latest}
    outcomes = {key: row for key, row in rows["outcomes"].items() if "-sol" in key}
    bytes_of = {
        name: digest
        for name, digest in contents.products.items()
        if "/".join((*name.split("/")[1::-1], Path(name).name.split(".")[0])) in latest
    }
    return {
        "missions": rows["missions"],
        "images": rows["images"],
        "latest": rows["latest"],
        "layers": layers,
        "outcomes": outcomes,
        "bytes": dict(bytes_of),
    }


def differences(one: Contents, other: Contents) -> list[str]:
    """What two catalogues publish differently, a line each."""
    first, second = published(one), published(other)
    return [
        f"{table}: {key}: {first[table].get(key)} | {second[table].get(key)}"
        for table in first
        for key in sorted(first[table].keys() | second[table].keys())
        if first[table].get(key) != second[table].get(key)
    ]
