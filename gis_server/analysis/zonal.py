"""Statistics of a raster layer over a polygon."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import rasterio
import shapely
from pydantic import BaseModel
from rasterio.windows import Window

from solmap.gis_server.analysis.bodies import UNITS, LayerUsed, Polygon, Question
from solmap.gis_server.analysis.refusal import RefusedError
from solmap.gis_server.rendering.readers import RasterPool
from solmap.photogrammetry.arrays import PerPoint
from solmap.photogrammetry.terrain.measure.areas import polygon_of
from solmap.products.formats.raster.raster import class_names, grid_of
from solmap.products.model import Layer
from solmap.products.store.product_store import ProductStore

_CELLS = 4_000_000
"""Cells that are looked at; of larger windows an overview is read."""
_PERCENT = (5.0, 25.0, 50.0, 75.0, 95.0)


class ZonalQuestion(Question):
    """A polygon on the map, and the raster layer that is asked."""

    polygon: Polygon
    layer: str
    """Id of a raster layer, as /layers lists it."""


class ClassShare(BaseModel):
    """How much of the polygon a class takes up."""

    value: int
    name: str
    area_m2: float
    share: float
    """Of what is known."""


class ZonalAnswer(BaseModel):
    """What a layer holds inside a polygon, in its own unit."""

    units: str = UNITS
    unit: str | None
    """Of the values."""
    count: int
    """Cells with a value."""
    measured_share: float
    cell_m: float
    """Of the cells that were looked at: larger than the layer's for a large polygon."""
    mean: float | None = None
    std: float | None = None
    min: float | None = None
    max: float | None = None
    percentiles: dict[str, float] = {}
    """By percent."""
    is_direction: bool = False
    """Mean and std are those of directions; there are no percentiles of them."""
    classes: list[ClassShare] = []
    """Of layers of classes, instead of mean and percentiles."""
    layers: list[LayerUsed]


@dataclass(frozen=True, slots=True, eq=False)
class _Zone:
    values: PerPoint
    """True values of the first band inside the polygon."""
    cells: int
    cell_m: float
    classes: dict[int, str]


def zonal(
    question: ZonalQuestion, layer: Layer, store: ProductStore, pool: RasterPool
) -> ZonalAnswer:
    """Count, mean, spread and percentiles, or the classes, of a layer in a polygon."""
    if layer.type != "raster":
        raise RefusedError(f"{layer.id} is no raster: statistics over a polygon are of rasters")
    polygon = polygon_of(np.array(question.polygon))
    with pool.reading(store.address(layer.ref)) as dataset:
        zone = _read(dataset, polygon)
    common: dict[str, Any] = {
        "unit": layer.unit,
        "count": len(zone.values),
        "measured_share": round(len(zone.values) / max(zone.cells, 1), 4),
        "cell_m": round(zone.cell_m, 6),
        "layers": [LayerUsed.of(layer)],
    }
    if zone.classes:
        return ZonalAnswer(**common, classes=_classes(zone))
    if not len(zone.values):
        return ZonalAnswer(**common)
    if layer.ref.kind.value.endswith("aspect"):
        return ZonalAnswer(**common, **_directions(zone.values), is_direction=True)
    return ZonalAnswer(**common, **_numbers(zone.values))


def _read(dataset: rasterio.DatasetReader, polygon: shapely.Polygon) -> _Zone:
    grid = grid_of(dataset)
    west, south, east, north = polygon.bounds
    left = max(0, math.floor((west - grid.west) / grid.cell_m))
    top = max(0, math.floor((grid.north - north) / grid.cell_m))
    right = min(grid.cols, math.ceil((east - grid.west) / grid.cell_m))
    bottom = min(grid.rows, math.ceil((grid.north - south) / grid.cell_m))
    classes = class_names(dataset)
    if right <= left or bottom <= top:
        return _Zone(np.zeros(0), 0, grid.cell_m, classes)
    shrink = max(1.0, math.sqrt((right - left) * (bottom - top) / _CELLS))
    shape = (math.ceil((bottom - top) / shrink), math.ceil((right - left) / shrink))
    window = Window(left, top, right - left, bottom - top)
    stored = dataset.read(1, window=window, out_shape=shape, masked=True)
    cell = grid.cell_m * (right - left) / shape[1]
    across = grid.west + left * grid.cell_m + (np.arange(shape[1]) + 0.5) * cell
    down = grid.north - top * grid.cell_m
    down = down - (np.arange(shape[0]) + 0.5) * grid.cell_m * (bottom - top) / shape[0]
    inside = shapely.contains_xy(polygon, *(axis.ravel() for axis in np.meshgrid(across, down)))
    values = np.ma.filled(stored.astype(np.float64), np.nan).ravel()[inside]
    true = values[np.isfinite(values)] * dataset.scales[0] + dataset.offsets[0]
    return _Zone(true, round(polygon.area / (cell * cell)), cell, classes)


def _numbers(values: PerPoint) -> dict[str, Any]:
    percentiles = np.percentile(values, _PERCENT).round(6).tolist()
    return {
        "mean": round(float(values.mean()), 6),
        "std": round(float(values.std()), 6),
        "min": round(float(values.min()), 6),
        "max": round(float(values.max()), 6),
        "percentiles": {f"{p:g}": v for p, v in zip(_PERCENT, percentiles, strict=True)},
    }


def _directions(degrees: PerPoint) -> dict[str, Any]:
    """Mean direction and circular standard deviation, degrees (Mardia and Jupp 2000, 2.3)."""
    mean = np.exp(1j * np.radians(degrees)).mean()
    length = min(max(abs(mean), 1e-12), 1.0)
    return {
        "mean": round(float(np.degrees(np.angle(mean)) % 360.0), 4),
        "std": round(float(np.degrees(np.sqrt(-2.0 * np.log(length)))), 4),
    }


def _classes(zone: _Zone) -> list[ClassShare]:
    found, counts = np.unique(zone.values.astype(np.int64), return_counts=True)
    total = max(int(counts.sum()), 1)
    return [
        ClassShare(
            value=value,
            name=zone.classes.get(value, str(value)),
            area_m2=round(count * zone.cell_m**2, 4),
            share=round(count / total, 6),
        )
        for value, count in zip(found.tolist(), counts.tolist(), strict=True)
    ]
