"""Strike and dip of a plane through places on the ground."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field

from solmap.gis_server.analysis.bodies import (
    MOST_CORNERS,
    UNITS,
    Corner,
    LayerChoice,
    LayerUsed,
    MetresHere,
    Polygon,
    Question,
    UnanswerableError,
)
from solmap.gis_server.analysis.ground import BEST, Ground, cell_of
from solmap.gis_server.analysis.measures import layers_used
from solmap.photogrammetry.arrays import Covariances3
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import PlaneFit, fit_plane
from solmap.photogrammetry.terrain.dtm.resampling import NOWHERE, GroundSamples, MapPoints
from solmap.photogrammetry.terrain.measure.areas import (
    places_inside,
    polygon_of,
)
from solmap.photogrammetry.terrain.measure.strike_dip import attitude
from solmap.photogrammetry.terrain.relief.slope import CORRELATION_M

_MOST_POINTS = 2500
_LEAST_SIGMA_M = 0.002
"""Least standard deviation of an elevation: a fraction of the steps of the model."""

Picked = Corner | tuple[MetresHere, MetresHere, Annotated[float, Field(ge=-1e5, le=1e5)]]
"""(east, north), on the ground, or (east, north, elevation)."""


class PlaneQuestion(Question):
    """Places for fitting a plane: picked points, or a polygon of ground."""

    points: Annotated[list[Picked], Field(min_length=3, max_length=MOST_CORNERS)] | None = None
    polygon: Polygon | None = None
    layer: LayerChoice = BEST
    sigma_m: Annotated[float, Field(gt=0, le=10)] = 0.02
    """Standard deviation, each way, of points that come with their elevation."""


class PlaneAnswer(BaseModel):
    """A plane and its uncertainty."""

    units: str = UNITS
    dip_deg: float
    sigma_dip_deg: float
    strike_deg: float | None
    """Strike, with the dip to its right; null: the plane is level within its uncertainty."""
    sigma_strike_deg: float | None
    dip_direction_deg: float | None
    said_of_strike: str | None
    """Why there is no strike."""
    centre: tuple[float, float, float]
    """(east, north, elevation) on the plane."""
    normal: tuple[float, float, float]
    """Unit vector (east, north, up)."""
    rms_m: float
    """Distance of the points from the plane, root mean square."""
    sigma0: float
    """Scatter of the points divided by their stated standard deviations."""
    points: int
    layers: list[LayerUsed]


def plane_answer(question: PlaneQuestion, ground: Ground) -> PlaneAnswer:
    """The most probable plane through the places of a request.

    Raises:
        TerrainError: they do not determine a plane.
    """
    if (question.points is None) == (question.polygon is None):
        raise UnanswerableError("a plane goes through `points` or a `polygon`: give one of them")
    places, heights = _places(question, ground)
    read = ground.at(places)
    on_ground = np.isnan(heights)
    heights = np.where(on_ground, read.elevation, heights)
    known = np.isfinite(heights)
    points = np.column_stack([places, heights])[known]
    covariances = _covariances(question, read, on_ground, ground)[known]
    plane = fit_plane(points, covariances)
    used = read if on_ground.any() else GroundSamples.unknown(0)
    return _answer(plane, layers_used(used, ground))


def _places(question: PlaneQuestion, ground: Ground) -> tuple[MapPoints, np.ndarray]:
    """Places and their elevations, NaN where these are the ground's."""
    if question.points is not None:
        places = np.array([point[:2] for point in question.points])
        elevations = [point[2] if len(point) > 2 else math.nan for point in question.points]  # noqa: PLR2004
        return places, np.array(elevations)
    spacing = max(CORRELATION_M, ground.finest_cell_m)  # nearer points repeat each other's error
    inside, _ = places_inside(polygon_of(np.array(question.polygon)), spacing, _MOST_POINTS)
    return inside, np.full(len(inside), np.nan)


def _covariances(
    question: PlaneQuestion, read: GroundSamples, on_ground: np.ndarray, ground: Ground
) -> Covariances3:
    """For each point, its own covariance plus that of its cell's extent."""
    cells = np.array([cell_of(layer) for layer in ground.models])
    aside = cells[np.where(read.source == NOWHERE, 0, read.source)] / math.sqrt(12.0)
    up = np.maximum(np.nan_to_num(read.own_sigma_m), _LEAST_SIGMA_M)
    sigmas = np.column_stack([aside, aside, up])
    sigmas[~on_ground] = question.sigma_m
    return sigmas[:, :, None] ** 2 * np.eye(3)


def _answer(plane: PlaneFit, layers: list[LayerUsed]) -> PlaneAnswer:
    east, north, up = plane.normal.tolist()
    try:
        found, why = attitude(plane), None
    except TerrainError as error:
        found, why = None, str(error)
    level = float(np.sqrt(max(np.linalg.eigvalsh(plane.covariance)[-1], 0.0)))
    centre = plane.centre.round(4).tolist()
    return PlaneAnswer(
        dip_deg=round(math.degrees(math.atan2(math.hypot(east, north), up)), 3),
        sigma_dip_deg=round(math.degrees(found.sigma_dip if found else level), 3),
        strike_deg=round(math.degrees(found.strike), 2) if found else None,
        sigma_strike_deg=round(math.degrees(found.sigma_strike), 2) if found else None,
        dip_direction_deg=round(math.degrees(found.dip_direction), 2) if found else None,
        said_of_strike=why,
        centre=(centre[0], centre[1], centre[2]),
        normal=(round(east, 6), round(north, 6), round(up, 6)),
        rms_m=round(plane.rms_m, 4),
        sigma0=round(plane.sigma0, 3),
        points=plane.points,
        layers=layers,
    )
