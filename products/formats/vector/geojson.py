"""Features on disk: GeoJSON in degrees of Mars, or in metres of a map that is not tied to Mars.

GeoJSON has no CRS of its own (RFC 7946 assumes WGS 84), and a reader without other information
would draw a rover's traverse in the Pacific. The files therefore

- hold planetocentric longitude (east) and latitude of Mars in degrees, nine decimals (0.06 mm), and
  elevation in metres above the tangent plane at the landing point where it is known;
- state this in the member `crs` of GeoJSON 2008, `urn:ogc:def:crs:IAU:2015:49900`, which GDAL, QGIS
  and everything built on them resolve to Mars;
- keep the landing point in a foreign member, `solmap`, so that `read_features` gives back the
  metres of the local map that `write_features` was given.

Longitude and latitude are those of the local CRS (see `products.crs`), so that vectors and rasters
of a site coincide in any program. A map that is not tied to the lander has none: coordinates are
metres east and north of its origin, and `crs` has the WKT of its engineering CRS, which GDAL reads.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import orjson
import shapely

from solmap.photogrammetry.terrain.relief.contours import Contour
from solmap.products.crs import (
    MARS_URN,
    LandingPoint,
    crs_text,
    east_north,
    height_reference,
    local_crs,
    lon_lat,
)
from solmap.products.errors import BrokenProductError, ProductError, ProductNotFoundError

WrittenFeature = Mapping[str, Any]
"""A GeoJSON feature as it is in a file."""
Geometry = Literal["Point", "LineString", "Polygon"]
_FEWEST = {"Point": 1, "LineString": 2, "Polygon": 3}
_DECIMALS_DEGREES, _DECIMALS_M = 9, 4


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """A feature of the map: its geometry and properties.

    Points are rows of (east, north) or (east, north, up), metres of the local map. A polygon is its
    outer ring, closed or not, and its holes; rings are kept without the repeated first point.
    """

    geometry: Geometry
    points: np.ndarray
    properties: Mapping[str, Any] = field(default_factory=dict)
    """Plain JSON values."""
    id: str | None = None
    holes: Sequence[np.ndarray] = ()
    """Inner rings of a polygon."""

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64, ndmin=2)
        if self.geometry not in get_args(Geometry):
            raise ProductError(f"{self.geometry!r} is not one of {', '.join(get_args(Geometry))}")
        if self.geometry == "Polygon":
            points = _open_ring(points)
        shape_is_right = points.ndim == 2 and points.shape[1] in (2, 3)  # noqa: PLR2004
        if not shape_is_right or len(points) < _FEWEST[self.geometry]:
            raise ProductError(
                f"a {self.geometry} needs at least {_FEWEST[self.geometry]} rows of (east, north) "
                f"or (east, north, up), not {points.shape}"
            )
        if self.geometry == "Point" and len(points) > 1:
            raise ProductError(f"a Point has one row, not {len(points)}")
        if not np.isfinite(points).all():
            raise ProductError(
                f"{self.geometry} {self.id or self.properties}: coordinates are not all finite; "
                "leave out unmeasured points"
            )
        if self.holes and self.geometry != "Polygon":
            raise ProductError(f"a {self.geometry} cannot have holes; a Polygon can")
        holes = tuple(_open_ring(np.array(h, dtype=np.float64, ndmin=2)) for h in self.holes)
        if any(len(h) < _FEWEST["Polygon"] or h.shape[1] != points.shape[1] for h in holes):
            raise ProductError(
                f"holes must be rings of {points.shape[1]} columns, like the outline"
            )
        points.flags.writeable = False
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "holes", holes)

    @property
    def rings(self) -> tuple[np.ndarray, ...]:
        """The points, and the holes after them."""
        return (self.points, *self.holes)

    @property
    def shape(self) -> shapely.Geometry:
        """The geometry, metres of the local map."""
        if self.geometry == "Polygon":
            return shapely.Polygon(self.points, self.holes)
        if self.geometry == "Point":
            return shapely.Point(self.points[0])
        return shapely.LineString(self.points)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north), metres."""
        west, south = self.points[:, :2].min(axis=0)
        east, north = self.points[:, :2].max(axis=0)
        return float(west), float(south), float(east), float(north)


