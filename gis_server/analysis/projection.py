"""From the ground into images: where a place falls on them, how surely, and whether they see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solmap.gis_server.analysis.ground import Ground
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import GroundPoint, sight_by_parallax
from solmap.photogrammetry.terrain.measure.oriented_image import (
    Ellipse,
    OrientedImage,
    in_images_of,
)
from solmap.photogrammetry.terrain.visibility.viewshed import (
    Sight,
    ViewshedParams,
    places_between,
    sight_line,
)
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission

_USUAL = ViewshedParams()
LIFT_M = 0.05
"""By which the ground at a place may be lower than it is: some two standard deviations of a terrain
model, so that its noise hides nothing from grazing views."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A place of the ground in an image."""

    entry: ImageEntry
    image: OrientedImage
    point: Float64[np.ndarray, " 2"]
    """(sample, line) in the image as stored."""
    ellipse: Ellipse
    range_m: float
    incidence: float | None
    """Angle between the line of sight and the normal of the ground, radians."""
    sight: Sight
    told_by: str
    """What says so: parallax, terrain, or nothing."""
    linearised: tuple[float, float] | None
    """The place in the left or right epipolar image of its pair."""


def seen_in(entry: ImageEntry, target: GroundPoint, mission: OrientedMission) -> Seen | None:
    """A place of the ground in an image; None where it does not fall on it. Not yet if in sight."""
    image = mission.oriented(entry)
    point = image.camera.project(target.point[None])[0]
    if not image.shows(point):
        return None
    covariance = in_images_of(image, target.point, target.covariance, target.frame)
    view = image.camera.centre - target.point
    distance = float(np.linalg.norm(view))
    normal = target.normal
    incidence = (
        None if normal is None else float(np.arccos(np.clip(view @ normal / distance, -1, 1)))
    )
    return Seen(
        entry,
        image,
        point,
        Ellipse.of(covariance),
        distance,
        incidence,
        Sight.UNKNOWN,
        "nothing",
        None,
    )


def with_sight(
    seen: Sequence[Seen], target: GroundPoint, mission: OrientedMission, ground: Ground
) -> list[Seen]:
    """The same with whether each image sees it.

    What hides it, by the parallax its pair was matched with or by the terrain between, hides it.
    The terrain is read once for all images.
    """
    by_pair = [_by_pair(one, target, mission) for one in seen]
    asked = [k for k, (sight, _) in enumerate(by_pair) if sight is not Sight.HIDDEN]
    between = dict(zip(asked, _by_terrain([seen[k] for k in asked], target, ground), strict=True))
    return [
        _told(one, sight, between.get(k), linearised)
        for k, (one, (sight, linearised)) in enumerate(zip(seen, by_pair, strict=True))
    ]


def _told(
    seen: Seen, by_pair: Sight, between: Sight | None, linearised: tuple[float, float] | None
) -> Seen:
    sight, told_by = by_pair, "parallax"
    if between is not None and (between is Sight.HIDDEN or by_pair is Sight.UNKNOWN):
        sight, told_by = between, "terrain"
    told_by = told_by if sight is not Sight.UNKNOWN else "nothing"
    return replace(seen, sight=sight, told_by=told_by, linearised=linearised)


def _by_pair(
    seen: Seen, target: GroundPoint, mission: OrientedMission
) -> tuple[Sight, tuple[float, float] | None]:
    eyes, pair = mission.eyes(seen.entry), mission.pair_of(seen.entry)
    if eyes is None or pair is None:
        return Sight.UNKNOWN, None
    left, parallax = eyes.geometry.project(pair.lsl_from_pair.inverse.apply(target.point[None]))
    shift = parallax[0] if seen.entry.eye == Eye.RIGHT else 0.0
    sight = sight_by_parallax(
        target.point,
        target.covariance + seen.image.pointing_at(target.point),
        pair.lsl_from_pair,
        Eye(seen.entry.eye),
        eyes.geometry,
        eyes.dense.parallax_px,
    )
    return sight, (float(left[0, 0] - shift), float(left[0, 1]))


def _by_terrain(seen: Sequence[Seen], target: GroundPoint, ground: Ground) -> list[Sight]:
    if not seen:
        return []
    sigma = float(np.sqrt(max(target.covariance[2, 2], 0.0)))
    aim = target.on_map + np.array([0.0, 0.0, max(LIFT_M, 2 * sigma)])
    eyes = [MAP_FROM_LSL @ one.image.camera.centre for one in seen]
    ways = [places_between(eye, aim, ground.finest_cell_m) for eye in eyes]
    heights = ground.elevation(np.concatenate(ways))
    parts = np.split(heights, np.cumsum([len(way) for way in ways])[:-1])
    return [
        sight_line(eye, aim, way, part, _USUAL.max_unseen_m).sight
        for eye, way, part in zip(eyes, ways, parts, strict=True)
    ]
