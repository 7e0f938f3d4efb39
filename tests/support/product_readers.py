"""Readers of products that only tests read back: the inverses of what writes them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from pyproj import CRS

from solmap.photogrammetry.arrays import Classes, Raster
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.formats.raster.raster import class_names, grid_of, open_raster, values_in

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
HEADER = 80


def crs_of(path: Path) -> CRS:
    """The CRS that a raster carries."""
    with open_raster(path) as dataset:
        return CRS.from_wkt(dataset.crs.to_wkt(version="WKT2_2019"))


def read_orthophoto(path: Path) -> tuple[MapGrid, Raster]:
    """Brightness as `write_orthophoto` was given it, to half a grey step; NaN where unseen."""
    with open_raster(path) as dataset:
        grey = dataset.read(1)
        brightness = grey.astype(np.float32) * dataset.scales[0] + dataset.offsets[0]
        return grid_of(dataset), np.where(grey > 0, brightness, np.nan).astype(np.float32)


def read_sources(path: Path) -> tuple[MapGrid, Classes, tuple[str, ...]]:
    """What `write_sources` was given."""
    with open_raster(path) as dataset:
        return grid_of(dataset), dataset.read(1), tuple(class_names(dataset).values())


def read_stl(data: bytes) -> np.ndarray:
    """The corners of the triangles of a binary STL: n by 3 by 3."""
    (count,) = struct.unpack_from("<I", data, HEADER)
    assert len(data) == HEADER + 4 + count * FACET.itemsize
    corners: np.ndarray = np.frombuffer(data, FACET, count, HEADER + 4)["corners"]
    return corners


def values_at(path: Path, east: float, north: float) -> dict[str, float] | None:
    """True values of every band of a raster at a place."""
    with open_raster(path) as dataset:
        return values_in(dataset, east, north)
