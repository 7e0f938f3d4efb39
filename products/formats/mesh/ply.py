"""Point clouds as binary PLY, for CloudCompare, MeshLab, PDAL, Open3D and others.

One row per point, little-endian: x, y, z (east, north, up; metres of the local map, double), red,
green, blue (uchar) and `sigma` (float, metres: standard deviation along the line of sight). PLY has
no field for a frame, so comments in its header name CRS, units and source.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloud
from solmap.products.errors import BrokenProductError

_ROW = np.dtype(
    [
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("sigma", "<f4"),
    ]
)
_TYPES = {"<f8": "double", "|u1": "uchar", "<f4": "float"}
_CHUNK = 1 << 18
"""Rows written together, 8 MB."""
_END = b"end_header\n"
_HEADER = 1 << 16


def write_ply(path: Path, cloud: PointCloud, notes: Mapping[str, Any]) -> None:
    """Write a point cloud; `notes` become comments."""
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {name}: {_one_line(value)}" for name, value in notes.items()]
    lines += [f"element vertex {len(cloud)}"]
    kinds = ((name, _ROW.fields[name][0].str) for name in _ROW.names or ())  # type: ignore[index]
    lines += [f"property {_TYPES[kind]} {name}" for name, kind in kinds]
    with path.open("wb") as file:
        file.write("\n".join(lines).encode("ascii", "replace") + b"\n" + _END)
        for start in range(0, len(cloud), _CHUNK):
            file.write(_rows(cloud, slice(start, start + _CHUNK)).tobytes())


def read_ply(path: Path) -> np.ndarray:
    """The rows of a solmap file, as stored on disk.

    Raises:
        ProductError: it is not such a file.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER)
    end = head.find(_END)
    counts = [line for line in head[: max(end, 0)].split(b"\n") if line.startswith(b"element ver")]
    if end < 0 or not head.startswith(b"ply\n") or len(counts) != 1:
        raise BrokenProductError(f"{path.name} is not a point cloud of solmap")
    count, start = int(counts[0].split()[-1]), end + len(_END)
    if path.stat().st_size != start + count * _ROW.itemsize:
        raise BrokenProductError(f"{path.name} does not contain its {count} points")
    return np.memmap(path, _ROW, "r", offset=start, shape=(count,))


def _rows(cloud: PointCloud, which: slice) -> np.ndarray:
    points = cloud.points[which]
    rows = np.empty(len(points), _ROW)
    rows["x"], rows["y"], rows["z"] = points.T
    for name in ("red", "green", "blue"):
        rows[name] = cloud.grey[which]
    rows["sigma"] = cloud.sigma_m[which]
    return rows


def _one_line(value: Any) -> str:  # noqa: ANN401 - any note
    text = " ".join(str(part) for part in value) if isinstance(value, list) else str(value)
    return " ".join(text.split())
