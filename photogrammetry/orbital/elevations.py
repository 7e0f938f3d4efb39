"""Register an orbital terrain model to the rover's own, by heights.

Heights do not depend on the sun, so this is simpler than `registration`: the orbital heights are
predicted by the rover's and by a plane, since either model may be tilted. The criterion is the
variance that the rover's heights explain beyond the plane,

    explained = (R^2 with heights and plane - R^2 with the plane) / (1 - R^2 with the plane)

and the relief must be about as high as the rover's, not twice as high and not inverted. Orbital
models are smooth over several of their cells, so positions must be further apart to count as
different, and the halves of the ground are larger squares. The median difference of heights at the
solution is the height offset of the orbital model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.ground_map import Contrast, Predicted, smooth
from solmap.photogrammetry.orbital.records import Correction, GroundMap, OrbitalDtm, Registration
from solmap.photogrammetry.orbital.registration import (
    HALF_SQUARE_M,
    OTHER_PLACE_M,
    Method,
    Place,
    RegistrationParams,
    best_place,
)
from solmap.photogrammetry.orbital.search import (
    CONVERGED,
    ITERATIONS,
    LEAST_SHOWN,
    UNKNOWNS,
    Landscape,
    SearchParams,
    clustered_covariance,
    map_to_image,
    samples_of,
    search,
    steps_in_cells,
    with_likely_scale,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

OTHER_PLACE_CELLS = 8.0
"""Distance from which positions count as different."""
MATCHED_CELLS = 1.0
"""Cells over which a model from stereo matching is smooth."""
SMOOTH_CELLS = 2.0
"""Cells over which it is smoothed here, so that noise does not dominate its slopes."""
CLUSTER_CELLS = 10.0
"""Side of the squares whose residuals may be correlated: twice the width over which both models are
smoothed."""
MODEL_CELLS = 0.35
"""Standard deviation, in cells, of the bias of either coordinate by partly visible ground (RMS over
simulated scenes), and of the map's edge by a rotation."""
LEAST_CONTRAST = 2.5
"""Margin of unexplained variance over any other position: on smooth ground neighbours fit well
too."""
MOSTLY_SEEN = 0.9
"""Fraction of a cell's surroundings that must be visible; slopes averaged over fewer are biased."""
LEAST_RELIEF, MOST_RELIEF = 0.5, 1.5
"""Range of the ratio of the orbital model's relief to the rover's."""
MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class _Heights:
    """Heights of both models at the same points."""

    ground: Float64[np.ndarray, " n"]
    orbital: Float64[np.ndarray, " n"]
    relief: float
    """Relief of the orbital model, relative to the rover's."""
    squares: int
    """Number of squares of ground they are from: neighbours are correlated."""


def register_elevations(
    ground: GroundMap, model: OrbitalDtm, params: RegistrationParams | None = None
) -> Registration:
    """Find the horizontal and vertical position of an orbital terrain model on the rover's map.

    Raises:
        OrbitalError: the rasters have cells of different size.
    """
    params, cell_m = params or RegistrationParams(), model.grid.cell_m
    if abs(ground.grid.cell_m / cell_m - 1) > 1e-6:  # noqa: PLR2004 - rounding
        raise OrbitalError(
            f"cells are {ground.grid.cell_m} m on the ground, {cell_m} m in the orbital model: "
            "resample the rover's map to the model's cells"
        )
    wide_m = OTHER_PLACE_CELLS * cell_m
    predicted, contrast = _predict_heights(ground), _orbital_relief(model)
    method = Method(
        _beyond_plane,
        _refine_place,
        _leads,
        other_place_m=max(OTHER_PLACE_M, wide_m),
        half_square_m=max(HALF_SQUARE_M, wide_m),
    )
    found = best_place(predicted, contrast, params, method)
    if found.correction is None:
        return found
    both = _compare_heights(ground, model, predicted, found.correction)
    if not LEAST_RELIEF < both.relief < MOST_RELIEF:
        reason = f"undecided: the best fit has {both.relief:.2f} times the rover's relief"
        return replace(found, correction=None, reason=reason)
    return replace(found, correction=_with_height(found.correction, both))


def _predict_heights(ground: GroundMap) -> Predicted:
    """Heights as smooth as an orbital model, and a plane."""
    sigma_cells = float(np.hypot(MATCHED_CELLS, SMOOTH_CELLS))
    own = smooth(ground.elevation.astype(np.float64), sigma_cells, MOSTLY_SEEN)
    planes = np.broadcast_arrays(*_mesh(ground.grid))
    known = np.isfinite(own)
    stack = np.where(known, np.stack([own - np.nanmean(own), *planes]), 0.0)
    return Predicted(ground.grid, stack, known)


def _orbital_relief(model: OrbitalDtm) -> Contrast:
    """Orbital heights above their mean."""
    above = smooth(
        model.elevation.astype(np.float64) - np.nanmean(model.elevation), SMOOTH_CELLS, MOSTLY_SEEN
    )
    seen = np.isfinite(above)
    return Contrast(model.grid, np.where(seen, above, 0.0).astype(np.float32), seen)


