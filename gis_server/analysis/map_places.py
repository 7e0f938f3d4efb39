"""The ground at a place of the map, the stop that it stands on, and the images near it."""

from __future__ import annotations

import numpy as np

from solmap.gis_server.analysis.ground import Ground
from solmap.gis_server.analysis.refusal import RefusedError
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.resampling import NOWHERE
from solmap.photogrammetry.terrain.measure.ground_point import GroundPoint, normal_at
from solmap.photogrammetry.terrain.measure.oriented_image import StopPose
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.model import Layer, ScopeLevel

NORMAL_M = 0.25
"""Half of the square that the normal of the ground is found in: the baseline of slopes."""
MOST_IMAGES = 400
"""Images that one question looks at: those of some twenty panoramas."""


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


def stop_named(mission: OrientedMission, name: str) -> StopId:
    """A stop of the network by its name.

    Raises:
        RefusedError: the network has none of that name.
    """
    for stop in mission.stops:
        if str(stop) == name:
            return stop
    raise RefusedError(f"{name} is no stop of the latest network of this mission")
