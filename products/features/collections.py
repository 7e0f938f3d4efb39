"""The collections of features of a mission, and how each is derived from layers.

A collection joins the latest layers of its kinds: contours have one layer for each stop, tie points
one for the mission. Some are derived from others: differences join the two positions of a stop.
Every collection is kept in an index (`products.features.index`) under the digests of its layers, so
that it is read again only when they have changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.formats.vector.geojson import Feature, Geometry
from solmap.products.model import ProductKind

Draw = Callable[[Iterable[Feature], Mapping[str, ImageEntry]], Iterable[Feature]]


def all_features(
    features: Iterable[Feature], _images: Mapping[str, ImageEntry]
) -> Iterable[Feature]:
    """All features."""
    return features


def of_solution(solution: str) -> Draw:
    """Features of one solution: telemetry or adjusted."""

    def draw(features: Iterable[Feature], _images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
        return [one for one in features if one.properties.get("solution") == solution]

    return draw


_STOP = ("stop", "site", "drive", "sols")


def _in_both(features: Iterable[Feature]) -> Iterator[tuple[Feature, Feature]]:
    """Every stop by telemetry and by the adjustment, in the order of the traverse."""
    places: dict[str, dict[str, Feature]] = {}
    for one in features:
        known = one.properties
        places.setdefault(known.get("stop", ""), {})[known.get("solution", "")] = one
    for both in places.values():
        if {"telemetry", "adjusted"} <= set(both):
            yield both["telemetry"], both["adjusted"]


def differences(
    features: Iterable[Feature], _images: Mapping[str, ImageEntry]
) -> Iterable[Feature]:
    """Lines from the position of each stop by telemetry to the adjusted one.

    `up_m` is null, and the line without elevations, where either position has none.
    """
    for telemetry, adjusted in _in_both(features):
        line = _line_between(telemetry, adjusted)
        east, north, *up = (line[1] - line[0]).tolist()
        known = {name: adjusted.properties.get(name) for name in _STOP}
        offsets = {
            "east_m": round(east, 4),
            "north_m": round(north, 4),
            "up_m": round(up[0], 4) if up else None,
            "horizontal_m": round(float(np.hypot(east, north)), 4),
        }
        yield Feature("LineString", line, known | offsets, id=known["stop"])


def profile(features: Iterable[Feature], _images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
    """Stops along the adjusted traverse with the elevations of both solutions.

    An unknown elevation is null; a step to or from such a stop counts as its length on the map.
    """
    along, last = 0.0, None
    for telemetry, adjusted in _in_both(features):
        if last is not None:
            along += float(np.linalg.norm(np.diff(_line_between(last, adjusted), axis=0)))
        last = adjusted
        known = {name: adjusted.properties.get(name) for name in _STOP}
        heights = {
            "distance_m": round(along, 3),
            "elevation_adjusted_m": _elevation_m(adjusted),
            "elevation_telemetry_m": _elevation_m(telemetry),
            "sigma_m": adjusted.properties.get("sigma_down_m"),
        }
        yield Feature("Point", adjusted.points, known | heights, id=known["stop"])


def _line_between(start: Feature, end: Feature) -> np.ndarray:
    """Two places in rows of (east, north, up), or of (east, north) where either has no elevation.

    Metres of the local map.
    """
    known = min(start.points.shape[1], end.points.shape[1])
    return np.vstack([start.points[:1, :known], end.points[:1, :known]])


def _elevation_m(place: Feature) -> float | None:
    """Metres above the tangent plane at the landing point; None where unknown."""
    known = place.points[0, 2:].tolist()
    return round(known[0], 4) if known else None


def cameras(features: Iterable[Feature], images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
    """Camera positions of images: the first points of pointing lines."""
    for one in features:
        entry = images.get(one.id or "")
        if entry:
            yield Feature("Point", one.points[:1], image_properties(entry), one.id)


def with_times(features: Iterable[Feature], images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
    """Features of images, with the time of each image."""
    for one in features:
        entry = images.get(one.id or "")
        known = {"start_time": entry.start_time} if entry else {}
        yield replace(one, properties={**one.properties, **known})


def image_properties(entry: ImageEntry) -> dict[str, Any]:
    """Properties of an image."""
    names = ("mission", "stop", "site", "drive", "sol", "instrument", "eye", "product_type")
    times = ("start_time", "local_solar_time", "partner", "unpaired_because")
    return {"image": entry.id, **{name: getattr(entry, name) for name in names + times}}


@dataclass(frozen=True, slots=True)
class CollectionDefinition:
    """A collection: its name, its layers, and how it is derived from them."""

    id: str
    title: str
    description: str
    geometry: Geometry | Literal["Unknown"]
    kinds: tuple[ProductKind, ...]
    draw: Draw = all_features
    shows_images: bool = False
    """Whether a feature represents an image and has its identifier."""
    all_images: bool = False
    """Whether it includes images without a feature, without geometry."""
    is_written: bool = False
    """Whether people write it on the map; it comes from the log of edits, not from a layer."""


COLLECTIONS = (
    CollectionDefinition(
        "traverse-adjusted",
        "Traverse, adjusted",
        "Where the rover went by the bundle adjustment",
        "LineString",
        (ProductKind.TRAVERSE,),
        of_solution("adjusted"),
    ),
    CollectionDefinition(
        "traverse-telemetry",
        "Traverse, telemetry",
        "Positions of the rover by its own telemetry",
        "LineString",
        (ProductKind.TRAVERSE,),
        of_solution("telemetry"),
    ),
    CollectionDefinition(
        "traverse-differences",
        "Differences of the traverses",
        "From each stop by telemetry to the same stop as adjusted, metres east, north and up",
        "LineString",
        (ProductKind.STOPS,),
        differences,
    ),
    CollectionDefinition(
        "traverse-profile",
        "Profile of the traverse",
        "Stops with the distance driven to them and their elevation by telemetry and as adjusted",
        "Point",
        (ProductKind.STOPS,),
        profile,
    ),
    CollectionDefinition(
        "stops",
        "Stops, adjusted",
        "Stops with standard deviations, 1-sigma error ellipse and what holds them",
        "Point",
        (ProductKind.STOPS,),
        of_solution("adjusted"),
    ),
    CollectionDefinition(
        "stops-telemetry",
        "Stops, telemetry",
        "Stops where telemetry has them",
        "Point",
        (ProductKind.STOPS,),
        of_solution("telemetry"),
    ),
    CollectionDefinition(
        "mission-traverse",
        "Published traverses",
        "Traverses of the whole mission from published tables",
        "LineString",
        (ProductKind.MISSION_TRAVERSE,),
    ),
    CollectionDefinition(
        "mission-stops",
        "Published stops",
        "Stops of the whole mission from published tables",
        "Point",
        (ProductKind.MISSION_STOPS,),
    ),
    CollectionDefinition(
        "images",
        "Images",
        "Every image, where its camera stood; no place where its stop has none yet",
        "Point",
        (ProductKind.POINTING,),
        cameras,
        shows_images=True,
        all_images=True,
    ),
    CollectionDefinition(
        "footprints",
        "Image footprints",
        "The ground in an image, assumed to be level",
        "Polygon",
        (ProductKind.FOOTPRINTS,),
        with_times,
        shows_images=True,
    ),
    CollectionDefinition(
        "pointing-lines",
        "Pointing lines",
        "From the camera to the ground in the middle of its image",
        "LineString",
        (ProductKind.POINTING,),
        with_times,
        shows_images=True,
    ),
    CollectionDefinition(
        "tie-points",
        "Tie points",
        "Tie points of the last adjustment with their residuals in the images",
        "Point",
        (ProductKind.TIE_POINTS,),
    ),
    CollectionDefinition(
        "contours",
        "Contours",
        "Contours of the terrain models of stops",
        "LineString",
        (ProductKind.CONTOURS,),
    ),
    CollectionDefinition(
        "far-contours",
        "Far contours",
        "Contours of far ground, matched from two stops",
        "LineString",
        (ProductKind.FAR_CONTOURS,),
    ),
    CollectionDefinition(
        "region-contours",
        "Contours of regions",
        "Contours of the fused terrain models",
        "LineString",
        (ProductKind.REGION_CONTOURS,),
    ),
    CollectionDefinition(
        "havens",
        "Winter havens",
        "Ground at the stops that is tilted to the sun in winter and safe to stand on",
        "Polygon",
        (ProductKind.HAVENS, ProductKind.REGION_HAVENS),
    ),
    CollectionDefinition(
        "dips",
        "Strike and dip",
        "Planar facets with strike, dip and their standard deviations",
        "Point",
        (ProductKind.DIPS,),
    ),
    CollectionDefinition(
        "annotations",
        "Annotations",
        "What people wrote on the map",
        "Unknown",
        (),
        is_written=True,
    ),
)
BY_ID = {collection.id: collection for collection in COLLECTIONS}