def _beyond_plane(predicted: Predicted, contrast: Contrast, params: SearchParams) -> Landscape:
    """Variance explained by heights beyond the plane."""
    both = search(predicted, contrast, params)
    plane = search(replace(predicted, stack=predicted.stack[1:]), contrast, params).explained
    with np.errstate(invalid="ignore", divide="ignore"):
        beyond = (both.explained - plane) / (1.0 - plane)
    return replace(both, explained=beyond)


def _leads(best: float, other: float) -> bool:
    """Whether the unexplained variance is clearly less than at any other position."""
    return 1.0 - other >= LEAST_CONTRAST * (1.0 - best)


def _refine_place(
    predicted: Predicted, contrast: Contrast, start: Place
) -> tuple[Float64[np.ndarray, " 4"], Float64[np.ndarray, "4 4"]]:
    """The position to a fraction of a cell, by least squares on the slopes of the rover's heights.

    Those of the orbital model are not suitable: noise makes them steeper, and Gauss-Newton's steps
    shorter.
    """
    grid, known = predicted.grid, predicted.known
    own = np.where(known, predicted.stack[0], np.nan)
    d_south, d_east = np.gradient(own, grid.cell_m)
    use = np.isfinite(d_south) & np.isfinite(d_east)
    east, north = (c[use] for c in np.broadcast_arrays(*_mesh(grid)))
    g_e, g_n, own = d_east[use], -d_south[use], own[use]
    middle = east.mean(), north.mean()
    west, south, right, top = grid.bounds
    arm_e, arm_n = east - (west + right) / 2, north - (south + top) / 2
    plane = [east - middle[0], north - middle[1], np.ones(len(own))]
    found = np.array([start[0], start[1], np.radians(start[2]), 0.0])
    steps = steps_in_cells(east, north, grid.cell_m)
    values = np.where(contrast.known, contrast.values, np.nan)
    for _ in range(ITERATIONS):
        at = np.column_stack(map_to_image(grid, found, east, north))
        off = interpolate(values, contrast.grid, at) - own
        seen = np.isfinite(off)
        if seen.mean() < LEAST_SHOWN:
            break
        by_turn, by_scale = g_e * arm_n - g_n * arm_e, -(g_e * arm_e + g_n * arm_n)
        design = np.column_stack([g_e, g_n, by_turn, by_scale, *plane])[seen]
        solved, *_ = np.linalg.lstsq(design, -off[seen], rcond=None)
        residuals = off[seen] + design @ solved
        wide_m = CLUSTER_CELLS * grid.cell_m
        C = clustered_covariance(design, residuals, east[seen], north[seen], wide_m)
        C += np.diag((MODEL_CELLS / steps) ** 2)
        before = found
        found, C = with_likely_scale(before + solved[:UNKNOWNS], C)
        if np.abs((found - before) * steps).max() < CONVERGED:
            return found, C
    raise OrbitalError("the position of the map in the orbital model does not converge")


def _mesh(grid: MapGrid) -> tuple[np.ndarray, np.ndarray]:
    east, north = grid.centres()
    return east[None, :], north[:, None]


def _compare_heights(
    ground: GroundMap, model: OrbitalDtm, predicted: Predicted, correction: Correction
) -> _Heights:
    """Both models at the cells that the rover saw, the orbital one moved by the correction."""
    grid, rows_cols = ground.grid, np.nonzero(predicted.known)
    east = grid.west + (rows_cols[1] + 0.5) * grid.cell_m
    north = grid.north - (rows_cols[0] + 0.5) * grid.cell_m
    places = correction.apply_inverse(np.column_stack([east, north]))
    heights = interpolate(model.elevation, model.grid, places)
    both = np.isfinite(heights)
    layers = np.column_stack([*predicted.stack[:, predicted.known][:, both], np.ones(both.sum())])
    fitted, *_ = np.linalg.lstsq(layers, heights[both], rcond=None)
    relief = float(fitted[0])
    wide_m = CLUSTER_CELLS * grid.cell_m
    squares = np.unique(np.floor(np.column_stack([east, north])[both] / wide_m), axis=0)
    return _Heights(
        ground.elevation[predicted.known][both].astype(np.float64),
        heights[both],
        relief,
        len(squares),
    )


def interpolate(
    raster: np.ndarray, grid: MapGrid, places: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, " n"]:
    """Values of a raster at places (east, north); NaN beyond it."""
    sample, line = samples_of(grid, places[:, 0], places[:, 1])
    found = np.full(len(places), np.nan)
    for begin in range(0, len(places), 30_000):  # OpenCV accepts images of fewer than 32768 rows
        part = slice(begin, begin + 30_000)
        found[part] = cv2.remap(
            raster.astype(np.float32), sample[part, None], line[part, None], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
        )[:, 0]  # fmt: skip
    return found


def _with_height(correction: Correction, both: _Heights) -> Correction:
    """The median difference of heights, with its standard deviation by squares of ground."""
    off = both.ground - both.orbital
    up_m = float(np.median(off))
    spread = MAD_TO_SIGMA * float(np.median(np.abs(off - up_m)))
    # sqrt(pi / 2): a median is less efficient than a mean
    sigma_m = spread * np.sqrt(np.pi / 2 / max(both.squares, 1))
    return replace(correction, up_m=up_m, sigma_up_m=max(float(sigma_m), 1e-3))
