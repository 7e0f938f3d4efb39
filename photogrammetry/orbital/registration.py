"""Register an orbital image to the rover's map, or decide that its position is undetermined.

Every position and rotation within reach is tested, the best refined to a fraction of a cell
(`search`). A fit is accepted if

- it explains clearly more of the image than the best fit anywhere else;
- both halves of the ground, in chessboard squares, give the same position separately, within their
  own standard deviations;
- its standard deviations are smaller than a cell.

On ground without features all positions fit equally, and the result is undecided. A wrong position
is worse than none.

An image with a large stated error is searched near its stated position first, then everywhere in
larger cells, and again near the position found there.

A single stop whose own map is registered, as if it were the only one, becomes control for the
adjustment. A correction (see `records.Correction`) transforms p in the image's georeference to its
position on the rover's map,

    x = c + m R (p - c) + t

so the rover itself, at x with azimuth A, is in the image at

    p = c + R' (x - c - t) / m          azimuth A + rotation

with the covariance of (t, rotation, m) propagated, and for an orbital terrain model its height too.
The position depends on the map relative to the rover, and no longer on the adjusted pose of both.
The map is rotated against the rover by the mean mast pointing error of its pairs, which is included
in the covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np

from solmap.photogrammetry.adjustment.model.network import StopControl
from solmap.photogrammetry.arrays import Mask, Raster
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.orbital.ground_map import (
    Contrast,
    Predicted,
    local_contrast,
    predictors,
)
from solmap.photogrammetry.orbital.records import Correction, GroundMap, OrbitalImage, Registration
from solmap.photogrammetry.orbital.search import (
    REACH_DEG,
    Landscape,
    SearchParams,
    in_larger_cells,
    refine,
    samples_of,
    search,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

LEAST_LEAD = 1.5
"""Margin of the explained variance over any other position: where nothing fits, the best of
thousands of positions exceeds the second best by some percent."""
OTHER_PLACE_M = 2.0
"""Distance from which positions count as different."""
HALF_SQUARE_M = 8.0
"""Side of the squares that are assigned to either half of the ground in turn."""
HALVES_APART_CELLS = 3.0
"""Largest difference between the halves."""
LARGEST_SIGMA_CELLS = 1.0
"""Standard deviation of either coordinate above which a position is rejected."""
Place = tuple[float, float, float]
"""(east m, north m, rotation deg) displacement of the map in the image."""
STRIP = 2048
"""Rows and columns interpolated together; OpenCV accepts fewer than 32768."""


@dataclass(frozen=True, slots=True)
class RegistrationParams:
    """How an orbital raster is registered."""

    search: SearchParams = field(default_factory=SearchParams)


def register(
    ground: GroundMap, image: OrbitalImage, params: RegistrationParams | None = None
) -> Registration:
    """Find the position of an orbital image on the rover's map.

    Raises:
        OrbitalError: the rasters have cells of different size.
    """
    params = params or RegistrationParams()
    if abs(ground.grid.cell_m / image.grid.cell_m - 1) > 1e-6:  # noqa: PLR2004 - rounding
        raise OrbitalError(
            f"cells are {ground.grid.cell_m} m on the ground, {image.grid.cell_m} m in the image: "
            "resample the rover's map to the image's cells"
        )
    method = Method(search, refine, lambda best, other: best >= LEAST_LEAD * other)
    return best_place(predictors(ground), local_contrast(image), params, method)


@dataclass(frozen=True, slots=True)
class Method:
    """How images, or heights, are compared."""

    search: Callable[[Predicted, Contrast, SearchParams], Landscape]
    refine: Callable[[Predicted, Contrast, Place], tuple[np.ndarray, np.ndarray]]
    leads: Callable[[float, float], bool]
    """Whether the best position explains clearly more than the best other one."""
    other_place_m: float = OTHER_PLACE_M
    half_square_m: float = HALF_SQUARE_M


def best_place(
    predicted: Predicted, contrast: Contrast, params: RegistrationParams, method: Method
) -> Registration:
    """Position in an image of what a map predicts, if determined."""
    near = params.search.near()
    found = _best_near(predicted, contrast, near, method)
    if found.correction is not None or params.search.reach_m <= near.reach_m:
        return found
    try:
        larger = in_larger_cells(predicted, contrast, params.search.reach_m)
        landscape = method.search(*larger, params.search)
        explained, east, north, _ = landscape.best()
    except OrbitalError:
        return found
    runner_up = landscape.runner_up(max(method.other_place_m, 2 * landscape.cell_m))
    if not method.leads(explained, runner_up):
        doubt = _no_lead(explained, runner_up)
        return Registration(None, doubt, explained, runner_up, float("nan"))
    return _best_near(predicted, contrast, params.search.near((east, north)), method)


def _best_near(
    predicted: Predicted, contrast: Contrast, params: SearchParams, method: Method
) -> Registration:
    """The best position in the image's own cells."""
    try:
        landscape = method.search(predicted, contrast, params)
        explained, east, north, rotation_deg = landscape.best()
        found, covariance = method.refine(predicted, contrast, (east, north, rotation_deg))
        halves = [
            method.search(predicted.within(half), contrast, params).best()
            for half in _halves(predicted.grid, method.half_square_m)
        ]
    except OrbitalError as error:
        return Registration(None, str(error), 0.0, 0.0, float("nan"))
    runner_up = landscape.runner_up(method.other_place_m)
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
    """(east m, north m, rotation rad, scale) displacement of the map's centre in the image."""
    covariance: np.ndarray


