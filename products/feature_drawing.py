"""How the features of a collection are drawn from those of its layers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.formats.vector.geojson import Feature

Draw = Callable[[Iterable[Feature], Mapping[str, ImageEntry]], Iterable[Feature]]


def as_they_are(
    features: Iterable[Feature], _images: Mapping[str, ImageEntry]
) -> Iterable[Feature]:
    """All of them."""
    return features


def of_solution(solution: str) -> Draw:
    """Those of one solution: telemetry or adjusted."""

    def draw(features: Iterable[Feature], _images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
        return [one for one in features if one.properties.get("solution") == solution]

    return draw


_STOP = ("stop", "site", "drive", "sols")


def _in_both(features: Iterable[Feature]) -> Iterator[tuple[Feature, Feature]]:
    """Every stop by telemetry and as adjusted, in the order of the traverse."""
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
    """From where telemetry has a stop to where the adjustment puts it.

    `up_m` is null, and the line without elevations, where either place has none.
    """
    for telemetry, adjusted in _in_both(features):
        line = _joined(telemetry, adjusted)
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

    An elevation that is not known is null; a step to or from such a stop counts as its length on
    the map.
    """
    along, last = 0.0, None
    for telemetry, adjusted in _in_both(features):
        if last is not None:
            along += float(np.linalg.norm(np.diff(_joined(last, adjusted), axis=0)))
        last = adjusted
        known = {name: adjusted.properties.get(name) for name in _STOP}
        heights = {
            "distance_m": round(along, 3),
            "elevation_adjusted_m": _elevation_m(adjusted),
            "elevation_telemetry_m": _elevation_m(telemetry),
            "sigma_m": adjusted.properties.get("sigma_down_m"),
        }
        yield Feature("Point", adjusted.points, known | heights, id=known["stop"])


def _joined(start: Feature, end: Feature) -> np.ndarray:
    """Two places in rows of (east, north, up), or of (east, north) where either has no elevation.

    Metres of the local map.
    """
    known = min(start.points.shape[1], end.points.shape[1])
    return np.vstack([start.points[:1, :known], end.points[:1, :known]])


def _elevation_m(place: Feature) -> float | None:
    """Metres above the tangent plane at the landing point; None where it is not known."""
    known = place.points[0, 2:].tolist()
    return round(known[0], 4) if known else None


def cameras(features: Iterable[Feature], images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
    """Where images were taken from: pointing lines start in the camera."""
    for one in features:
        entry = images.get(one.id or "")
        if entry:
            yield Feature("Point", one.points[:1], image_properties(entry), one.id)


def with_times(features: Iterable[Feature], images: Mapping[str, ImageEntry]) -> Iterable[Feature]:
    """What stands for an image, with the time at which it was taken."""
    for one in features:
        entry = images.get(one.id or "")
        known = {"start_time": entry.start_time} if entry else {}
        yield replace(one, properties={**one.properties, **known})


def image_properties(entry: ImageEntry) -> dict[str, Any]:
    """What is known of an image."""
    names = ("mission", "stop", "site", "drive", "sol", "instrument", "eye", "product_type")
    times = ("start_time", "local_solar_time", "partner", "unpaired_because")
    return {"image": entry.id, **{name: getattr(entry, name) for name in names + times}}
