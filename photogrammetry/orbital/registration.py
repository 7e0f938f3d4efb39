"""Lay an orbital image on the rover's map, or say that it cannot be told where it lies.

Every place and rotation within reach is tried (`search`), the best refined to a fraction of a cell
(`refinement`). A fit is believed if

- it explains clearly more of the image than the best fit anywhere else does;
- both halves of the ground, squares like the fields of a chessboard, find the same place on their
  own, within what they themselves state;
- its standard deviations are smaller than a cell.

On ground without features all places fit alike, and the answer is that it cannot be told. A wrong
place is worse than none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.arrays import Mask
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.predictors import Contrast, Predicted, local_contrast, predictors
from solmap.photogrammetry.orbital.records import Correction, GroundMap, OrbitalImage, Registration
from solmap.photogrammetry.orbital.refinement import refine
from solmap.photogrammetry.orbital.search import Landscape, SearchParams, search
from solmap.photogrammetry.terrain.dtm.grid import MapGrid


@dataclass(frozen=True, slots=True)
class RegistrationParams:
    """When a registration is believed."""

    search: SearchParams = field(default_factory=SearchParams)
    least_lead: float = 1.5
    """By how much more of the image the best place explains than any other: where nothing fits, the
    best of thousands of places leads the second best by some percent."""
    other_place_m: float = 2.0
    """Places that far apart are different ones."""
    half_square_m: float = 8.0
    """Side of the squares that go to either half of the ground in turn."""
    halves_apart_cells: float = 3.0
    """How far the halves may disagree."""
    largest_sigma_cells: float = 1.0


def register(
    ground: GroundMap, image: OrbitalImage, params: RegistrationParams | None = None
) -> Registration:
    """Find where an orbital image lies on the rover's map.

    Raises:
        OrbitalError: the rasters have cells of different size.
    """
    params = params or RegistrationParams()
    if abs(ground.grid.cell_m / image.grid.cell_m - 1) > 1e-6:  # noqa: PLR2004 - rounding
        raise OrbitalError(
            f"cells of {ground.grid.cell_m} m on the ground, {image.grid.cell_m} m in the image: "
            "resample the rover's map to the image's cells"
        )
    method = Method(search, refine, lambda best, other: best >= params.least_lead * other)
    return best_place(predictors(ground), local_contrast(image), params, method)


Place = tuple[float, float, float]
"""(east m, north m, rotation deg) by which the map lies off in the image."""


@dataclass(frozen=True, slots=True)
class Method:
    """How images, or heights, are compared."""

    search: Callable[[Predicted, Contrast, SearchParams], Landscape]
    refine: Callable[[Predicted, Contrast, Place], tuple[np.ndarray, np.ndarray]]
    leads: Callable[[float, float], bool]
    """Whether the best place explains clearly more than the best other one."""


def best_place(
    predicted: Predicted, contrast: Contrast, params: RegistrationParams, method: Method
) -> Registration:
    """Where what a map predicts lies in what an image shows, if it can be told."""
    try:
        landscape = method.search(predicted, contrast, params.search)
        explained, east, north, rotation_deg = landscape.best()
        found, covariance = method.refine(predicted, contrast, (east, north, rotation_deg))
        halves = [
            method.search(predicted.within(half), contrast, params.search).best()
            for half in _halves(predicted.grid, params.half_square_m)
        ]
    except OrbitalError as error:
        return Registration(None, str(error), 0.0, 0.0, float("nan"))
    runner_up = landscape.runner_up(params.other_place_m)
    apart_m = float(np.hypot(*np.subtract(halves[0][1:3], halves[1][1:3])))
    fit = _Fit(explained, runner_up, apart_m, found, covariance)
    reason = _doubt(fit, predicted.grid.cell_m, params, method)
    correction = None if reason else _correction(fit, predicted.grid)
    return Registration(correction, reason, explained, runner_up, apart_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    explained: float
    runner_up: float
    apart_m: float
    found: np.ndarray
    """(east m, north m, rotation rad) by which the map lies off in the image."""
    covariance: np.ndarray


def _correction(fit: _Fit, grid: MapGrid) -> Correction:
    west, south, east, north = grid.bounds
    return Correction(
        east_m=-float(fit.found[0]),
        north_m=-float(fit.found[1]),
        rotation_deg=float(np.degrees(fit.found[2])),
        centre_m=((west + east) / 2, (south + north) / 2),
        covariance=fit.covariance,
    )


def _halves(grid: MapGrid, square_m: float) -> tuple[Mask, Mask]:
    east, north = grid.centres()
    fields = np.floor(east / square_m)[None, :] + np.floor(north / square_m)[:, None]
    light = fields % 2 == 0
    return light, ~light


def _doubt(fit: _Fit, cell_m: float, params: RegistrationParams, method: Method) -> str:
    """Why the place is not believed; empty if it is."""
    if not method.leads(fit.explained, fit.runner_up):
        return (
            f"cannot tell: the best place explains {fit.explained:.1%} of the image's contrast, "
            f"another one {fit.runner_up:.1%}"
        )
    if fit.apart_m > params.halves_apart_cells * cell_m:
        return f"cannot tell: both halves of the ground find places {fit.apart_m:.1f} m apart"
    if np.hypot(*fit.found[:2]) > params.search.reach_m:
        return f"cannot tell: the best place lies beyond {params.search.reach_m} m"
    if abs(np.degrees(fit.found[2])) > params.search.reach_deg:
        return f"cannot tell: the best place is turned by more than {params.search.reach_deg} deg"
    sigma_m = float(np.sqrt(np.diagonal(fit.covariance)[:2].max()))
    if sigma_m > params.largest_sigma_cells * cell_m:
        return f"cannot tell: the place is only known to {sigma_m:.2f} m"
    return ""
