"""What the projection endpoints answer.

Image points are (sample, line) of the image as stored: (0, 0) is the centre of its first pixel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import (
    SIGHT_NAMES,
    UNITS,
    LayerUsed,
    NetworkUsed,
    number,
    numbers,
)
from solmap.gis_server.analysis.pixel_ground import Found
from solmap.gis_server.analysis.projection import Seen
from solmap.photogrammetry.arrays import Float64, ImagePoints
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import GroundPoint
from solmap.photogrammetry.terrain.measure.oriented_image import Ellipse
from solmap.products.catalogue.catalogue import ImageEntry


class EllipseBody(BaseModel):
    """A standard error ellipse (one sigma); nine in ten are within 2.15 times its size."""

    semi_major_px: float
    semi_minor_px: float
    angle_deg: float
    """Of the major axis, from the direction of samples towards that of lines (clockwise)."""


class GroundBody(BaseModel):
    """A place on the ground and how sure it is, against the stop that is held fixed."""

    east: float
    north: float
    elevation_m: float
    sigma_east_m: float
    sigma_north_m: float
    sigma_up_m: float
    covariance_m2: list[list[float]]
    """Of (east, north, up)."""
    ellipse_semi_major_m: float
    ellipse_semi_minor_m: float
    ellipse_azimuth_deg: float
    """Of the error ellipse on the map."""
    own_sigma_m: float
    """Largest axis of the error against `measured_from` alone, without what that stop does not
    know of its own place."""
    measured_from: str
    """The stop that the place was measured from."""
    normal: list[float] | None
    """Of the ground, (east, north, up)."""


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
    """Between the line of sight and the normal of the ground: 90 is grazing."""
    sight: str
    """visible, hidden or unknown."""
    told_by: str
    """parallax: what the pair was matched with there; terrain: the ground between; nothing."""
    linearised_sample: float | None
    linearised_line: float | None
    """The place in the image as matching sees it, resampled with its partner."""
    browse: str
    original: str


class CurvePoint(BaseModel):
    """A place on an epipolar curve and the range from the first image that it stands for."""

    sample: float
    line: float
    range_m: float


class PredictedBody(SeenBody):
    """Where a point of one image is to be looked for in another."""

    epipolar: list[CurvePoint]


class GroundToImage(BaseModel):
    """The images that show a place, those that see it first, then the nearest."""

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
    """Where a pixel is to be looked for in other images."""

    images: list[PredictedBody]
    curves: dict[str, list[CurvePoint]]
    """Epipolar curves in images where no place could be predicted."""


def ground_body(target: GroundPoint) -> GroundBody:
    """A place as it is sent."""
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


def seen_body(seen: Seen) -> SeenBody:
    """A place in an image as it is sent."""
    return SeenBody(**_seen(seen))


def predicted_body(
    seen: Seen, curve: tuple[ImagePoints, Float64[np.ndarray, " k"]]
) -> PredictedBody:
    """The same with its epipolar curve."""
    return PredictedBody(**_seen(seen), epipolar=curve_body(curve))


def curve_body(curve: tuple[ImagePoints, Float64[np.ndarray, " k"]]) -> list[CurvePoint]:
    """An epipolar curve as it is sent."""
    return [
        CurvePoint(sample=round(x, 2), line=round(y, 2), range_m=round(r, 3))
        for (x, y), r in zip(curve[0].tolist(), curve[1].tolist(), strict=True)
    ]


def layers_used(found: Found | None) -> list[LayerUsed]:
    """The terrain model that a pixel's ground was found on, if one was."""
    return [LayerUsed.of(found.layer)] if found and found.layer else []


def _seen(seen: Seen) -> dict[str, Any]:
    entry: ImageEntry = seen.entry
    ellipse = seen.ellipse
    incidence = None if seen.incidence is None else math.degrees(seen.incidence)
    sample, line = seen.linearised or (None, None)
    known = {name: getattr(entry, name) for name in ("stop", "sol", "instrument", "eye")}
    place = dict(zip(("sample", "line"), numbers(seen.point, 3), strict=True))
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
        "incidence_deg": number(incidence, 2),
        "sight": SIGHT_NAMES[seen.sight],
        "told_by": seen.told_by,
        "linearised_sample": number(sample, 3),
        "linearised_line": number(line, 3),
        "browse": f"/images/{entry.id}/browse.png",
        "original": f"/images/{entry.id}/original",
    }
