"""From the map into images, from an image onto the map, and from one image into others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gis_server.analysis.ground import Ground
from gis_server.analysis.refusal import RefusedError
from photogrammetry.arrays import Float64, ImagePoints, Vector3
from photogrammetry.imagery import Eye, StopId
from photogrammetry.terrain.ground import MAP_FROM_LSL
from photogrammetry.terrain.ground_point import (
    GroundPoint,
    by_parallax,
    first_meeting,
    normal_at,
    on_terrain,
)
from photogrammetry.terrain.ground_samples import NOWHERE
from photogrammetry.terrain.matched_pixel import matched_pixel, sight_by_parallax
from photogrammetry.terrain.oriented_image import (
    Ellipse,
    OrientedImage,
    StopPose,
    epipolar_curve,
    in_images_of,
)
from photogrammetry.terrain.sight_line import places_between, sight_line
from photogrammetry.terrain.viewshed import Sight, ViewshedParams
from products.catalogue import ImageEntry
from products.model import Layer, ScopeLevel
from products.oriented import OrientedMission

NORMAL_M = 0.25
"""Half of the square that the normal of the ground is found in: the baseline of slopes."""
SIGHT = ViewshedParams()
LIFT_M = 0.05
"""By which the ground at a place may be lower than it is: some two standard deviations of a terrain
model, so that its noise hides nothing from grazing views."""
MOST_IMAGES = 400
"""Images that one question looks at: those of some twenty panoramas."""
NEAREST_M, FURTHEST_M, CURVE_POINTS = 1.0, 200.0, 96


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


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The ground at a pixel, and what it was found by."""

    ground: GroundPoint
    told_by: str
    layer: Layer | None
    """The terrain model that was met."""


def point_on_map(
    place: tuple[float, float], mission: OrientedMission, ground: Ground
) -> tuple[GroundPoint, Layer]:
    """The ground at a place of the map.

    Raises:
        RefusedError: no terrain model knows the ground there.
    """
    at = ground.at(np.array([place]))
    number = int(at.source[0])
    if number == NOWHERE:
        raise RefusedError(
            f"the ground at east {place[0]:.2f}, north {place[1]:.2f} has no elevation; give one "
            "as `elevation`, or take a place on mapped ground"
        )
    layer = ground.models[number]
    up = np.array([*place, float(at.elevation[0])])
    normal = normal_at(np.array(place), ground.elevation, NORMAL_M)
    frame = frame_of(layer, mission, place)
    covariance = np.diag([0.0, 0.0, float(np.nan_to_num(at.own_sigma_m[0])) ** 2])
    return GroundPoint(MAP_FROM_LSL.T @ up, covariance, frame, normal), layer


def frame_of(layer: Layer, mission: OrientedMission, place: tuple[float, float]) -> StopPose:
    """The stop that a terrain model stands on; of a region's, the nearest one to a place."""
    if layer.ref.scope.level is ScopeLevel.STOP:
        for pose in mission.stops.values():
            if str(pose.stop) == layer.ref.scope.name:
                return pose
    return nearest_stops(mission, place)[0][1]


def nearest_stops(
    mission: OrientedMission, place: tuple[float, float]
) -> list[tuple[float, StopPose]]:
    """The stops by their distance from a place on the map."""
    found = [
        (float(np.hypot(*((MAP_FROM_LSL @ p.lsl_from_rover.translation_m)[:2] - place))), p)
        for p in mission.stops.values()
    ]
    return sorted(found, key=lambda pair: pair[0])


def images_within(
    mission: OrientedMission, name: str, place: tuple[float, float], within_m: float
) -> list[ImageEntry]:
    """The images of the stops within reach of a place, nearest stop first."""
    entries: list[ImageEntry] = []
    for distance, pose in nearest_stops(mission, place):
        if distance > within_m or len(entries) >= MOST_IMAGES:
            break
        entries += mission.workspace.catalogue.images(name, str(pose.stop))
    return entries[:MOST_IMAGES]


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
        sight_line(eye, aim, way, part, SIGHT.max_unseen_m).sight
        for eye, way, part in zip(eyes, ways, parts, strict=True)
    ]


