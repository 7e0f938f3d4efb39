"""What all layers of a mission say about one place."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from solmap.gis_server.rendering.features import index_of
from solmap.gis_server.rendering.readers import RasterPool
from solmap.products.errors import ProductError
from solmap.products.formats.raster.raster import class_names, values_in
from solmap.products.model import Layer, ProductKind, ScopeLevel
from solmap.products.store.product_store import ProductStore

log = logging.getLogger(__name__)

_WIDEST_FIRST = {ScopeLevel.REGION: 0, ScopeLevel.SOL: 1, ScopeLevel.STOP: 2}
_NEAR_M = 2.0
"""How far from the place a stop or tie point may be: about the length of a rover."""
_MOST = 50
_AREAS = (ProductKind.FOOTPRINTS, ProductKind.HAVENS, ProductKind.REGION_HAVENS)
_NEARBY = (ProductKind.STOPS, ProductKind.TIE_POINTS, ProductKind.POINTING)


@dataclass(frozen=True, slots=True)
class LayerValue:
    """The value of a raster's first band, true and in its unit, and those of the others."""

    layer: Layer
    value: float
    sigma: float | None
    label: str | None = None
    """What the value stands for, where it is a class."""
    bands: dict[str, float] = field(default_factory=dict)
    """What all bands hold, the first among them, where they hold anything."""


@dataclass(frozen=True, slots=True)
class FeatureFound:
    """A feature at or near a place."""

    layer: Layer
    id: str | None
    distance_m: float
    properties: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Identified:
    """All that is known of a place."""

    values: tuple[LayerValue, ...] = ()
    features: tuple[FeatureFound, ...] = field(default=())

    @property
    def elevation(self) -> LayerValue | None:
        """The elevation from the most comprehensive terrain model that has one here.

        That of the region is asked where no stop answers, and models of far ground last: close to
        the stops others know better.
        """
        kinds = (ProductKind.DTM, ProductKind.REGION_DTM, ProductKind.FAR_DTM)
        return next((v for kind in kinds for v in self.values if v.layer.ref.kind == kind), None)


def identify(
    layers: Sequence[Layer], east: float, north: float, store: ProductStore, pool: RasterPool
) -> Identified:
    """Values and features of `layers` at a place, metres of the local map.

    A layer whose file is damaged or gone is logged and left out: the others still know the place.
    """
    ordered = sorted(layers, key=lambda layer: _WIDEST_FIRST.get(layer.ref.scope.level, 3))
    values, features = [], []
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
    features.sort(key=lambda found: found.distance_m)
    return Identified(tuple(values), tuple(features[:_MOST]))


def _near(bounds: tuple[float, float, float, float], east: float, north: float) -> bool:
    west, south, to_east, to_north = bounds
    return (
        west - _NEAR_M <= east <= to_east + _NEAR_M
        and south - _NEAR_M <= north <= to_north + _NEAR_M
    )


def _value(
    layer: Layer, east: float, north: float, store: ProductStore, pool: RasterPool
) -> list[LayerValue]:
    with pool.reading(store.address(layer.ref)) as dataset:
        bands = values_in(dataset, east, north)
        classes = class_names(dataset)
    if not bands:
        return []
    first = next(iter(bands.values()))
    sigma = bands.get("standard_deviation", math.nan)
    if not math.isfinite(first):
        return []
    label = classes.get(round(first))
    known = {name: value for name, value in bands.items() if math.isfinite(value)}
    return [LayerValue(layer, first, sigma if math.isfinite(sigma) else None, label, known)]


def _features(layer: Layer, east: float, north: float, store: ProductStore) -> list[FeatureFound]:
    index = index_of(store.path(layer.ref))
    if layer.ref.kind in _AREAS:
        found = [(feature, 0.0) for feature in index.holding(east, north)]
    elif layer.ref.kind in _NEARBY:
        found = index.nearest(east, north, _NEAR_M)
    else:
        found = []
    return [
        FeatureFound(layer, feature.id, round(metres, 3), dict(feature.properties))
        for feature, metres in found
    ]
