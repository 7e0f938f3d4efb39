"""Robust alignment of stereo pairs by their ties, and the geometric test of every tie.

A tie measures a point twice: X_s from the left point and parallax of its first pair, and the left
point and parallax (x, y, p) measured in its second pair. With the pointing corrections theta of
both pairs (rotation vectors about the mast head at c: its pointing is accurate to 0.1-0.2 degrees
only), its vector a to the left camera, and the pose of the second rover in the first, E = R L + t,
the first measurement predicts the second,

    X_t = exp(-theta_t) R_t' ( R' (R_s exp(theta_s) (X_s + a_s) + c_s - t) - c_t ) - a_t
    v = (x, y, p) - h(X_t)

with h the normal case (`EpipolarPair.project`). The residuals are weighted with the covariance of
both measurements, the first one's propagated,

    C_v = diag(s_x^2, s_y^2, s_p^2) + J diag(s_x^2, s_y^2, s_p^2)_first J',

so that along the ray the uncertain range has little weight and across it the accurate direction
much. There is no scale (Di et al. 2008, section 3.2: rotation and translation only). Within a stop
the toe-in r of each camera set is unknown too: parallaxes p become p - f (1 + u^2) r, with u the
right image's (x - c)/f. A wrong toe-in shifts all ties of two camera sets, and a test without it
keeps those whose errors compensate the shift, so that they determine too small a toe-in.
Unknowns with a prior are weighted by its covariance. The robust estimate is graduated non-convexity
with the Geman-McClure kernel (Yang et al. 2020), w = (k c^2 / (v' C_v^-1 v + k c^2))^2, k falling
to 1.

Ties are tested by the squared Mahalanobis length v' C_v^-1 v against chi-square of 3 degrees of
freedom: one test for ray distance, reprojection and range, each in units of its uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Flags, Float64, ObjectPoints, PerPoint
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, projection_partials
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.ranges import Factor, Radians

ROUNDS = 14
"""Rounds of weighting, the last three with the kernel of the test."""


FIRST_SCALE = 64.0
"""Initial k: a tie 8 times further off than the limit still has a quarter of its weight."""

RIG_ROTATION_SIGMA_DEG = 0.05
"""Prior standard deviation of the right camera's rotation, per axis: the observed effect of
temperature and years on Mars on archived camera models."""


@dataclass(frozen=True, slots=True)
class AlignmentParams:
    """How ties are weighted and tested."""

    pointing_sigma: Radians = 0.0026
    """Radians (0.15 degrees) per axis: error of the mast's pointing from image to image."""
    chi_square: Factor = 11.34
    """99 % point of chi-square with 3 degrees of freedom."""

    def __post_init__(self) -> None:
        if not (self.pointing_sigma > 0 and self.chi_square > 0):
            raise MatchingError("an alignment needs a pointing sigma and a limit above zero")


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Pose of the second rover in the first, by ties."""

    first_from_second: Pose
    covariance: Float64[np.ndarray, "6 6"]
    """Covariance of rotation vector (radians), then translation (metres), in the axes of the first
    rover."""
    pointing: dict[str, Float64[np.ndarray, " 3"]]
    """Correction of every pair's pointing, a rotation vector in the pair's frame, radians."""
    mahalanobis2: PerPoint
    """Squared Mahalanobis length of every tie's residual; infinite where it has none."""
    agrees: Flags
    sigma0: float
    """Standard deviation of unit weight over the accepted ties."""
    rms_px: float
    """Root mean square of the left image residuals of the accepted ties."""


@dataclass(slots=True, eq=False)
class _System:
    """Constants of the iteration: tie k's geometry, gathered from its pairs."""

    ties: Ties
    rows: tuple[np.ndarray, np.ndarray]
    points: ObjectPoints
    covariances: Float64[np.ndarray, "n 3 3"]
    rover_from_pair: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    """(rotation, pivot) of the first and of the second pair."""
    arms: tuple[ObjectPoints, ObjectPoints]
    """From the pivot to the left camera, in the pair's axes."""
    focal: PerPoint
    base: PerPoint
    centre: Float64[np.ndarray, "n 2"]
    toe_in: tuple[Float64[np.ndarray, "n k"], Float64[np.ndarray, "n k"]]
    """Derivatives of both parallaxes by the toe-in of each camera set."""


