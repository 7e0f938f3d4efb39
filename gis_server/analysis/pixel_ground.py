"""From an image onto the ground, and along the ray of a pixel into other images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.gis_server.analysis.ground import Ground
from solmap.gis_server.analysis.map_places import NORMAL_M, frame_of
from solmap.gis_server.analysis.refusal import RefusedError
from solmap.photogrammetry.arrays import Float64, ImagePoints, Vector3
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.resampling import NOWHERE
from solmap.photogrammetry.terrain.measure.ground_point import (
    GroundPoint,
    by_parallax,
    first_meeting,
    matched_pixel,
    normal_at,
    on_terrain,
)
from solmap.photogrammetry.terrain.measure.oriented_image import OrientedImage, epipolar_curve
from solmap.photogrammetry.terrain.visibility.viewshed import ViewshedParams
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.model import Layer

_USUAL = ViewshedParams()
_NEAREST_M, _FURTHEST_M, _CURVE_POINTS = 1.0, 200.0, 96
"""Ranges between which a ray is followed into other images, and its points there."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The ground at a pixel, and what it was found by."""

    ground: GroundPoint
    told_by: str
    layer: Layer | None
    """The terrain model that was met."""


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
    distance = first_meeting(start, ray, ground.elevation, _USUAL.radius_m, step)
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
    ranges = np.geomspace(_NEAREST_M, _FURTHEST_M, _CURVE_POINTS)
    return epipolar_curve(image, np.array(point), into, ranges)
