"""Planes fitted to points and to rasters: one function for each kind of error.

| function | fitted to | minimises | errors |
| --- | --- | --- | --- |
| `fit_plane` | points in space | distances along the normal | a covariance for every point |
| `least_squares_plane` | values over a plane | squares of values | equal |
| `least_squares_plane_with_cofactors` | the same | the same | equal; states the plane's own |
| `least_deviations_plane` | the same | absolute values | with blunders |
| `window_gradients`, `fit_window_planes` | a raster with gaps, around each cell | squares | equal |
| `nine_cell_gradients` | the same, 3 x 3 cells | squares | equal |
| `filled_gradients` | a raster without gaps, around every cell | squares | equal |

**Points in space.** A point known with the covariance C lies off the plane n.P = d by n.P - d with
the variance n'C n. The plane that makes the points likeliest, whatever the true points are,
minimises

    sum r^2,    r = (n.P - d) / sigma,    sigma^2 = n'C n

over unit normals n and distances d: total least squares with an error ellipsoid for every point. It
is found by Gauss-Newton. With t perpendicular to n, a small rotation of n towards t changes r by
t.Q/sigma, where Q = P - C n r/sigma is the most likely true point of P on the plane, and

    N = sum a a' / sigma^2,    a = (t1.Q, t2.Q, -1)

is the normal matrix. Replacing Q by P, as weighted least squares does, tilts the plane towards the
longest axes of the ellipsoids: the lines of sight. The inverse of N is the covariance of both
angles and of d, once the part that noise adds to N by spreading the points within the plane is
subtracted,

    sum t' (C - C n n'C / sigma^2) t / sigma^2

For points along a line or in one spot nothing remains; an error is raised. Where points scatter by
more than their covariances state, the covariance of the plane is multiplied by sigma0^2.

**Windows of a raster.** Around every cell a plane h = a + g_e e + g_n n is fitted by least squares
to the cells with a value inside a square window, whose side is called the baseline. With the
weights m = 1 where there is a value, and e, n counted from the middle of the window, all sums are
convolutions of m, m h and their moments, and the normal equations

    | S_1  S_e  S_n  | | a   |   | S_h  |
    | S_e  S_ee S_en | | g_e | = | S_eh |
    | S_n  S_en S_nn | | g_n |   | S_nh |

are solved in every cell at once: exact on tilted planes, whatever cells are missing. With the
centred sums C_xy = S_xy - S_x S_y / S_1 the values scatter around the plane by

    s^2 = (C_hh - g_e C_eh - g_n C_nh) / (S_1 - 3)

and errors of the cells with the mean variance v, common to k neighbours each, give the gradient the
covariance k v C^-1. The raster is processed block by block with the window's margin, so that memory
does not grow with the map; sums are in double precision, above the mean of each block.

Planes of parallax maps are fitted in `matching.parallax_planes`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    Bool,
    Covariance3,
    Covariances3,
    Float32,
    Float64,
    ObjectPoints,
    PerPoint,
    Raster,
    Vector3,
)
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.kernels import LAYERS, LEAST_POINTS, LEAST_SPREAD, window_planes

Gradients = Float32[np.ndarray, "2 rows cols"]
"""Rise per metre towards east and towards north; NaN where no plane could be fitted."""
Shapes = Float32[np.ndarray, "3 rows cols"]
"""C_ee, C_en, C_nn of the cells that a plane was fitted to, square metres."""

ROUNDS = 50
REWEIGHTINGS = 15
"""Rounds of reweighted least squares that approach least absolute deviations."""
CONVERGED = 1e-10
"""Largest movement of the plane in the last round, in radians and extents of the points."""
LARGEST_SIGMA = np.radians(15.0)
"""Standard deviation of the normal above which points do not define a plane."""
CHANCE = 4.0
"""Standard deviations, each sqrt(2 / n), by which noise may enlarge the normal matrix."""
SINGULAR = 1e-12
"""Fraction of the largest eigenvalue below which another one counts as zero."""
BLOCK = 256
"""Side of the blocks in cells, which fit a processor's cache."""
_STEP = np.array([-1.0, 0.0, 1.0], np.float32)
_ONES = np.ones(3, np.float32)
_AROUND = np.array([(n, e) for n in (1, 0, -1) for e in (-1, 0, 1)], np.float32)
"""Steps to the north and to the east of the nine cells, row by row."""
_MIN_SHARE = 0.5
_FULL_SPREAD = 6.0
"""Second moment of nine cells in either direction."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A plane fitted to points, (east, north, up) in metres."""

    centre: Vector3
    """Mean of the points, projected to the plane."""
    normal: Vector3
    """Unit normal, pointing up."""
    covariance: Covariance3
    """Covariance of the normal, square radians: singular along the normal itself."""
    sigma_m: float
    """Standard deviation of the plane's position at its centre, along the normal."""
    rms_m: float
    """Root mean square distance of the points from the plane."""
    sigma0: float
    """Scatter of the points over that of their covariances; 1 without redundancy."""
    points: int