def align(
    ties: Ties,
    geometries: Mapping[str, EpipolarPair],
    start: Pose,
    pose_prior: Float64[np.ndarray, "6 6"] | None,
    params: AlignmentParams,
    camera_sets: Mapping[str, str] | None = None,
) -> Alignment:
    """Align by ties; `start` is first_from_second, its prior covariance None where it is known.

    Pairs of one stop share the rover frame: `start` is then the identity and fixed. The pointing of
    every pair is free within its prior, and so is the toe-in of the camera sets, if `camera_sets`
    names that of every pair.
    """
    if not len(ties):
        raise MatchingError("an alignment needs at least one tie")
    used = np.unique(np.concatenate([ties.first, ties.second]))
    sets = [camera_sets[ties.pair_ids[k]] for k in used] if camera_sets else []
    system = _system(ties, geometries, used, sets)
    free_pose = 6 if pose_prior is not None else 0
    turns = 3 * len(used)
    size = free_pose + turns + len(set(sets))
    prior = np.zeros((size, size))
    if pose_prior is not None:
        prior[:6, :6] = np.linalg.inv(pose_prior)
    sigmas = np.full(size - free_pose, params.pointing_sigma)
    sigmas[turns:] = np.radians(RIG_ROTATION_SIGMA_DEG)
    prior[free_pose:, free_pose:] = np.diag(sigmas**-2.0)
    x = np.zeros(size)
    scales = np.maximum(np.geomspace(FIRST_SCALE, 0.5, ROUNDS - 3), 1.0)
    for k in (*scales, 1.0, 1.0, 1.0):
        v, design, weight = _linearise(system, x, start, free_pose)
        length2 = np.einsum("ni,nij,nj->n", v, weight, v)
        usable = np.isfinite(length2)
        kernel = (k * params.chi_square / (length2 + k * params.chi_square)) ** 2
        kernel[~usable] = 0.0
        weighted = np.swapaxes(design[usable], 1, 2) @ (weight * kernel[:, None, None])[usable]
        normal = prior + (weighted @ design[usable]).sum(axis=0)
        right = (weighted @ v[usable][:, :, None])[:, :, 0].sum(axis=0) - prior @ x
        x = x + np.linalg.solve(normal, right)
    return _result(system, x, start, free_pose, np.linalg.inv(normal), used, params)


def _system(
    ties: Ties, geometries: Mapping[str, EpipolarPair], used: np.ndarray, sets: Sequence[str]
) -> _System:
    """Gather the geometry of every tie's two pairs; camera sets are those of the used pairs."""
    pairs = [geometries[ties.pair_ids[k]] for k in used]
    rows = (np.searchsorted(used, ties.first), np.searchsorted(used, ties.second))
    rotation = np.stack([p.rover_from_pair.rotation for p in pairs])
    pivot = np.stack([p.pivot_in_rover for p in pairs])
    arm = np.stack([p.arm for p in pairs])
    focal = np.array([p.focal_px for p in pairs])
    base = np.array([p.base_m for p in pairs])
    centre = np.array([p.centre_px for p in pairs])
    f, b, c = focal[rows[0]], base[rows[0]], centre[rows[0]]
    z = f * b / ties.first_parallax_px
    points = np.column_stack([(ties.first_left - c) * (z / f)[:, None], z])
    along = points / ties.first_parallax_px[:, None] * ties.first_sigma_parallax_px[:, None]
    covariances = along[:, :, None] * along[:, None, :]
    covariances[:, 0, 0] += (z * ties.first_sigma_px / f) ** 2
    covariances[:, 1, 1] += (z * ties.first_sigma_line_px / f) ** 2
    of_set = np.array([[one == name for name in sorted(set(sets))] for one in sets], dtype=float)
    of_set = of_set.reshape(len(used), -1)
    measured = (
        (ties.first_left, ties.first_parallax_px),
        (ties.second_left, ties.second_parallax_px),
    )
    by_toe_in = [
        (focal[k] * (1 + ((left[:, 0] - parallax - centre[k][:, 0]) / focal[k]) ** 2))[:, None]
        * of_set[k]
        for k, (left, parallax) in zip(rows, measured, strict=True)
    ]
    return _System(
        ties,
        rows,
        points,
        covariances,
        ((rotation[rows[0]], pivot[rows[0]]), (rotation[rows[1]], pivot[rows[1]])),
        (arm[rows[0]], arm[rows[1]]),
        focal[rows[1]],
        base[rows[1]],
        centre[rows[1]],
        (by_toe_in[0], by_toe_in[1]),
    )


def _cross(points: ObjectPoints) -> Float64[np.ndarray, "n 3 3"]:
    """[X]x with [X]x w = X x w."""
    x, y, z = points.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def _apply(rotations: np.ndarray, points: ObjectPoints) -> ObjectPoints:
    """Every point times its own matrix."""
    return (rotations @ points[:, :, None])[:, :, 0]