def _correction(fit: _Fit, grid: MapGrid) -> Correction:
    west, south, right, top = grid.bounds
    east, north, turn, scale = fit.found.tolist()
    centre = (west + right) / 2 + east, (south + top) / 2 + north
    return Correction(-east, -north, np.degrees(turn), centre, fit.covariance, scale)


def _halves(grid: MapGrid, square_m: float) -> tuple[Mask, Mask]:
    east, north = grid.centres()
    fields = np.floor(east / square_m)[None, :] + np.floor(north / square_m)[:, None]
    light = fields % 2 == 0
    return light, ~light


def _no_lead(explained: float, runner_up: float) -> str:
    return (
        f"undecided: the best position explains {explained:.1%} of the image's contrast, another "
        f"one {runner_up:.1%}"
    )


def _doubt(fit: _Fit, cell_m: float, params: SearchParams, method: Method) -> str:
    """The reason why the position is rejected; empty if it is not."""
    if not method.leads(fit.explained, fit.runner_up):
        return _no_lead(fit.explained, fit.runner_up)
    if fit.apart_m > HALVES_APART_CELLS * cell_m:
        return f"undecided: both halves of the ground give positions {fit.apart_m:.1f} m apart"
    if np.hypot(*(fit.found[:2] - params.around_m)) > params.reach_m:
        return f"undecided: the best position lies beyond {params.reach_m} m"
    if abs(np.degrees(fit.found[2])) > REACH_DEG:
        return f"undecided: the best position is rotated by more than {REACH_DEG} deg"
    sigma_m = float(np.sqrt(np.diagonal(fit.covariance)[:2].max()))
    if sigma_m > LARGEST_SIGMA_CELLS * cell_m:
        return f"undecided: the standard deviation of the position is {sigma_m:.2f} m"
    return ""


def draw_corrected(image: OrbitalImage, grid: MapGrid, correction: Correction | None) -> Raster:
    """The image on a grid of the map, moved by a correction; NaN beyond it."""
    out = np.full(grid.shape, np.nan, dtype=np.float32)
    known = np.isfinite(image.brightness)
    layers = np.where(known, image.brightness, 0.0).astype(np.float32), known.astype(np.float32)
    east, north = grid.centres()
    for top in range(0, grid.rows, STRIP):
        for left in range(0, grid.cols, STRIP):
            part = np.s_[top : top + STRIP, left : left + STRIP]
            places = np.stack(np.meshgrid(east[part[1]], north[part[0]]), axis=-1)
            if correction is not None:
                places = correction.apply_inverse(places)
            samples = samples_of(image.grid, places[..., 0], places[..., 1])
            value, weight = (cv2.remap(layer, *samples, cv2.INTER_LINEAR) for layer in layers)
            with np.errstate(invalid="ignore", divide="ignore"):
                out[part] = np.where(np.asarray(weight) > 0.5, value / weight, np.nan)  # noqa: PLR2004
    return out


def stop_in_image(
    stop: StopId,
    lsl_from_rover: Pose,
    correction: Correction,
    frame: str,
    sigma_turn_deg: float = 0.0,
) -> StopControl:
    """Position in an image of a stop to whose map it was registered.

    Args:
        stop: its name.
        lsl_from_rover: the pose with which its map was made.
        correction: of the image to that map.
        frame: the name of the image.
        sigma_turn_deg: standard deviation of the map's rotation against the rover.
    """
    north, east, _ = lsl_from_rover.translation_m.tolist()
    theta, m = np.radians(correction.rotation_deg), 1 + correction.scale
    c, s = np.cos(theta), np.sin(theta)
    back = np.array([[c, s], [-s, c]]) / m
    arm = np.array([east - correction.east_m, north - correction.north_m])
    arm = arm - np.asarray(correction.centre_m)
    place = np.asarray(correction.centre_m) + back @ arm
    rotation = lsl_from_rover.rotation
    azimuth = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0])) + correction.rotation_deg
    J = np.zeros((3, 4))
    J[:2, :2] = -back
    J[:2, 2] = np.array([[-s, c], [-c, -s]]) @ arm / m
    J[:2, 3] = -back @ arm / m
    J[2, 2] = 1.0
    C = J @ correction.covariance @ J.T
    C[2, 2] += np.radians(sigma_turn_deg) ** 2
    up_m = None
    if correction.up_m is not None and correction.sigma_up_m is not None:
        up_m = float(-lsl_from_rover.translation_m[2] - correction.up_m)
        C = np.insert(np.insert(C, 2, 0.0, axis=0), 2, 0.0, axis=1)
        C[2, 2] = correction.sigma_up_m**2
    return StopControl(
        stop,
        frame,
        float(place[0]),
        float(place[1]),
        (C + C.T) / 2,
        up_m,
        float((azimuth + 180.0) % 360.0 - 180.0),
    )