def _open_ring(ring: np.ndarray) -> np.ndarray:
    """A ring without the repeated first point."""
    is_closed = len(ring) > 1 and np.array_equal(ring[0], ring[-1])
    return ring[:-1] if is_closed else ring


@dataclass(frozen=True, slots=True, eq=False)
class FeatureCollection:
    """The features of one file and the landing point of their map."""

    landing: LandingPoint
    features: tuple[Feature, ...]
    tags: Mapping[str, Any] = field(default_factory=dict)


def write_features(
    path: Path,
    features: Iterable[Feature | WrittenFeature],
    landing: LandingPoint,
    *,
    tags: Mapping[str, Any] | None = None,
) -> None:
    """Write features of the local map in Mars degrees, or in its metres where it is untied.

    Equal input gives equal bytes, also where features were written before.
    """
    document = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": _crs_name(landing)}},
        "solmap": {
            "landing": dataclasses.asdict(landing),
            "local_crs": crs_text(landing),
            "elevation": height_reference(local_crs(landing)),
            "tags": dict(tags or {}),
        },
        "features": _as_written(tuple(features), landing),
    }
    try:
        text = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ProductError(f"{path.name}: a property is not a plain JSON value: {error}") from error
    path.write_text(text, encoding="utf-8")


def _crs_name(landing: LandingPoint) -> str:
    """GDAL's name of the CRS of the coordinates."""
    return local_crs(landing).to_wkt() if landing.origin else MARS_URN


def _as_written(
    features: Sequence[Feature | WrittenFeature], landing: LandingPoint
) -> list[WrittenFeature]:
    rings = [ring for one in features if isinstance(one, Feature) for ring in one.rings]
    plane = [ring[:, :2] for ring in rings]
    points = np.concatenate(plane) if plane else np.empty((0, 2))
    if landing.origin:
        written = np.round(points, _DECIMALS_M) + 0.0
    else:
        written = np.round(np.column_stack(lon_lat(landing, *points.T)), _DECIMALS_DEGREES)
    placed = iter(
        np.hstack([rows, np.round(ring[:, 2:], _DECIMALS_M)])
        for ring, rows in zip(rings, _split_like(plane, written), strict=True)
    )
    return [
        as_geojson(one, [next(placed) for _ in one.rings]) if isinstance(one, Feature) else one
        for one in features
    ]


def _split_like(parts: Sequence[np.ndarray], rows: np.ndarray) -> list[np.ndarray]:
    ends = np.cumsum([len(part) for part in parts], dtype=int)
    return [rows[end - len(part) : end] for part, end in zip(parts, ends, strict=True)]


def as_geojson(feature: Feature, rings: Sequence[np.ndarray]) -> dict[str, Any]:
    """The GeoJSON object of a feature whose coordinates are `rings`, one for each of its own."""
    nested: Sequence[Any] = rings[0].tolist()
    if feature.geometry == "Point":
        nested = nested[0]
    elif feature.geometry == "Polygon":
        nested = [[*ring.tolist(), ring[0].tolist()] for ring in rings]
    identity = {} if feature.id is None else {"id": feature.id}
    return {
        "type": "Feature",
        **identity,
        "geometry": {"type": feature.geometry, "coordinates": nested},
        "properties": dict(feature.properties),
    }


def local_geojson(collection: FeatureCollection) -> dict[str, Any]:
    """The features in metres of the local map (east, north, up), for the viewer and scripts."""
    return {
        "type": "FeatureCollection",
        "solmap:crs": crs_text(collection.landing),
        "features": [
            as_geojson(feature, [np.round(ring, _DECIMALS_M) + 0.0 for ring in feature.rings])
            for feature in collection.features
        ],
    }


def read_features(path: Path) -> FeatureCollection:
    """The inverse of `write_features`, in metres of the local map.

    Raises:
        ProductNotFoundError: there is no such file.
        ProductError: it is not a feature collection of a landing site.
    """
    placed = read_placed(path)
    features = []
    for number, item in enumerate(placed.items):
        points, *holes = placed.rings_of(number)
        known = item.get("properties") or {}
        features.append(Feature(item["geometry"]["type"], points, known, item.get("id"), holes))
    return FeatureCollection(placed.landing, tuple(features), placed.tags)


