"""From the ground into images: projection of a place, its uncertainty and its visibility.

Image points are (sample, line) of the image as stored: (0, 0) is the centre of its first pixel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.analysis.bodies import (
    SIGHT_NAMES,
    UNITS,
    LayerUsed,
    NetworkUsed,
    json_number,
    json_numbers,
)
from solmap.gis_server.analysis.ground import Ground
from solmap.gis_server.analysis.image_to_ground import PixelGround
from solmap.photogrammetry.arrays import Float64, ImagePoints
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import GroundPoint, sight_by_parallax
from solmap.photogrammetry.terrain.measure.oriented_image import (
    Ellipse,
    OrientedImage,
    image_covariance_from,
)
from solmap.photogrammetry.terrain.visibility.viewshed import (
    Sight,
    ViewshedParams,
    sight_line,
    sight_line_stations,
)
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission

_USUAL = ViewshedParams()
LIFT_M = 0.05
"""Tolerance of the height of the ground: some two standard deviations of a terrain model.

Noise of the model then hides nothing from grazing views.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedPoint:
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
    """Source of the visibility: parallax, terrain, or none."""
    linearised: tuple[float, float] | None
    """The place in the left or right epipolar image of its pair."""


def project_into(
    entry: ImageEntry, target: GroundPoint, mission: OrientedMission
) -> ProjectedPoint | None:
    """A place of the ground in an image, without visibility; None if it is outside the image."""
    image = mission.oriented_image(entry)
    point = image.camera.project(target.point[None])[0]
    if not image.shows(point):
        return None
    covariance = image_covariance_from(image, target.point, target.covariance, target.frame)
    view = image.camera.centre - target.point
    distance = float(np.linalg.norm(view))
    normal = target.normal
    incidence = (
        None if normal is None else float(np.arccos(np.clip(view @ normal / distance, -1, 1)))
    )
    return ProjectedPoint(
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


def add_visibility(
    seen: Sequence[ProjectedPoint], target: GroundPoint, mission: OrientedMission, ground: Ground
) -> list[ProjectedPoint]:
    """The image points with the visibility in each image.

    Visibility follows from the matched parallax of the pair, or from the terrain between. The
    terrain is read once for all images.
    """
    by_pair = [_by_pair(one, target, mission) for one in seen]
    not_hidden = [k for k, (sight, _) in enumerate(by_pair) if sight is not Sight.HIDDEN]
    between = dict(
        zip(not_hidden, _by_terrain([seen[k] for k in not_hidden], target, ground), strict=True)
    )
    return [
        _with_sight(one, sight, between.get(k), linearised)
        for k, (one, (sight, linearised)) in enumerate(zip(seen, by_pair, strict=True))
    ]


def _with_sight(
    seen: ProjectedPoint,
    by_pair: Sight,
    between: Sight | None,
    linearised: tuple[float, float] | None,
) -> ProjectedPoint:
    sight, told_by = by_pair, "parallax"
    if between is not None and (between is Sight.HIDDEN or by_pair is Sight.UNKNOWN):
        sight, told_by = between, "terrain"
    told_by = told_by if sight is not Sight.UNKNOWN else "nothing"
    return replace(seen, sight=sight, told_by=told_by, linearised=linearised)


def _by_pair(
    seen: ProjectedPoint, target: GroundPoint, mission: OrientedMission
) -> tuple[Sight, tuple[float, float] | None]:
    eyes, pair = mission.stereo_partners(seen.entry), mission.pair_of(seen.entry)
    if eyes is None or pair is None:
        return Sight.UNKNOWN, None
    left, parallax = eyes.geometry.project(pair.lsl_from_pair.inverse.apply(target.point[None]))
    shift = parallax[0] if seen.entry.eye == Eye.RIGHT else 0.0
    sight = sight_by_parallax(
        target.point,
        target.covariance + seen.image.pointing_covariance_at(target.point),
        pair.lsl_from_pair,
        Eye(seen.entry.eye),
        eyes.geometry,
        eyes.dense.parallax_px,
    )
    return sight, (float(left[0, 0] - shift), float(left[0, 1]))


def _by_terrain(seen: Sequence[ProjectedPoint], target: GroundPoint, ground: Ground) -> list[Sight]:
    if not seen:
        return []
    sigma = float(np.sqrt(max(target.covariance[2, 2], 0.0)))
    aim = target.on_map + np.array([0.0, 0.0, max(LIFT_M, 2 * sigma)])
    eyes = [MAP_FROM_LSL @ one.image.camera.centre for one in seen]
    ways = [sight_line_stations(eye, aim, ground.finest_cell_m) for eye in eyes]
    heights = ground.elevation(np.concatenate(ways))
    parts = np.split(heights, np.cumsum([len(way) for way in ways])[:-1])
    return [
        sight_line(eye, aim, way, part, _USUAL.max_unseen_m).sight
        for eye, way, part in zip(eyes, ways, parts, strict=True)
    ]


class EllipseBody(BaseModel):
    """A standard error ellipse (one sigma); nine in ten are within 2.15 times its size."""

    semi_major_px: float
    semi_minor_px: float
    angle_deg: float
    """Angle of the major axis, from the direction of samples towards that of lines (clockwise)."""


class GroundBody(BaseModel):
    """A place on the ground and its uncertainty relative to the held stop."""

    east: float
    north: float
    elevation_m: float
    sigma_east_m: float
    sigma_north_m: float
    sigma_up_m: float
    covariance_m2: list[list[float]]
    """Covariance of the place (east, north, up)."""
    ellipse_semi_major_m: float
    ellipse_semi_minor_m: float
    ellipse_azimuth_deg: float
    """Azimuth of the error ellipse on the map."""
    own_sigma_m: float
    """Largest axis of the error relative to `measured_from`, without the uncertainty of that stop's
    own position."""
    measured_from: str
    """The stop that the place was measured from."""
    normal: list[float] | None
    """Normal of the ground, (east, north, up)."""


class SeenBody(BaseModel):
    """A place in one image."""

    image: str
    stop: str
    sol: int
    instrument: str
    eye: str
    sample: float
    line: float
    ellipse: EllipseBody
    range_m: float
    incidence_deg: float | None
    """Angle between the line of sight and the normal of the ground: 90 is grazing."""
    sight: str
    """visible, hidden or unknown."""
    told_by: str
    """parallax: the matched parallax of the pair; terrain: the ground between; nothing."""
    linearised_sample: float | None
    linearised_line: float | None
    """The place in the linearised image used for matching."""
    browse: ServerPath
    original: ServerPath


class CurvePoint(BaseModel):
    """A point on an epipolar curve and its range from the first image."""

    sample: float
    line: float
    range_m: float


class PredictedBody(SeenBody):
    """Predicted image point of a point of one image in another."""

    epipolar: list[CurvePoint]


class GroundToImage(BaseModel):
    """The images that show a place, visible ones first, then by distance."""

    units: str = UNITS
    ground: GroundBody
    network: NetworkUsed
    layers: list[LayerUsed]
    images: list[SeenBody]
    looked_at: int
    """Images of the stops within reach."""


class ImageToGround(BaseModel):
    """The ground at a pixel."""

    units: str = UNITS
    image: str
    sample: float
    line: float
    ground: GroundBody | None
    """null: the ray meets no known ground within reach."""
    told_by: str
    """parallax, terrain or nothing."""
    network: NetworkUsed
    layers: list[LayerUsed]


class ImageToImage(ImageToGround):
    """Predicted image points of a pixel in other images."""

    images: list[PredictedBody]
    curves: dict[str, list[CurvePoint]]
    """Epipolar curves in images where no place could be predicted."""


def ground_body(target: GroundPoint) -> GroundBody:
    """Response with a place."""
    east, north, up = target.on_map.tolist()
    total = target.total_covariance
    sigmas = np.sqrt(np.maximum(np.diagonal(total), 0.0)).tolist()
    ellipse = Ellipse.of(total[:2, :2])
    normal = None if target.normal is None else (MAP_FROM_LSL @ target.normal).round(4).tolist()
    return GroundBody(
        east=round(east, 4),
        north=round(north, 4),
        elevation_m=round(up, 4),
        sigma_east_m=round(sigmas[0], 4),
        sigma_north_m=round(sigmas[1], 4),
        sigma_up_m=round(sigmas[2], 4),
        covariance_m2=total.round(8).tolist(),
        ellipse_semi_major_m=round(ellipse.semi_major, 4),
        ellipse_semi_minor_m=round(ellipse.semi_minor, 4),
        ellipse_azimuth_deg=round((90.0 - math.degrees(ellipse.angle)) % 180.0, 1),
        own_sigma_m=round(float(np.sqrt(np.linalg.eigvalsh(target.covariance)[-1])), 4),
        measured_from=str(target.frame.stop),
        normal=normal,
    )


def seen_body(seen: ProjectedPoint) -> SeenBody:
    """Response with a place in an image."""
    return SeenBody(**_seen_fields(seen))


def predicted_body(
    seen: ProjectedPoint, curve: tuple[ImagePoints, Float64[np.ndarray, " k"]]
) -> PredictedBody:
    """Response with a predicted point and its epipolar curve."""
    return PredictedBody(**_seen_fields(seen), epipolar=curve_body(curve))


def curve_body(curve: tuple[ImagePoints, Float64[np.ndarray, " k"]]) -> list[CurvePoint]:
    """Response with an epipolar curve."""
    return [
        CurvePoint(sample=round(x, 2), line=round(y, 2), range_m=round(r, 3))
        for (x, y), r in zip(curve[0].tolist(), curve[1].tolist(), strict=True)
    ]


def _layers_used(found: PixelGround | None) -> list[LayerUsed]:
    """The terrain model used for a pixel's ground, if any."""
    return [LayerUsed.of(found.layer)] if found and found.layer else []


def _seen_fields(seen: ProjectedPoint) -> dict[str, Any]:
    entry: ImageEntry = seen.entry
    ellipse = seen.ellipse
    incidence = None if seen.incidence is None else math.degrees(seen.incidence)
    sample, line = seen.linearised or (None, None)
    known = {name: getattr(entry, name) for name in ("stop", "sol", "instrument", "eye")}
    place = dict(zip(("sample", "line"), json_numbers(seen.point, 3), strict=True))
    return {
        **known,
        **place,
        "image": entry.id,
        "ellipse": EllipseBody(
            semi_major_px=round(ellipse.semi_major, 3),
            semi_minor_px=round(ellipse.semi_minor, 3),
            angle_deg=round(math.degrees(ellipse.angle), 2),
        ),
        "range_m": round(seen.range_m, 4),
        "incidence_deg": json_number(incidence, 2),
        "sight": SIGHT_NAMES[seen.sight],
        "told_by": seen.told_by,
        "linearised_sample": json_number(sample, 3),
        "linearised_line": json_number(line, 3),
        "browse": f"/images/{entry.id}/browse.png",
        "original": f"/images/{entry.id}/original",
    }