def _linearise(
    system: _System, x: np.ndarray, start: Pose, free_pose: int
) -> tuple[ObjectPoints, Float64[np.ndarray, "n 3 m"], Float64[np.ndarray, "n 3 3"]]:
    """(residuals, design matrices, weights) at the present values of the unknowns."""
    sets = system.toe_in[0].shape[1]
    toe_in = x[len(x) - sets :]
    theta = x[free_pose : len(x) - sets].reshape(-1, 3)
    turn = ScipyRotation.from_rotvec(theta).as_matrix()
    (rs, cs), (rt, ct) = system.rover_from_pair
    first, second = system.rows
    pose = _move(start, x[:6]) if free_pose else start
    r, t = pose.rotation, pose.translation_m
    parallax = system.ties.first_parallax_px
    corrected = parallax - system.toe_in[0] @ toe_in
    points = system.points * (parallax / corrected)[:, None]
    turned = _apply(turn[first], points + system.arms[0])
    in_first = _apply(rs, turned) + cs
    in_second = (in_first - t) @ r
    untilted = _apply(np.swapaxes(rt, 1, 2), in_second - ct)
    back = np.swapaxes(turn[second], 1, 2)
    seen = _apply(back, untilted) - system.arms[1]
    project = projection_partials(seen, system.focal, system.base)
    to_target = project @ back @ np.swapaxes(rt, 1, 2) @ r.T
    count = len(system.points)
    design = np.zeros((count, 3, len(x)))
    if free_pose:
        design[:, :, :3] = to_target @ _cross(in_first - t)
        design[:, :, 3:6] = -to_target
    rows = np.arange(count)
    by_first, by_second = -to_target @ rs @ _cross(turned), project @ _cross(seen + system.arms[1])
    for axis in range(3):
        design[rows, :, free_pose + 3 * first + axis] += by_first[:, :, axis]
        design[rows, :, free_pose + 3 * second + axis] += by_second[:, :, axis]
    carry = to_target @ rs @ turn[first]
    design[:, :, len(x) - sets :] = (
        _apply(carry, points)[:, :, None] * (system.toe_in[0] / corrected[:, None])[:, None, :]
    )
    design[:, 2, len(x) - sets :] += system.toe_in[1]
    spread = carry @ system.covariances @ np.swapaxes(carry, 1, 2)
    own = np.column_stack(
        [
            system.ties.second_sigma_px,
            system.ties.second_sigma_line_px,
            system.ties.second_sigma_parallax_px,
        ]
    )
    spread[:, [0, 1, 2], [0, 1, 2]] += own**2
    behind = ~np.isfinite(spread).all(axis=(1, 2))
    spread[behind] = np.eye(3)
    weight = np.linalg.inv(spread)
    weight[behind] = np.nan
    return _observations(system, toe_in) - _project(seen, system), design, weight


def _observations(system: _System, toe_in: np.ndarray) -> ObjectPoints:
    """(sample, line, parallax) measured in the second pair, corrected."""
    parallax = system.ties.second_parallax_px - system.toe_in[1] @ toe_in
    return np.column_stack([system.ties.second_left, parallax])


def _project(points: ObjectPoints, system: _System) -> ObjectPoints:
    """(sample, line, parallax) of points in the second pair's frame; NaN behind the camera."""
    z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    left = system.centre + (system.focal / z)[:, None] * points[:, :2]
    return np.column_stack([left, system.focal * system.base / z])


def _move(pose: Pose, change: Float64[np.ndarray, " 6"]) -> Pose:
    """A pose rotated by a rotation vector about the source's origin and then shifted."""
    turn = ScipyRotation.from_rotvec(change[:3]).as_matrix()
    rotation = ScipyRotation.from_matrix(turn @ pose.rotation).as_matrix()
    return Pose(pose.target, pose.source, rotation, pose.translation_m + change[3:])


def _result(  # noqa: PLR0913, PLR0917 - gathers one result
    system: _System,
    x: np.ndarray,
    start: Pose,
    free_pose: int,
    cofactor: np.ndarray,
    used: np.ndarray,
    params: AlignmentParams,
) -> Alignment:
    """The alignment at the solution, with the test of every tie."""
    v, _, weight = _linearise(system, x, start, free_pose)
    length2 = np.einsum("ni,nij,nj->n", v, weight, v)
    length2 = np.where(np.isfinite(length2), length2, np.inf)
    agrees = length2 <= params.chi_square
    redundancy = 3 * int(agrees.sum()) - free_pose
    sigma0 = float(np.sqrt(length2[agrees].sum() / redundancy)) if redundancy > 0 else float("nan")
    rms = float(np.sqrt((v[agrees, :2] ** 2).mean())) if agrees.any() else float("nan")
    inflation = max(sigma0, 1.0) ** 2 if np.isfinite(sigma0) else 1.0
    covariance = cofactor[:6, :6] * inflation if free_pose else np.zeros((6, 6))
    pointing = {
        system.ties.pair_ids[k]: x[free_pose + 3 * i : free_pose + 3 * i + 3].copy()
        for i, k in enumerate(used)
    }
    pose = _move(start, x[:6]) if free_pose else start
    return Alignment(pose, covariance, pointing, length2, agrees, sigma0, rms)
