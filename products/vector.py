"""Features on disk: GeoJSON in Mars degrees that does not pass for Earth.

GeoJSON has no CRS of its own (RFC 7946 means WGS 84), and a reader that is told nothing draws a
rover's traverse in the Pacific. The files therefore

- hold planetocentric longitude (east) and latitude of Mars in degrees, nine decimals (0.06 mm), and
  elevation in metres above the tangent plane at the landing point where it is known;
- say so in the member `crs` of GeoJSON 2008, `urn:ogc:def:crs:IAU:2015:49900`, which GDAL, QGIS
  and everything built on them resolve to Mars;
- keep the landing point in a foreign member, `solmap`, so that `read_features` gives back the
  metres of the local map that `write_features` was given.

Longitude and latitude are those of the local CRS (see `products.crs`), so that vectors and rasters
of a site fall on each other in any program.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from products.crs import MARS_URN, LandingPoint, east_north, local_proj4, lon_lat
from products.errors import ProductError, ProductNotFoundError

Geometry = Literal["Point", "LineString", "Polygon"]
_FEWEST = {"Point": 1, "LineString": 2, "Polygon": 3}
_DECIMALS_DEGREES, _DECIMALS_M = 9, 4
_VERTICAL = "metres above the tangent plane at the landing point"


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """A thing on the map: its geometry, and what is known of it.

    Points are rows of (east, north) or (east, north, up), metres of the local map. A polygon is its
    outer ring, closed or not; it is kept without the repeated first point.
    """

    geometry: Geometry
    points: np.ndarray
    properties: Mapping[str, Any] = field(default_factory=dict)
    """Plain JSON values."""
    id: str | None = None

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64, ndmin=2)
        if self.geometry not in get_args(Geometry):
            raise ProductError(f"{self.geometry!r} is none of {', '.join(get_args(Geometry))}")
        if self.geometry == "Polygon" and len(points) > 1 and np.array_equal(points[0], points[-1]):
            points = points[:-1]
        shape_is_right = points.ndim == 2 and points.shape[1] in (2, 3)  # noqa: PLR2004
        if not shape_is_right or len(points) < _FEWEST[self.geometry]:
            raise ProductError(
                f"a {self.geometry} has at least {_FEWEST[self.geometry]} rows of (east, north) or "
                f"(east, north, up), not {points.shape}"
            )
        if self.geometry == "Point" and len(points) > 1:
            raise ProductError(f"a Point has one row, not {len(points)}")
        if not np.isfinite(points).all():
            raise ProductError(
                f"{self.geometry} {self.id or self.properties}: coordinates are not all finite; "
                "leave out what was not measured"
            )
        points.flags.writeable = False
        object.__setattr__(self, "points", points)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north), metres."""
        west, south = self.points[:, :2].min(axis=0)
        east, north = self.points[:, :2].max(axis=0)
        return float(west), float(south), float(east), float(north)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureCollection:
    """The features of one file and the landing point whose map they are on."""

    landing: LandingPoint
    features: tuple[Feature, ...]
    tags: Mapping[str, Any] = field(default_factory=dict)

    @property
    def bounds(self) -> tuple[float, float, float, float] | None:
        """(west, south, east, north) of all features, metres; None where there is none."""
        if not self.features:
            return None
        each = np.array([feature.bounds for feature in self.features])
        west, south = each[:, :2].min(axis=0)
        east, north = each[:, 2:].max(axis=0)
        return float(west), float(south), float(east), float(north)


def write_features(
    path: Path,
    features: Iterable[Feature],
    landing: LandingPoint,
    *,
    tags: Mapping[str, Any] | None = None,
) -> None:
    """Write features of the local map in Mars degrees; equal input gives equal bytes."""
    document = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": MARS_URN}},
        "solmap": {
            "landing": dataclasses.asdict(landing),
            "local_crs": local_proj4(landing),
            "elevation": _VERTICAL,
            "tags": dict(tags or {}),
        },
        "features": _in_degrees(tuple(features), landing),
    }
    try:
        text = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ProductError(f"{path.name}: a property is no plain JSON value: {error}") from error
    path.write_text(text, encoding="utf-8")


def _in_degrees(features: Sequence[Feature], landing: LandingPoint) -> list[dict[str, Any]]:
    plane = [feature.points[:, :2] for feature in features]
    degrees = np.round(_carried(plane, partial(lon_lat, landing)), _DECIMALS_DEGREES)
    return [
        as_geojson(feature, np.hstack([rows, np.round(feature.points[:, 2:], _DECIMALS_M)]))
        for feature, rows in zip(features, _split_like(plane, degrees), strict=True)
    ]


def _carried(
    parts: Sequence[np.ndarray], carry: Callable[[np.ndarray, np.ndarray], Sequence[np.ndarray]]
) -> np.ndarray:
    """All rows of all parts through `carry` in one call; one for each part takes far longer."""
    rows = np.concatenate(parts) if parts else np.empty((0, 2))
    return np.column_stack(carry(rows[:, 0], rows[:, 1]))


def _split_like(parts: Sequence[np.ndarray], rows: np.ndarray) -> list[np.ndarray]:
    ends = np.cumsum([len(part) for part in parts], dtype=int)
    return [rows[end - len(part) : end] for part, end in zip(parts, ends, strict=True)]


def as_geojson(feature: Feature, rows: np.ndarray) -> dict[str, Any]:
    """The GeoJSON object of a feature whose coordinates are `rows`, one for each of its points."""
    coordinates = rows.tolist()
    nested: Sequence[Any] = coordinates
    if feature.geometry == "Point":
        nested = coordinates[0]
    elif feature.geometry == "Polygon":
        nested = [[*coordinates, coordinates[0]]]
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
        "solmap:crs": local_proj4(collection.landing),
        "features": [
            as_geojson(feature, np.round(feature.points, _DECIMALS_M) + 0.0)  # no -0.0
            for feature in collection.features
        ],
    }


def read_features(path: Path) -> FeatureCollection:
    """Read what `write_features` wrote, in metres of the local map.

    Raises:
        ProductNotFoundError: there is no such file.
        ProductError: it is no feature collection of a landing site.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        landing = LandingPoint(**document["solmap"]["landing"])
        features = _in_metres(document["features"], landing)
    except FileNotFoundError as error:
        raise ProductNotFoundError(f"{path.name} is not there") from error
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise ProductError(
            f"{path.name} is no feature collection of a landing site: {error!r}; make it again"
        ) from error
    return FeatureCollection(landing, features, document["solmap"].get("tags", {}))


def _in_metres(items: Sequence[Mapping[str, Any]], landing: LandingPoint) -> tuple[Feature, ...]:
    rows = [_rows_of(item["geometry"]) for item in items]
    plane = _carried([part[:, :2] for part in rows], partial(east_north, landing))
    metres = np.round(plane, _DECIMALS_M) + 0.0  # no -0.0
    return tuple(
        Feature(
            item["geometry"]["type"],
            np.hstack([here, part[:, 2:]]),
            item.get("properties") or {},
            item.get("id"),
        )
        for item, part, here in zip(items, rows, _split_like(rows, metres), strict=True)
    )


def _rows_of(geometry: Mapping[str, Any]) -> np.ndarray:
    nested = geometry["coordinates"]
    if geometry["type"] == "Point":
        nested = [nested]
    elif geometry["type"] == "Polygon":
        nested = nested[0]
    return np.array(nested, dtype=np.float64)