def fit_plane(
    points: ObjectPoints, covariances: Covariances3, turning: Covariance3 | None = None
) -> PlaneFit:
    """The likeliest plane through points known with these covariances.

    Args:
        points: (east, north, up), metres.
        covariances: Of each point on its own, square metres.
        turning: Covariance of a small rotation (east, north, up; radians) common to all points,
            such as that of the camera's pointing; none by default.

    Raises:
        TerrainError: there are too few points, or they lie along a line.
    """
    if len(points) < LEAST_POINTS:
        raise TerrainError(
            f"a plane needs {LEAST_POINTS} points that are not on one line, not {len(points)}: "
            "pick more"
        )
    middle = points.mean(axis=0)
    P = points - middle
    extent = max(float(np.sqrt((P**2).sum(axis=1).mean())), 1e-9)
    n, d = _first_plane(P, covariances), 0.0
    for _ in range(ROUNDS):
        angles, shift = _step(*_normal_equations(P, covariances, n, d))
        n = n + angles @ _across(n)
        n /= np.linalg.norm(n)
        d += shift
        if max(np.abs(angles).max(), abs(shift) / extent) < CONVERGED:
            break
    off = P @ n - d
    sigma0 = _sigma0(off, covariances, n)
    N = _normal_equations(P, covariances, n, d)[0]
    noise = _noise_part(covariances, n)
    N[:2, :2] -= noise
    N /= max(1.0, sigma0**2)
    lower_bound = N[:2, :2] - CHANCE * np.sqrt(2 / len(points)) * noise
    if not np.linalg.eigvalsh(lower_bound)[0] > 1 / LARGEST_SIGMA**2:
        raise TerrainError(
            f"{len(points)} points over {extent:.3g} m (root mean square) do not define a plane: "
            "it may rotate about the line along which they lie; pick points to the side of it"
        )
    inverse = np.linalg.inv(N)
    t = _across(n)
    n, t, d = (n, t, d) if n[2] >= 0 else (-n, -t, -d)
    covariance = t.T @ inverse[:2, :2] @ t
    if turning is not None:
        cross = np.cross(np.eye(3), n)
        covariance = covariance + cross.T @ turning @ cross
    return PlaneFit(
        centre=middle + d * n,
        normal=n,
        covariance=covariance,
        sigma_m=float(np.sqrt(inverse[2, 2])),
        rms_m=float(np.sqrt(np.mean(off**2))),
        sigma0=sigma0,
        points=len(points),
    )


def _first_plane(P: ObjectPoints, covariances: Covariances3) -> Vector3:
    """Normal of the plane through points, each with the same error in all directions."""
    weight = 1 / np.trace(covariances, axis1=1, axis2=2)
    centred = P - np.average(P, axis=0, weights=weight)
    return np.linalg.eigh((weight[:, None] * centred).T @ centred)[1][:, 0]


def _across(n: Vector3) -> Float64[np.ndarray, "2 3"]:
    """Two unit vectors perpendicular to n and to each other."""
    least = np.eye(3)[np.argmin(np.abs(n))]
    first = np.cross(n, least)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(n, first)])


def _normal_equations(
    P: ObjectPoints, covariances: Covariances3, n: Vector3, d: float
) -> tuple[Covariance3, Vector3]:
    """Matrix and right-hand side for both angles and d."""
    towards = np.einsum("nij,j->ni", covariances, n)
    variance = towards @ n
    off = P @ n - d
    Q = P - towards * (off / variance)[:, None]
    a = np.column_stack([Q @ _across(n).T, -np.ones(len(P))])
    return (a / variance[:, None]).T @ a, -(a.T @ (off / variance))


def _step(N: Covariance3, right: Vector3) -> tuple[Float64[np.ndarray, " 2"], float]:
    """Solution of the normal equations; undetermined unknowns are unchanged."""
    step = np.linalg.pinv(N, rcond=SINGULAR, hermitian=True) @ right
    return step[:2], float(step[2])


def _noise_part(covariances: Covariances3, n: Vector3) -> Float64[np.ndarray, "2 2"]:
    """The part of the normal matrix of both angles that points in one spot would also have."""
    t = _across(n)
    towards = np.einsum("nij,j->ni", covariances, n)
    variance = towards @ n
    along = towards @ t.T
    within = np.einsum("ai,nij,bj->nab", t, covariances, t)
    within -= along[:, :, None] * along[:, None, :] / variance[:, None, None]
    return np.sum(within / variance[:, None, None], axis=0)