def written_features(path: Path) -> list[WrittenFeature]:
    """The features as they are in a file of `write_features`.

    Raises:
        ProductError: it is not such a file.
    """
    try:
        features: list[WrittenFeature] = orjson.loads(path.read_bytes())["features"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ProductError(f"{path.name} is not a feature collection: {error!r}") from error
    return features


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFeatures:
    """The features of a file, and their positions on the local map.

    Handling each of a hundred thousand takes seconds; here they are rows of one table.
    """

    landing: LandingPoint
    items: Sequence[Mapping[str, Any]]
    """GeoJSON, as in the file."""
    tags: Mapping[str, Any]
    metres: np.ndarray
    """(n, 2): east and north of all points of all rings."""
    first_row: np.ndarray
    """First row of every ring in `metres`, then the number of rows."""
    first_ring: np.ndarray
    """First ring of every item, then the number of rings."""

    def rings_of(self, number: int) -> list[np.ndarray]:
        """Rings of an item as in the file: (east, north) or (east, north, up), metres."""
        rings = _rings_of(self.items[number]["geometry"])
        places = (
            self.metres[self.first_row[k] : self.first_row[k + 1]]
            for k in range(self.first_ring[number], self.first_ring[number + 1])
        )
        heights = (np.array([point[2:] for point in ring], dtype=np.float64) for ring in rings)
        return [np.hstack(both) for both in zip(places, heights, strict=True)]

    @property
    def bounds(self) -> tuple[float, float, float, float] | None:
        """(west, south, east, north) of all features, metres; None where there is none."""
        if not len(self.items):
            return None
        (west, south), (east, north) = self.metres.min(axis=0), self.metres.max(axis=0)
        return float(west), float(south), float(east), float(north)

    def boxes(self) -> np.ndarray:
        """West, south, east and north of every item: (items, 4)."""
        if not len(self.items):
            return np.empty((0, 4))
        begin = self.first_row[self.first_ring[:-1]]
        least = np.minimum.reduceat(self.metres, begin)
        return np.hstack([least, np.maximum.reduceat(self.metres, begin)])


def read_placed(path: Path) -> PlacedFeatures:
    """Read a file of `write_features` without making a `Feature` of each.

    Raises:
        ProductNotFoundError: there is no such file.
        ProductError: it is not a feature collection of a landing site.
    """
    try:
        document = orjson.loads(path.read_bytes())
        landing = LandingPoint(**document["solmap"]["landing"])
        tags = document["solmap"].get("tags", {})
        return _place_features(document["features"], landing, tags)
    except FileNotFoundError as error:
        raise ProductNotFoundError(f"{path.name} does not exist") from error
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise BrokenProductError(
            f"{path.name} is not a feature collection of a landing site: {error!r}"
        ) from error


def _place_features(
    items: Sequence[Mapping[str, Any]], landing: LandingPoint, tags: Mapping[str, Any]
) -> PlacedFeatures:
    nested = [_rings_of(item["geometry"]) for item in items]
    rings = list(chain.from_iterable(nested))
    points = list(chain.from_iterable(rings))
    written = [np.fromiter(map(itemgetter(axis), points), float, len(points)) for axis in (0, 1)]
    plane = np.column_stack(written if landing.origin else east_north(landing, *written))
    return PlacedFeatures(
        landing=landing,
        items=items,
        tags=tags,
        metres=np.round(plane, _DECIMALS_M) + 0.0,  # avoids -0.0
        first_row=np.cumsum([0, *map(len, rings)]),
        first_ring=np.cumsum([0, *map(len, nested)]),
    )


def _rings_of(geometry: Mapping[str, Any]) -> list[list[list[float]]]:
    """The points of a geometry, and those of its holes."""
    nested = geometry["coordinates"]
    if geometry["type"] == "Point":
        return [[nested]]
    return [nested] if geometry["type"] == "LineString" else nested


def contour_feature(contour: Contour) -> Feature:
    """A contour as a line at its elevation, metres of the local map."""
    up = np.full(len(contour.points), contour.elevation_m)
    return Feature(
        "LineString",
        np.column_stack([contour.points, up]),
        {"elevation_m": contour.elevation_m, "is_index": contour.is_index},
    )
