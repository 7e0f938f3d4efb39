"""Values of layers at a map point, and statistics of a raster layer over a polygon."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely
from cachetools import LRUCache, cached
from pydantic import BaseModel
from rasterio.windows import Window

from solmap.gis_server.analysis.bodies import UNITS, LayerUsed, Polygon, Question, UnanswerableError
from solmap.gis_server.rendering.reading import RasterPool
from solmap.photogrammetry.arrays import PerPoint
from solmap.photogrammetry.terrain.measure.areas import polygon_of
from solmap.products.crs import LandingPoint, lon_lat
from solmap.products.errors import ProductError
from solmap.products.formats.raster.raster import class_names, grid_of, values_in
from solmap.products.formats.vector.geojson import Feature, FeatureCollection, read_features
from solmap.products.model import Layer, ProductKind, ScopeLevel
from solmap.products.store.product_store import ProductStore

_SHAPES = {"Point": shapely.Point, "LineString": shapely.LineString}
log = logging.getLogger(__name__)
_WIDEST_FIRST = {ScopeLevel.REGION: 0, ScopeLevel.SOL: 1, ScopeLevel.STOP: 2}
_NEAR_M = 2.0
"""Largest distance of a stop or tie point from the place: about the length of a rover."""
_MOST = 50
_AREAS = (ProductKind.FOOTPRINTS, ProductKind.HAVENS, ProductKind.REGION_HAVENS)
_NEARBY = (ProductKind.STOPS, ProductKind.TIE_POINTS, ProductKind.POINTING)
_SLOPE_OF = {
    kind: slope
    for slope, kinds in {
        ProductKind.SLOPE: (ProductKind.ASPECT, ProductKind.NORTHERLY_TILT),
        ProductKind.REGION_SLOPE: (ProductKind.REGION_ASPECT, ProductKind.REGION_NORTHERLY_TILT),
    }.items()
    for kind in kinds
}
_ASPECTS = (ProductKind.ASPECT, ProductKind.REGION_ASPECT)
_CELLS = 4_000_000
"""Most cells read; larger windows are read from an overview."""
_KEPT = 100_000
"""Features that are kept in memory, some kilobytes each."""
_PERCENT = (5.0, 25.0, 50.0, 75.0, 95.0)


class ValueHere(BaseModel):
    """A raster layer's value at a place."""

    id: str
    scope: str
    kind: str
    title: str
    value: float
    sigma: float | None
    unit: str | None
    cell_m: float | None
    """Cell size of the layer."""
    label: str | None
    """Meaning of the value, for classes: an image's name, a kind of ground."""
    bands: dict[str, float] = {}
    """All bands of the layer by name, such as standard deviation and observations."""


class FeatureHere(BaseModel):
    """A feature at or near a place."""

    layer: str
    kind: str
    title: str
    id: str | None
    distance_m: float
    properties: dict[str, Any]


class Place(BaseModel):
    """Coordinates, layers and features at a place: metres of the local map, degrees of Mars."""

    east: float
    north: float
    lon: float | None
    """Longitude; null on a map that is not tied to the lander."""
    lat: float | None
    elevation_m: float | None
    elevation_sigma_m: float | None
    layers: list[ValueHere]
    features: list[FeatureHere]


def identify(
    layers: Sequence[Layer],
    landing: LandingPoint,
    east: float,
    north: float,
    store: ProductStore,
    pool: RasterPool,
) -> Place:
    """Values and features of `layers` at a place, metres of the local map.

    A layer whose file is damaged or missing is logged and left out: the others remain valid.
    """
    ordered = sorted(layers, key=lambda layer: _WIDEST_FIRST.get(layer.ref.scope.level, 3))
    values: list[ValueHere] = []
    features: list[FeatureHere] = []
    for layer in ordered:
        if not _near(layer.bounds, east, north):
            continue
        try:
            if layer.type == "raster":
                values += _value(layer, east, north, store, pool)
            else:
                features += _features(layer, east, north, store)
        except ProductError as error:
            log.warning("%s", error)
    for value in values:
        if value.sigma is None:
            value.sigma = derived_sigma(value, values)
    features.sort(key=lambda found: found.distance_m)
    longitude, latitude = (float(degrees[0]) for degrees in lon_lat(landing, east, north))
    elevation = _elevation(values)
    return Place(
        east=east,
        north=north,
        lon=None if landing.origin else round(longitude, 9),
        lat=None if landing.origin else round(latitude, 9),
        elevation_m=elevation.value if elevation else None,
        elevation_sigma_m=elevation.sigma if elevation else None,
        layers=values,
        features=features[:_MOST],
    )


def derived_sigma(value: ValueHere, values: Sequence[ValueHere]) -> float | None:
    """Standard deviation of a value whose file has none, from what is known at the same place.

    A difference is stated in its standard deviations too. Aspect and northerly tilt have the
    gradient of the slope: with the same variance v of both of its components and a gradient g, the
    variances of slope, aspect and northerly tilt are v / (1 + g^2)^2, v / g^2, v / (1 + g_n^2)^2.
    """
    in_sigmas = value.bands.get("disagreement_in_sigmas")
    if in_sigmas is not None:
        return abs(value.value / in_sigmas) if in_sigmas else None
    slope_kind = _SLOPE_OF.get(ProductKind(value.kind))
    slope = next(
        (one for one in values if (one.scope, one.kind) == (value.scope, slope_kind)), None
    )
    if slope is None or slope.sigma is None:
        return None
    gradient = math.tan(math.radians(slope.value))
    component = slope.sigma * (1 + gradient**2)
    if value.kind in _ASPECTS:
        return component / gradient if gradient else None
    return component / (1 + math.tan(math.radians(value.value)) ** 2)