def _sigma0(off: PerPoint, covariances: Covariances3, n: Vector3) -> float:
    redundancy = len(off) - LEAST_POINTS
    if redundancy < 1:
        return 1.0
    variance = np.einsum("i,nij,j->n", n, covariances, n)
    return float(np.sqrt(np.sum(off**2 / variance) / redundancy))


def least_squares_plane(x: PerPoint, y: PerPoint, values: PerPoint) -> Vector3:
    """(a, b, c) of the plane a + b x + c y with the least squares of residuals; no gaps allowed."""
    design = np.column_stack([np.ones(len(values)), x, y])
    return np.linalg.lstsq(design, values, rcond=None)[0]


def least_squares_plane_with_cofactors(
    x: PerPoint, y: PerPoint, values: PerPoint
) -> tuple[Vector3, Covariance3, float]:
    """The same plane by its normal equations, their inverse, and the variance of unit weight.

    Raises:
        TerrainError: the points lie on a line.
    """
    design = np.column_stack([np.ones(len(values)), x, y])
    if np.linalg.matrix_rank(design) < design.shape[1]:
        raise TerrainError("the measured points lie on a line: they do not define a plane")
    cofactors = np.linalg.inv(design.T @ design)
    plane = cofactors @ design.T @ values
    residuals = values - design @ plane
    return plane, cofactors, float(residuals @ residuals) / max(len(values) - LEAST_POINTS, 1)


def least_deviations_plane(
    x: PerPoint, y: PerPoint, values: PerPoint, least_deviation: float
) -> Vector3:
    """(a, b, c) of the plane a + b x + c y with the least sum of absolute residuals.

    By least squares, repeated with the weights 1 / max(|residual|, `least_deviation`).
    """
    design = np.column_stack([np.ones(len(values)), x, y])
    weight = np.ones(len(values))
    plane = np.zeros(3)
    for _ in range(REWEIGHTINGS):
        normal = (design * weight[:, None]).T @ design + 1e-9 * np.eye(3)
        plane = np.linalg.solve(normal, design.T @ (weight * values))
        weight = 1.0 / np.maximum(np.abs(values - design @ plane), least_deviation)
    return plane


@dataclass(frozen=True, slots=True, eq=False)
class WindowPlanes:
    """The planes around every cell."""

    gradient: Gradients
    scatter: Raster
    """Standard deviation of the elevations from the plane, metres."""
    shape: Shapes


def window_gradients(
    elevation: Raster, cell_m: float, baseline_m: float, min_share: float = 0.5
) -> Gradients:
    """Gradient of the plane through the cells of a window of side `baseline_m` around each cell."""
    found = np.full((2, *elevation.shape), np.nan, np.float32)
    for own, gradient in gradient_blocks(elevation, cell_m, baseline_m, min_share):
        found[(slice(None), *own)] = gradient
    return found


def gradient_blocks(
    elevation: Raster, cell_m: float, baseline_m: float, min_share: float = 0.5
) -> Iterator[tuple[tuple[slice, slice], Gradients]]:
    """Gradients and position of each block; blocks without elevation are omitted."""
    half = half_window(elevation.shape, cell_m, baseline_m)
    for own, gradient in _blocks(elevation, half, min_share, 2):
        yield own, gradient / np.float32(cell_m)


def fit_window_planes(
    elevation: Raster, cell_m: float, baseline_m: float, min_share: float = 0.5
) -> WindowPlanes:
    """Planes fitted to windows, their scatter, and the shape of the cells they were fitted to."""
    half = half_window(elevation.shape, cell_m, baseline_m)
    found = np.full((LAYERS, *elevation.shape), np.nan, np.float32)
    for own, planes in _blocks(elevation, half, min_share, LAYERS):
        found[(slice(None), *own)] = planes
    found[:2] /= np.float32(cell_m)
    found[2:5] *= np.float32(cell_m**2)
    return WindowPlanes(found[:2], found[5], found[2:5])


