"""Projection between map and images, and from image to image."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query

from solmap.gis_server.analysis.bodies import LayerUsed, NetworkUsed, UnanswerableError
from solmap.gis_server.analysis.ground import BEST, Ground
from solmap.gis_server.analysis.image_to_ground import (
    PixelGround,
    epipolar_curve_in,
    frame_of,
    ground_at,
    images_within,
    point_on_map,
    stop_named,
)
from solmap.gis_server.analysis.projection import (
    GroundToImage,
    ImageToGround,
    ImageToImage,
    _layers_used,
    add_visibility,
    curve_body,
    ground_body,
    predicted_body,
    project_into,
    seen_body,
)
from solmap.gis_server.parameters import Metres, MissionName, ground_of
from solmap.gis_server.services import Services, ServicesOf
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import GroundPoint
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace

router = APIRouter(prefix="/api/missions/{mission}", tags=["projection"])
_LARGEST_PX = 1e5

ImageId = Annotated[str, Query(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,127}$")]
Pixel = Annotated[float, Query(ge=-1, le=_LARGEST_PX, allow_inf_nan=False)]
Sigma = Annotated[
    float, Query(gt=0, le=100, description="standard deviation of the point that is given, pixels")
]
Reach = Annotated[float, Query(gt=0, le=500, description="of stops from the place, metres")]
LayerId = Annotated[str, Query(max_length=200, description="a terrain model, or `best`")]


@router.get("/ground-to-image")
def ground_to_image(  # noqa: PLR0913 - the parameters of the question
    *,
    mission: MissionName,
    east: Metres,
    north: Metres,
    services: ServicesOf,
    elevation: Annotated[
        float | None, Query(ge=-1e5, le=1e5, description="of the place; by default the ground's")
    ] = None,
    layer: LayerId = BEST,
    within_m: Reach = 60.0,
) -> GroundToImage:
    """Every image that shows a place of the map, with image point, uncertainty and visibility."""
    known, ground = _network_and_ground(mission, layer, services)
    target, layers = _target((east, north), elevation, known, ground)
    entries = images_within(known, mission, (east, north), within_m)
    seen = [found for entry in entries if (found := project_into(entry, target, known))]
    visible = add_visibility(seen, target, known, ground)
    order = {"visible": 0, "unknown": 1, "hidden": 2}
    bodies = [seen_body(found) for found in visible]
    bodies.sort(key=lambda body: (order[body.sight], body.range_m))
    return GroundToImage(
        ground=ground_body(target),
        network=NetworkUsed.of(known.ref),
        layers=layers,
        images=bodies,
        looked_at=len(entries),
    )


@router.get("/image-to-ground")
def image_to_ground(  # noqa: PLR0913 - the parameters of the question
    *,
    mission: MissionName,
    image: ImageId,
    sample: Pixel,
    line: Pixel,
    services: ServicesOf,
    layer: LayerId = BEST,
    sigma_px: Sigma = 0.5,
) -> ImageToGround:
    """The ground at a pixel, by its matched parallax or by the terrain."""
    known, ground = _network_and_ground(mission, layer, services)
    entry = _entry(mission, image, services)
    found = ground_at(entry, (sample, line), sigma_px, known, ground)
    return ImageToGround(**_pixel(entry, (sample, line), found, known))


@router.get("/image-to-image")
def image_to_image(  # noqa: PLR0913 - the parameters of the question
    *,
    mission: MissionName,
    image: ImageId,
    sample: Pixel,
    line: Pixel,
    services: ServicesOf,
    stop: Annotated[
        str | None,
        Query(max_length=128, description="whose images are searched; by default all near"),
    ] = None,
    layer: LayerId = BEST,
    sigma_px: Sigma = 0.5,
    within_m: Reach = 60.0,
) -> ImageToImage:
    """Predicted image points of a pixel in other images, with error ellipse and epipolar curve."""
    known, ground = _network_and_ground(mission, layer, services)
    entry = _entry(mission, image, services)
    found = ground_at(entry, (sample, line), sigma_px, known, ground)
    others = _others(mission, entry, found, stop, within_m, known)
    one = known.oriented_image(entry)
    curves = {
        other.id: epipolar_curve_in(one, (sample, line), known.oriented_image(other))
        for other in others
    }
    seen = [s for other in others if found and (s := project_into(other, found.ground, known))]
    visible = add_visibility(seen, found.ground, known, ground) if found else []
    images = [predicted_body(place, curves[place.entry.id]) for place in visible]
    alone = {} if found else {name: curve_body(c) for name, c in curves.items() if len(c[0])}
    images.sort(key=lambda body: (body.sight == "hidden", body.range_m))
    return ImageToImage(**_pixel(entry, (sample, line), found, known), images=images, curves=alone)


def _network_and_ground(
    mission: str, layer: str, services: Services
) -> tuple[OrientedMission, Ground]:
    ground = ground_of(mission, layer, services)
    workspace = Workspace(services.store, services.catalogue)
    return OrientedMission.latest(mission, workspace), ground


def _entry(mission: str, image: str, services: Services) -> ImageEntry:
    entry = services.catalogue.image(image.upper())
    if entry.mission != mission:
        raise UnanswerableError(f"{entry.id} is an image of {entry.mission}, not of {mission}")
    return entry


def _target(
    place: tuple[float, float], elevation: float | None, known: OrientedMission, ground: Ground
) -> tuple[GroundPoint, list[LayerUsed]]:
    """The ground at a place, or a point in the air above or below it."""
    if elevation is None:
        target, layer = point_on_map(place, known, ground)
        return target, [LayerUsed.of(layer)]
    point = MAP_FROM_LSL.T @ np.array([*place, elevation])
    frame = frame_of(ground.models[0], known, place)
    return GroundPoint(point, np.zeros((3, 3)), frame), []


def _others(
    mission: str,
    entry: ImageEntry,
    found: PixelGround | None,
    stop: str | None,
    within_m: float,
    known: OrientedMission,
) -> list[ImageEntry]:
    if stop is not None:
        candidates = known.workspace.catalogue.images(mission, str(stop_named(known, stop)))
    else:
        centre = MAP_FROM_LSL @ known.oriented_image(entry).camera.centre
        place = found.ground.on_map if found else centre
        candidates = images_within(known, mission, (float(place[0]), float(place[1])), within_m)
    return [other for other in candidates if other.id != entry.id]


def _pixel(
    entry: ImageEntry, point: tuple[float, float], found: PixelGround | None, known: OrientedMission
) -> dict[str, Any]:
    return {
        "image": entry.id,
        "sample": point[0],
        "line": point[1],
        "ground": ground_body(found.ground) if found else None,
        "told_by": found.told_by if found else "nothing",
        "network": NetworkUsed.of(known.ref),
        "layers": _layers_used(found),
    }
