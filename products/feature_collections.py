"""What a mission knows as collections of features, whichever layers they come from.

A collection joins the latest layers of its kinds: contours lie in one layer for each stop, tie
points in one for the mission. Some are drawn from others: differences join the two places of a
stop. Every collection is kept in an index (`products.feature_index`) under the digests of what it
comes from, so that it is read anew only when that has changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from products.catalogue import ImageEntry
from products.model import ProductKind
from products.vector import Feature, Geometry

Draw = Callable[[Iterable[Feature], Mapping[str, ImageEntry]], Iterable[Feature]]


def _as_they_are(
    features: Iterable[Feature], _images: Mapping[str, ImageEntry]
) -> Iterable[Feature]:
    return features


@dataclass(frozen=True, slots=True)
class CollectionOf:
    """A collection: what it is called, what layers it comes from, and how."""

    id: str
    title: str
    description: str
    geometry: Geometry
    kinds: tuple[ProductKind, ...]
    draw: Draw = _as_they_are
    shows_images: bool = False
    """Whether a feature stands for an image, whose identifier it bears."""
    all_images: bool = False
    """Whether images without a feature are in it too, without a place."""


def _of_solution(solution: str) -> Draw:
    def draw(features: Iterable[Feature], _images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
        return [one for one in features if one.properties.get("solution") == solution]

    return draw


def _differences(
    features: Iterable[Feature], _images: Mapping[str, ImageEntry]
) -> Iterable[Feature]:
    """From where telemetry has a stop to where the adjustment puts it."""
    places: dict[str, dict[str, Feature]] = {}
    for one in features:
        known = one.properties
        places.setdefault(known.get("stop", ""), {})[known.get("solution", "")] = one
    for stop, both in places.items():
        if {"telemetry", "adjusted"} <= set(both):
            told, adjusted = both["telemetry"], both["adjusted"]
            east, north, up = (adjusted.points - told.points)[0].tolist()
            known = {name: adjusted.properties[name] for name in ("stop", "site", "drive", "sols")}
            offsets = {
                "east_m": round(east, 4),
                "north_m": round(north, 4),
                "up_m": round(up, 4),
                "horizontal_m": round(float(np.hypot(east, north)), 4),
            }
            line = np.vstack([told.points, adjusted.points])
            yield Feature("LineString", line, known | offsets, id=stop)


def _cameras(features: Iterable[Feature], images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
    """Where images were taken from: pointing lines start in the camera."""
    for one in features:
        entry = images.get(one.id or "")
        if entry:
            yield Feature("Point", one.points[:1], image_properties(entry), one.id)


def _with_times(features: Iterable[Feature], images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
    for one in features:
        entry = images.get(one.id or "")
        known = {"start_time": entry.start_time} if entry else {}
        yield replace(one, properties={**one.properties, **known})


def image_properties(entry: ImageEntry) -> dict[str, Any]:
    """What is known of an image."""
    names = ("mission", "stop", "site", "drive", "sol", "instrument", "eye", "product_type")
    times = ("start_time", "local_solar_time", "partner", "unpaired_because")
    return {"image": entry.id, **{name: getattr(entry, name) for name in names + times}}


COLLECTIONS = (
    CollectionOf(
        "traverse-adjusted",
        "Traverse, adjusted",
        "Where the rover went by the bundle adjustment",
        "LineString",
        (ProductKind.TRAVERSE,),
        _of_solution("adjusted"),
    ),
    CollectionOf(
        "traverse-telemetry",
        "Traverse, telemetry",
        "Where the rover itself believed to be",
        "LineString",
        (ProductKind.TRAVERSE,),
        _of_solution("telemetry"),
    ),
    CollectionOf(
        "traverse-differences",
        "Differences of the traverses",
        "From each stop by telemetry to the same stop as adjusted, metres east, north and up",
        "LineString",
        (ProductKind.STOPS,),
        _differences,
    ),
    CollectionOf(
        "stops",
        "Stops, adjusted",
        "Stops with standard deviations, 1-sigma error ellipse and what holds them",
        "Point",
        (ProductKind.STOPS,),
        _of_solution("adjusted"),
    ),
    CollectionOf(
        "stops-telemetry",
        "Stops, telemetry",
        "Stops where telemetry has them",
        "Point",
        (ProductKind.STOPS,),
        _of_solution("telemetry"),
    ),
    CollectionOf(
        "mission-traverse",
        "Published traverses",
        "Traverses of the whole mission from published tables",
        "LineString",
        (ProductKind.MISSION_TRAVERSE,),
    ),
    CollectionOf(
        "mission-stops",
        "Published stops",
        "Stops of the whole mission from published tables",
        "Point",
        (ProductKind.MISSION_STOPS,),
    ),
    CollectionOf(
        "images",
        "Images",
        "Every image, where its camera stood; no place where its stop has none yet",
        "Point",
        (ProductKind.POINTING,),
        _cameras,
        shows_images=True,
        all_images=True,
    ),
    CollectionOf(
        "footprints",
        "Image footprints",
        "The ground that an image shows, taken for level",
        "Polygon",
        (ProductKind.FOOTPRINTS,),
        _with_times,
        shows_images=True,
    ),
    CollectionOf(
        "pointing-lines",
        "Pointing lines",
        "From the camera to the ground in the middle of its image",
        "LineString",
        (ProductKind.POINTING,),
        _with_times,
        shows_images=True,
    ),
    CollectionOf(
        "tie-points",
        "Tie points",
        "Tie points of the last adjustment with their residuals in the images",
        "Point",
        (ProductKind.TIE_POINTS,),
    ),
    CollectionOf(
        "contours",
        "Contours",
        "Contours of the terrain models of stops",
        "LineString",
        (ProductKind.CONTOURS,),
    ),
    CollectionOf(
        "far-contours",
        "Far contours",
        "Contours of far ground, matched from two stops",
        "LineString",
        (ProductKind.FAR_CONTOURS,),
    ),
    CollectionOf(
        "region-contours",
        "Contours of regions",
        "Contours of the fused terrain models",
        "LineString",
        (ProductKind.REGION_CONTOURS,),
    ),
    CollectionOf(
        "havens",
        "Winter havens",
        "Ground at the stops that is tilted to the sun in winter and safe to stand on",
        "Polygon",
        (ProductKind.HAVENS, ProductKind.REGION_HAVENS),
    ),
    CollectionOf(
        "dips",
        "Strike and dip",
        "Planar facets with strike, dip and their standard deviations",
        "Point",
        (ProductKind.DIPS,),
    ),
)
BY_ID = {collection.id: collection for collection in COLLECTIONS}