def ground_at(
    entry: ImageEntry,
    point: tuple[float, float],
    sigma_px: float,
    mission: OrientedMission,
    ground: Ground,
) -> Found | None:
    """The ground at a pixel: by its parallax where it was matched, else where its ray meets."""
    image = mission.oriented(entry)
    if not image.shows(np.array(point)):
        raise RefusedError(
            f"{entry.id} has {image.size[0]} samples and {image.size[1]} lines; "
            f"sample {point[0]:g}, line {point[1]:g} is not on it"
        )
    found = _matched_at(entry, image, point, sigma_px, mission)
    if found is not None:
        normal = normal_at(found.on_map[:2], ground.elevation, NORMAL_M)
        whole = GroundPoint(found.point, found.covariance, found.frame, normal)
        return Found(whole, "parallax", None)
    return _met_by_ray(image, point, sigma_px, mission, ground)


def _matched_at(
    entry: ImageEntry,
    image: OrientedImage,
    point: tuple[float, float],
    sigma_px: float,
    mission: OrientedMission,
) -> GroundPoint | None:
    eyes, pair = mission.eyes(entry), mission.pair_of(entry)
    if eyes is None or pair is None:
        return None
    camera, eye, dense = eyes.camera(entry.eye), Eye(entry.eye), eyes.dense
    found = matched_pixel(point, eye, camera, eyes.geometry, dense.parallax_px, dense.sigma_px)
    if found is None:
        return None
    left = np.array(found.left)
    sigmas = (sigma_px, found.sigma_px)
    return by_parallax(image, eyes.geometry, pair.lsl_from_pair, left, found.parallax_px, sigmas)


def _met_by_ray(
    image: OrientedImage,
    point: tuple[float, float],
    sigma_px: float,
    mission: OrientedMission,
    ground: Ground,
) -> Found | None:
    start, ray = image.ray(np.array(point))
    step = ground.finest_cell_m
    distance = first_meeting(start, ray, ground.elevation, SIGHT.radius_m, step)
    if distance is None:
        return None
    met: Vector3 = start + distance * ray
    east, north = (MAP_FROM_LSL @ met)[:2].tolist()
    at = ground.at(np.array([[east, north]]))
    if int(at.source[0]) == NOWHERE:
        return None
    layer = ground.models[int(at.source[0])]
    normal = normal_at(np.array([east, north]), ground.elevation, NORMAL_M)
    known = (
        normal,
        float(np.nan_to_num(at.own_sigma_m[0])),
        frame_of(layer, mission, (east, north)),
    )
    return Found(
        on_terrain(image, met, ray, known, sigma_px, pixel_angle(image, point)), "terrain", layer
    )


def pixel_angle(image: OrientedImage, point: tuple[float, float]) -> float:
    """Angle that a pixel takes up, radians."""
    around = np.array(point) + np.array([[-0.5, 0.0], [0.5, 0.0]])
    rays = image.camera.rays(around)
    return float(np.linalg.norm(rays[1] - rays[0]))


def curve_in(
    image: OrientedImage, point: tuple[float, float], into: OrientedImage
) -> tuple[ImagePoints, Float64[np.ndarray, " k"]]:
    """The epipolar curve of a pixel in another image."""
    ranges = np.geomspace(NEAREST_M, FURTHEST_M, CURVE_POINTS)
    return epipolar_curve(image, np.array(point), into, ranges)


def stop_named(mission: OrientedMission, name: str) -> StopId:
    """A stop of the network by its name.

    Raises:
        RefusedError: the network has none of that name.
    """
    for stop in mission.stops:
        if str(stop) == name:
            return stop
    raise RefusedError(f"{name} is no stop of the latest network of this mission")
