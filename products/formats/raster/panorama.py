"""Panoramas on disk: an image in azimuth and elevation, and the ground at its pixels.

The panorama is a GeoTIFF whose "map" is the sphere of directions: x is azimuth clockwise from
north, y elevation above the horizon, both in degrees, with its own CRS. Its companion is four times
as coarse and contains, for each direction, the distance to the ground (NaN for sky and for unknown
ground) and the number of the source image.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from pyproj import CRS

from solmap.photogrammetry.arrays import Float32, Vector3
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.orthophoto.mosaic import NO_SOURCE
from solmap.photogrammetry.terrain.orthophoto.panorama import Panorama, PanoramaBlock
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import NODE, AngleGrid
from solmap.photogrammetry.terrain.orthophoto.panorama_seams import Registration
from solmap.products.errors import BrokenProductError
from solmap.products.formats.raster.orthophoto import BrightnessBlock, write_brightness_blocks
from solmap.products.formats.raster.raster import open_raster, write_raster

ANGLES = CRS.from_wkt(
    'ENGCRS["Azimuth and elevation",EDATUM["Projection centre of a panorama"],CS[Cartesian,2],'
    'AXIS["azimuth (az)",east],AXIS["elevation (el)",north],'
    'ANGLEUNIT["degree",0.0174532925199433]]'
)
_TAG = "PANORAMA"
_NEAR_M = 0.5
"""Half a side of the box on the map that represents the position of a panorama."""

Ground = Float32[np.ndarray, "two down across"]
"""Distance in metres and number of the image, from 1, at the nodes of a panorama."""


@dataclass(frozen=True, slots=True, eq=False)
class PanoramaFacts:
    """Facts stored inside a panorama."""

    grid: AngleGrid
    centre: Vector3
    """East, north and elevation of its centre, metres of the local map."""
    eye: str
    images: tuple[str, ...]
    ground: str | None
    """Digest of the companion with the ground."""
    registration: Mapping[str, Any]
    """`median_px` and `p90_px` of the shifts between neighbouring images, and of every seam."""


def write_panorama(
    path: Path,
    made: Panorama,
    blocks: Iterable[BrightnessBlock],
    found: Registration,
    ground: str,
    tags: Mapping[str, str],
) -> None:
    """Draw a panorama into a file, piece by piece."""
    facts = {
        "centre_enu_m": (MAP_FROM_LSL @ made.centre).tolist(),
        "eye": str(made.params.eye),
        "images": [image.id for image in made.images],
        "ground": ground,
        "registration": _registration(found),
    }
    place = _map_of(made.grid, 1)
    named = {_TAG: json.dumps(facts, separators=(",", ":")), **tags}
    write_brightness_blocks(path, place, blocks, ANGLES, stretches=[made.stretch], tags=named)


def write_panorama_ground(path: Path, made: Panorama, ground: Ground, tags: dict[str, str]) -> None:
    """Write the distance to the ground in each direction, and its source image."""
    distance, source = ground
    bands = {"distance": distance, "image": source}
    place = _map_of(made.grid, NODE)
    write_raster(path, place, bands, ANGLES, unit={"distance": "m"}, tags=tags, overviews="NEAREST")


def brightness_blocks(blocks: Iterable[PanoramaBlock], ground: Ground) -> Iterator[BrightnessBlock]:
    """The blocks of a panorama as blocks of an image; also fills `ground`."""
    for block in blocks:
        row, col = block.row // NODE, block.col // NODE
        rows, cols = block.sources.shape
        ranges, part = block.ranges, ground[:, row : row + rows, col : col + cols]
        shown = block.sources != NO_SOURCE
        part[0] = np.where(shown & ranges.is_measured, ranges.range_m, np.nan)
        part[1] = np.where(shown, block.sources.astype(np.float32) + 1, np.nan)
        yield block.row, block.col, block.brightness[None]


def blank_ground(grid: AngleGrid) -> Ground:
    """Empty values for all directions."""
    return np.full((2, grid.rows // NODE, grid.cols // NODE), np.nan, np.float32)


def read_panorama_facts(dataset: rasterio.DatasetReader) -> PanoramaFacts:
    """The facts stored inside an open panorama.

    Raises:
        ProductError: the file is not a panorama.
    """
    text = dataset.tags().get(_TAG)
    if text is None:
        raise BrokenProductError(f"{dataset.name} is not a panorama: it has no tag {_TAG}")
    facts = json.loads(text)
    at = dataset.transform
    grid = AngleGrid(at.c, at.f, at.a, dataset.height, dataset.width)
    return PanoramaFacts(
        grid,
        np.array(facts["centre_enu_m"]),
        facts["eye"],
        tuple(facts["images"]),
        facts["ground"],
        facts["registration"],
    )


def panorama_bounds(path: Path) -> tuple[float, float, float, float]:
    """A small box on the map around the position of a panorama."""
    with open_raster(path) as dataset:
        east, north, _ = read_panorama_facts(dataset).centre.tolist()
    return east - _NEAR_M, north - _NEAR_M, east + _NEAR_M, north + _NEAR_M


def _map_of(grid: AngleGrid, coarser: int) -> MapGrid:
    """The directions as position of a raster; node n of a coarser one is the middle of pixel n."""
    cell = grid.cell_deg * coarser
    aside = (grid.cell_deg - cell) / 2
    rows, cols = grid.rows // coarser, grid.cols // coarser
    return MapGrid(grid.west_deg + aside, grid.top_deg - aside, cell, rows, cols)


def _registration(found: Registration) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return round(value, 3) if np.isfinite(value) else None

    seams: Sequence[dict[str, Any]] = [
        {
            "first": seam.first,
            "second": seam.second,
            "patches": seam.patches,
            "shift_px": number(seam.shift_px),
        }
        for seam in found.seams
    ]
    return {
        "median_px": number(found.median_px),
        "p90_px": number(found.p90_px),
        "seams": seams,
    }
