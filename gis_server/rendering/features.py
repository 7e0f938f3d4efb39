"""Features of a layer at a place of the map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import shapely

from solmap.products.formats.vector.geojson import Feature, FeatureCollection, read_features

_SHAPES = {"Point": shapely.Point, "LineString": shapely.LineString}


@dataclass(frozen=True, slots=True, eq=False)
class FeatureIndex:
    """The features of a product and a tree of their boxes."""

    collection: FeatureCollection
    shapes: list[shapely.Geometry]
    tree: shapely.STRtree

    def holding(self, east: float, north: float) -> list[Feature]:
        """The polygons that hold a place, smallest first."""
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


@lru_cache(maxsize=64)
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