def _elevation(values: Sequence[ValueHere]) -> ValueHere | None:
    """The elevation at a place, from the most comprehensive terrain model that has one there.

    Models of far ground are used last: close to the stops others are more accurate.
    """
    kinds = (ProductKind.DTM, ProductKind.REGION_DTM, ProductKind.FAR_DTM)
    return next((value for kind in kinds for value in values if value.kind == kind), None)


def _near(bounds: tuple[float, float, float, float], east: float, north: float) -> bool:
    west, south, to_east, to_north = bounds
    return (
        west - _NEAR_M <= east <= to_east + _NEAR_M
        and south - _NEAR_M <= north <= to_north + _NEAR_M
    )


def _value(
    layer: Layer, east: float, north: float, store: ProductStore, pool: RasterPool
) -> list[ValueHere]:
    with pool.reading(store.address(layer.ref)) as dataset:
        bands = values_in(dataset, east, north)
        classes = class_names(dataset)
    if not bands:
        return []
    first = next(iter(bands.values()))
    sigma = bands.get("standard_deviation", math.nan)
    if not math.isfinite(first):
        return []
    return [
        ValueHere(
            id=layer.id,
            scope=layer.ref.scope.name,
            kind=str(layer.ref.kind),
            title=layer.title,
            value=first,
            sigma=sigma if math.isfinite(sigma) else None,
            unit=layer.unit,
            cell_m=layer.cell_m,
            label=classes.get(round(first)),
            bands={name: value for name, value in bands.items() if math.isfinite(value)},
        )
    ]


def _features(layer: Layer, east: float, north: float, store: ProductStore) -> list[FeatureHere]:
    index = index_of(store.path(layer.ref))
    if layer.ref.kind in _AREAS:
        found = [(feature, 0.0) for feature in index.holding(east, north)]
    elif layer.ref.kind in _NEARBY:
        found = index.nearest(east, north, _NEAR_M)
    else:
        found = []
    return [
        FeatureHere(
            layer=layer.id,
            kind=str(layer.ref.kind),
            title=layer.title,
            id=feature.id,
            distance_m=round(metres, 3),
            properties=dict(feature.properties),
        )
        for feature, metres in found
    ]


@dataclass(frozen=True, slots=True, eq=False)
class FeatureIndex:
    """The features of a product and a tree of their boxes."""

    collection: FeatureCollection
    shapes: list[shapely.Geometry]
    tree: shapely.STRtree

    def holding(self, east: float, north: float) -> list[Feature]:
        """The polygons that contain a place, smallest first."""
        found = self.tree.query(shapely.Point(east, north), predicate="intersects")
        polygons = [int(i) for i in found if self.collection.features[i].geometry == "Polygon"]
        polygons.sort(key=lambda i: self.shapes[i].area)
        return [self.collection.features[i] for i in polygons]

    def nearest(self, east: float, north: float, within_m: float) -> list[tuple[Feature, float]]:
        """The features nearer than `within_m` and their distances, nearest first."""
        place = shapely.Point(east, north)
        found = self.tree.query(place, predicate="dwithin", distance=within_m)
        with_distance = [(int(i), float(self.shapes[i].distance(place))) for i in found]
        with_distance.sort(key=lambda pair: pair[1])
        return [(self.collection.features[i], metres) for i, metres in with_distance]


def _size_of(index: FeatureIndex) -> int:
    return min(1 + len(index.shapes), _KEPT)


@cached(LRUCache(_KEPT, getsizeof=_size_of), lock=threading.Lock())
def index_of(path: Path) -> FeatureIndex:
    """The features of a file. Products never change, so they are read once."""
    collection = read_features(path)
    shapes = [_shape(feature) for feature in collection.features]
    return FeatureIndex(collection, shapes, shapely.STRtree(shapes))


def _shape(feature: Feature) -> shapely.Geometry:
    plane = feature.points[:, :2]
    if feature.geometry == "Polygon":
        return shapely.Polygon(plane, [hole[:, :2] for hole in feature.holes])
    return _SHAPES[feature.geometry](plane[0] if feature.geometry == "Point" else plane)


class ZonalQuestion(Question):
    """A polygon on the map, and a raster layer."""

    polygon: Polygon
    layer: str
    """Id of a raster layer, as /layers lists it."""


class ClassShare(BaseModel):
    """Area of a class inside the polygon."""

    value: int
    name: str
    area_m2: float
    share: float
    """Share of the known area."""


class ZonalAnswer(BaseModel):
    """Statistics of a layer inside a polygon, in the unit of the layer."""

    units: str = UNITS
    unit: str | None
    """Unit of the values."""
    count: int
    """Cells with a value."""
    measured_share: float
    cell_m: float
    """Size of the cells that were read: larger than the layer's for a large polygon."""
    mean: float | None = None
    std: float | None = None
    min: float | None = None
    max: float | None = None
    percentiles: dict[str, float] = {}
    """Values by percentage."""
    is_direction: bool = False
    """Mean and std are those of directions; there are no percentiles of them."""
    classes: list[ClassShare] = []
    """Areas of classes, for class layers; they replace mean and percentiles."""
    layers: list[LayerUsed]


@dataclass(frozen=True, slots=True, eq=False)
class _Zone:
    values: PerPoint
    """True values of the first band inside the polygon."""
    cells: int
    cell_m: float
    classes: dict[int, str]


def zonal_answer(
    question: ZonalQuestion, layer: Layer, store: ProductStore, pool: RasterPool
) -> ZonalAnswer:
    """Count, mean, spread and percentiles, or the classes, of a layer in a polygon."""
    if layer.type != "raster":
        raise UnanswerableError(
            f"{layer.id} is not a raster: statistics over a polygon need rasters"
        )
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
