"""From an image onto the ground: what a pixel shows, and which stops and images are near a place.

The ground at a pixel follows from its matched parallax, else from the intersection of its ray with
a terrain model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.gis_server.analysis.bodies import UnanswerableError
from solmap.gis_server.analysis.ground import Ground
from solmap.photogrammetry.arrays import Float64, ImagePoints, Vector3
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.resampling import NOWHERE
from solmap.photogrammetry.terrain.measure.ground_point import (
    GroundPoint,
    ground_normal,
    intersect_terrain,
    matched_pixel,
    range_to_ground,
    triangulate_pixel,
)
from solmap.photogrammetry.terrain.measure.oriented_image import (
    OrientedImage,
    StopPose,
    epipolar_curve,
)
from solmap.photogrammetry.terrain.visibility.viewshed import ViewshedParams
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.model import Layer, ScopeLevel

NORMAL_M = 0.25
"""Half the side of the square for the normal of the ground: the baseline of slopes."""
MOST_IMAGES = 400
"""Most images of one query: those of some twenty panoramas."""
_USUAL = ViewshedParams()
_NEAREST_M, _FURTHEST_M, _CURVE_POINTS = 1.0, 200.0, 96
"""Ranges between which a ray is followed into other images, and its points there."""


def point_on_map(
    place: tuple[float, float], mission: OrientedMission, ground: Ground
) -> tuple[GroundPoint, Layer]:
    """The ground at a place of the map.

    Raises:
        UnanswerableError: the ground there is in no terrain model.
    """
    at = ground.at(np.array([place]))
    number = int(at.source[0])
    if number == NOWHERE:
        raise UnanswerableError(
            f"the ground at east {place[0]:.2f}, north {place[1]:.2f} has no elevation; give one "
            "as `elevation`, or choose a place on mapped ground"
        )
    layer = ground.models[number]
    up = np.array([*place, float(at.elevation[0])])
    normal = ground_normal(np.array(place), ground.elevation, NORMAL_M)
    frame = frame_of(layer, mission, place)
    covariance = np.diag([0.0, 0.0, float(np.nan_to_num(at.own_sigma_m[0])) ** 2])
    return GroundPoint(MAP_FROM_LSL.T @ up, covariance, frame, normal), layer


def frame_of(layer: Layer, mission: OrientedMission, place: tuple[float, float]) -> StopPose:
    """The stop of a terrain model; for a region, the stop nearest to a place."""
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


def stop_named(mission: OrientedMission, name: str) -> StopId:
    """A stop of the network by its name.

    Raises:
        UnanswerableError: the network has none of that name.
    """
    for stop in mission.stops:
        if str(stop) == name:
            return stop
    raise UnanswerableError(f"{name} is not a stop of the latest network of this mission")


@dataclass(frozen=True, slots=True, eq=False)
class PixelGround:
    """The ground at a pixel, and the source of its range."""

    ground: GroundPoint
    told_by: str
    layer: Layer | None
    """The intersected terrain model."""


def ground_at(
    entry: ImageEntry,
    point: tuple[float, float],
    sigma_px: float,
    mission: OrientedMission,
    ground: Ground,
) -> PixelGround | None:
    """The ground at a pixel: by its matched parallax, else by the intersection of its ray."""
    image = mission.oriented_image(entry)
    if not image.shows(np.array(point)):
        raise UnanswerableError(
            f"{entry.id} has {image.size[0]} samples and {image.size[1]} lines; "
            f"sample {point[0]:g}, line {point[1]:g} is not on it"
        )
    found = _intersect_by_parallax(entry, image, point, sigma_px, mission)
    if found is not None:
        normal = ground_normal(found.on_map[:2], ground.elevation, NORMAL_M)
        whole = GroundPoint(found.point, found.covariance, found.frame, normal)
        return PixelGround(whole, "parallax", None)
    return _intersect_ray(image, point, sigma_px, mission, ground)


def _intersect_by_parallax(
    entry: ImageEntry,
    image: OrientedImage,
    point: tuple[float, float],
    sigma_px: float,
    mission: OrientedMission,
) -> GroundPoint | None:
    eyes, pair = mission.stereo_partners(entry), mission.pair_of(entry)
    if eyes is None or pair is None:
        return None
    camera, eye, dense = eyes.camera(entry.eye), Eye(entry.eye), eyes.dense
    found = matched_pixel(point, eye, camera, eyes.geometry, dense.parallax_px, dense.sigma_px)
    if found is None:
        return None
    left = np.array(found.left)
    sigmas = (sigma_px, found.sigma_px)
    return triangulate_pixel(
        image, eyes.geometry, pair.lsl_from_pair, left, found.parallax_px, sigmas
    )


def _intersect_ray(
    image: OrientedImage,
    point: tuple[float, float],
    sigma_px: float,
    mission: OrientedMission,
    ground: Ground,
) -> PixelGround | None:
    start, ray = image.ray(np.array(point))
    step = ground.finest_cell_m
    distance = range_to_ground(start, ray, ground.elevation, _USUAL.radius_m, step)
    if distance is None:
        return None
    met: Vector3 = start + distance * ray
    east, north = (MAP_FROM_LSL @ met)[:2].tolist()
    at = ground.at(np.array([[east, north]]))
    if int(at.source[0]) == NOWHERE:
        return None
    layer = ground.models[int(at.source[0])]
    normal = ground_normal(np.array([east, north]), ground.elevation, NORMAL_M)
    known = (
        normal,
        float(np.nan_to_num(at.own_sigma_m[0])),
        frame_of(layer, mission, (east, north)),
    )
    return PixelGround(
        intersect_terrain(image, met, ray, known, sigma_px, pixel_angle(image, point)),
        "terrain",
        layer,
    )


def pixel_angle(image: OrientedImage, point: tuple[float, float]) -> float:
    """Angular size of a pixel, radians."""
    around = np.array(point) + np.array([[-0.5, 0.0], [0.5, 0.0]])
    rays = image.camera.rays(around)
    return float(np.linalg.norm(rays[1] - rays[0]))


def epipolar_curve_in(
    image: OrientedImage, point: tuple[float, float], into: OrientedImage
) -> tuple[ImagePoints, Float64[np.ndarray, " k"]]:
    """The epipolar curve of a pixel in another image."""
    ranges = np.geomspace(_NEAREST_M, _FURTHEST_M, _CURVE_POINTS)
    return epipolar_curve(image, np.array(point), into, ranges)