def window_mean(values: Raster, cell_m: float, baseline_m: float) -> Raster:
    """Mean of known values over the same windows; NaN where there are none."""
    half = half_window(values.shape, cell_m, baseline_m)
    known = np.isfinite(values)
    side = (2 * half + 1, 2 * half + 1)
    total, count = (
        cv2.boxFilter(part, cv2.CV_32F, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for part in (np.where(known, values, np.float32(0)), known.astype(np.float32))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, total / count, np.float32(np.nan)).astype(np.float32)


def half_window(shape: tuple[int, ...], cell_m: float, baseline_m: float) -> int:
    """Cells of a window of side `baseline_m` to either side of its middle one.

    Raises:
        TerrainError: the window is larger than the terrain model.
    """
    half = max(1, round((baseline_m / cell_m - 1) / 2))
    if 2 * half + 1 > min(shape) * 2:
        raise TerrainError(
            f"a baseline of {baseline_m} m is {2 * half + 1} cells of {cell_m} m, but the terrain "
            f"model has only {shape}: use a shorter baseline"
        )
    return half


def _blocks(
    elevation: Raster, half: int, min_share: float, layers: int
) -> Iterator[tuple[tuple[slice, slice], Float32[np.ndarray, "layers rows cols"]]]:
    """Position and `window_planes` of each block with an elevation."""
    rows, cols = elevation.shape
    for top, left in itertools.product(range(0, rows, BLOCK), range(0, cols, BLOCK)):
        own = slice(top, min(top + BLOCK, rows)), slice(left, min(left + BLOCK, cols))
        if np.isfinite(elevation[own]).any():
            above, before = max(0, top - half), max(0, left - half)
            around = elevation[above : own[0].stop + half, before : own[1].stop + half]
            inside = top - above, left - before, own[0].stop - top, own[1].stop - left
            yield own, window_planes(np.ascontiguousarray(around), half, min_share, inside, layers)


def nine_cell_gradients(elevation: Raster, cell_m: float) -> Gradients:
    """Rise per metre towards east and north; NaN where unknown and in the outermost cells."""
    known = np.isfinite(elevation)
    found = np.full((2, *elevation.shape), np.nan, np.float32)
    if not known.any():
        return found
    heights = elevation - elevation[known][0]  # single precision is finest near 0
    all_nine = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    for axis, (across, down) in zip(found, ((_STEP, _ONES), (_ONES, -_STEP)), strict=True):
        sums = cv2.sepFilter2D(heights, cv2.CV_32F, across, down)
        np.divide(sums, np.float32(6 * cell_m), out=axis, where=all_nine)
    row, col = np.nonzero((known & ~all_nine)[1:-1, 1:-1])
    if len(row):
        found[:, row + 1, col + 1] = _fit_nine(_nine(heights, row, col)) / np.float32(cell_m)
    found[:, [0, -1], :] = found[:, :, [0, -1]] = np.nan
    return found


def _nine(heights: Raster, row: np.ndarray, col: np.ndarray) -> Float32[np.ndarray, "9 n"]:
    """The nine cells from (row, col) on, relative to the one in the middle."""
    down, right = np.divmod(np.arange(9), 3)
    nine = heights[row + down[:, None], col + right[:, None]]
    return nine - nine[4]


def _fit_nine(nine: Float32[np.ndarray, "9 n"]) -> Float32[np.ndarray, "2 n"]:
    """Rise per cell of the planes through known cells; NaN where they do not define one."""
    known: Bool[np.ndarray, "9 n"] = np.isfinite(nine)
    m, h = known.astype(np.float32), np.where(known, nine, np.float32(0))
    n, e = _AROUND[:, :1], _AROUND[:, 1:]
    S_1, S_e, S_n, S_h = (sums.sum(axis=0) for sums in (m, m * e, m * n, m * h))
    S_ee, S_en, S_nn = (sums.sum(axis=0) for sums in (m * e * e, m * e * n, m * n * n))
    S_eh, S_nh = (sums.sum(axis=0) for sums in (m * e * h, m * n * h))
    with np.errstate(invalid="ignore", divide="ignore"):
        C_ee, C_en, C_nn = S_ee - S_e**2 / S_1, S_en - S_e * S_n / S_1, S_nn - S_n**2 / S_1
        C_eh, C_nh = S_eh - S_e * S_h / S_1, S_nh - S_n * S_h / S_1
        determinant = C_ee * C_nn - C_en**2
        gradient = np.stack([C_nn * C_eh - C_en * C_nh, C_ee * C_nh - C_en * C_eh]) / determinant
    thinnest = (C_ee + C_nn) / 2 - np.sqrt((C_ee - C_nn) ** 2 / 4 + C_en**2)
    fits = (_MIN_SHARE * len(m) <= S_1) & (thinnest > LEAST_SPREAD * _FULL_SPREAD)
    return np.where(fits, gradient, np.float32(np.nan)).astype(np.float32)


def filled_gradients(elevation: Raster, cell_m: float, half: int) -> Gradients:
    """Rise per metre towards east and north over windows of `half` cells either way.

    Missing cells are not excluded: they count as 0.
    """
    steps = np.arange(-half, half + 1, dtype=np.float32)
    slope = steps / np.float32((steps**2).sum() * cell_m)
    level = np.full_like(steps, 1 / len(steps))
    filled = np.nan_to_num(elevation)
    east = cv2.sepFilter2D(filled, cv2.CV_32F, slope, level, borderType=cv2.BORDER_REPLICATE)
    north = cv2.sepFilter2D(filled, cv2.CV_32F, level, -slope, borderType=cv2.BORDER_REPLICATE)
    return np.stack([east, north])
