"""Data snooping: which observations cannot be what they claim (Baarda 1968, Teunissen 1985).

With the cofactors of the whitened residuals (see `elimination`) the standardised residual of a
coordinate, and the test of a whole observation (sample, line and parallax together, for a wrong
match is wrong in all of them), are

    w_i = v_i / sqrt(q_ii),      q_ii = redundancy number, the share of an error that shows in v_i
    T = sqrt(v' Q_vv^-1 v)       chi distributed; a blunder g shifts it by sqrt(g' Q_vv g)

An observation is suspected where T / s exceeds its gate, s = max(1, robust spread 1.48 median |w|
of its kind, cross-site or not): where matching or a bent bar promised more than it held, every
residual is large, and that is a finding for sigma0 rather than a thousand blunders.

The gate depends on how many blunders there are (Benjamini and Hochberg 1995): it lets good
observations go with probability alpha (`critical_value`), or, among ties of a kind of which a share
of k/n is wrong, with q k/n, so that at most a share q of what is set aside is good.
A few blunders thus cost a mission no ties, and among many the small ones do not hide. That presumes
that the others are as good as stated: where s is above one the gate stays with alpha.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc, gammainccinv

from photogrammetry.adjustment.collinearity import (
    Observations,
    State,
    misclosures,
    partials,
)
from photogrammetry.adjustment.elimination import EliminatedTies, inverse_of
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.problem import Problem
from photogrammetry.adjustment.rotations import cross_matrix
from photogrammetry.adjustment.sightings import inverses

UNCHECKED = 1e-6
"""A redundancy number below this is rounding: nothing checks the coordinate."""

CERTAIN = 2.0
"""So many standard deviations of a count are not counted: few blunders tell nothing of others."""

LOOSE = 1.0
"""Tests below this are no sign of a blunder whatever the share of blunders."""

LINEAR = 0.1
"""A prediction tells something only while its depth is known to a tenth: within, errors propagate
linearly."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of all observations; NaN and 0 for those outside the adjustment."""

    standardised: np.ndarray
    redundancy: np.ndarray
    test: np.ndarray
    """T of every observation; zero where nothing checks it."""

    def spread(self, rows: np.ndarray) -> float:
        """max(1, robust spread of standardised residuals as far as chance does not explain it).

        1.17 / sqrt(n) is the standard deviation of the spread that n residuals show.
        """
        w, free = np.abs(self.standardised[rows]), float(self.redundancy[rows].sum())
        w = w[np.isfinite(w)]
        sure = 1.0 - CERTAIN * 1.17 / np.sqrt(max(free, 1.0))
        return max(1.0, sure * float(1.4826 * np.median(w))) if len(w) else 1.0


def residuals(problem: Problem, ties: tuple[EliminatedTies, ...], inverse: np.ndarray) -> Residuals:
    """Standardised residuals, redundancy numbers and tests."""
    observations = problem.observations
    n = len(observations)
    w, r, T = np.full((n, 3), np.nan), np.zeros((n, 3)), np.zeros(n)
    for tie in ties:
        C, rows = cofactors(problem, tie, inverse), tie.group.rows.T
        v = tie.b.reshape(C.shape[:-1])
        q = np.clip(np.diagonal(C, axis1=2, axis2=3), 0.0, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            w[rows] = np.where(q > UNCHECKED, v / np.sqrt(q), np.nan)
        r[rows], T[rows] = q, _tests(v, C)
    unmeasured = observations.weight == 0
    w[unmeasured], r[unmeasured] = np.nan, 0.0
    return Residuals(w, r, T)


def cofactors(problem: Problem, tie: EliminatedTies, inverse: np.ndarray) -> np.ndarray:
    """Q_vv of the three coordinates of each observation of a group, (n, k, 3, 3)."""
    group = tie.group
    Z = inverse[problem.pattern.indices(group.blocks, group.local)]
    relative = (tie.T @ Z @ tie.T.mT)[group.signature]
    shape = (group.points, group.seen, 3, -1)
    A, Q = tie.A.reshape(shape), tie.Q.reshape(shape)
    return np.eye(3) - Q @ Q.mT - (tie.A @ relative).reshape(shape) @ A.mT


def _tests(v: np.ndarray, C: np.ndarray) -> np.ndarray:
    """T of residuals (n, k, 3); what nothing checks has no residual and does not count."""
    checked = C.reshape(-1, 3, 3) + UNCHECKED * np.eye(3)
    weighted = inverses(checked) @ v.reshape(-1, 3, 1)
    return np.sqrt(np.maximum((v * weighted.reshape(v.shape)).sum(axis=2), 0.0))


def point_covariances(
    problem: Problem, state: State, ties: tuple[EliminatedTies, ...], inverse: np.ndarray
) -> np.ndarray:
    """Covariances of points: what their images leave open, and what their base stop carries over.

    dX = M x_b + R^-1 (noise - Q' A_o x), with `arm` the way from the base stop to the point. NaN
    for points outside the adjustment.
    """
    C = np.full((problem.observations.points, 3, 3), np.nan)
    for tie in ties:
        group, number = tie.group, tie.group.signature
        Z = inverse[problem.pattern.indices(group.blocks, group.local)][number]
        numbers = problem.observations.point[group.rows[0]]
        R_inverse = inverse_of(tie.R)
        G = -R_inverse @ tie.A1 @ tie.T[number]
        G[:, :, -6:-3] -= cross_matrix(
            state.points[numbers] - state.centres[group.stops[number, 0]]
        )
        G[:, :, -3:] += np.eye(3)
        C[numbers] = R_inverse @ R_inverse.mT + G @ Z @ G.mT
    return C


def suspects(
    problem: Problem, found: Residuals, used: np.ndarray, params: AdjustmentParams
) -> np.ndarray:
    """Numbers of the observations to take out: beyond their gate, and the worst in their pairs.

    A blunder bends what is near it, and what is right there looks wrong too; so of the tie points
    that a pair sees only the worst is taken out a round.
    """
    observations = problem.observations
    excess = found.test / gates(observations, found, used, params)
    rows = np.flatnonzero(excess > 1.0)
    if not len(rows):
        return rows
    rows = rows[np.argsort(-excess[rows], kind="stable")]
    pairs_of = _pairs_of_points(observations, np.unique(observations.point[rows]), used)
    taken: set[int] = set()
    worst = []
    for row, point in zip(rows.tolist(), observations.point[rows].tolist(), strict=True):
        if taken.isdisjoint(pairs_of[point]):
            worst.append(row)
            taken |= pairs_of[point]
    return np.array(worst, dtype=np.int64)


def _pairs_of_points(
    observations: Observations, points: np.ndarray, used: np.ndarray
) -> dict[int, set[int]]:
    """The pairs whose observations of some points are used."""
    rows = np.flatnonzero(used & np.isin(observations.point, points))
    pairs_of: dict[int, set[int]] = {}
    for point, pair in zip(
        observations.point[rows].tolist(), observations.pair[rows].tolist(), strict=True
    ):
        pairs_of.setdefault(point, set()).add(pair)
    return pairs_of


def gates(
    observations: Observations, found: Residuals, used: np.ndarray, params: AdjustmentParams
) -> np.ndarray:
    """Gate of the test of every observation, by spread and blunders of its kind."""
    T, measured = found.test.copy(), (observations.weight > 0).sum(axis=1)
    aside, joining = ~used & observations.is_stereo, _joins_stops(observations)
    gate = np.full(len(T), np.inf)
    for of_kind in (joining, ~joining):
        tested = of_kind & (found.test > 0)
        spread = found.spread(of_kind)
        T[of_kind] /= spread
        p = np.sort(_chance(T[tested & (T > LOOSE)], 3))
        set_aside = int((aside & of_kind).sum())
        share = _share_of_blunders(p, int(tested.sum()), set_aside, params.false_share)
        if spread > 1.0:  # sigmas or model are not what was stated, and tails tell nothing
            share = 0.0
        for coordinates in (2, 3):
            least = coordinates * float(gammaincc(0.5, params.critical_value**2 / 2))
            alpha = max(least, params.false_share * share)
            gate[of_kind & (measured == coordinates)] = spread * _quantile(alpha, coordinates)
    return gate


def _share_of_blunders(p: np.ndarray, tested: int, aside: int, false_share: float) -> float:
    """How many observations of a kind are wrong for certain, as a share of all.

    `p` are the smallest probabilities of their tests, ascending; others are set `aside` already.
    """
    found = aside + np.arange(len(p) + 1)
    surely = np.maximum(found - CERTAIN * np.sqrt(found), 0.0) / max(tested + aside, 1)
    passed = np.flatnonzero(p <= false_share * surely[1:])
    return float(surely[passed[-1] + 1 if len(passed) else 0])


def _chance(T: np.ndarray, coordinates: int) -> np.ndarray:
    """Probability that noise alone exceeds T (chi distribution)."""
    return gammaincc(coordinates / 2, np.square(T) / 2)


def _quantile(alpha: float, coordinates: int) -> float:
    """What noise alone exceeds with probability alpha."""
    return float(np.sqrt(2 * gammainccinv(coordinates / 2, alpha)))


def _joins_stops(observations: Observations) -> np.ndarray:
    """Which observations are of points that several stops see."""
    low = np.full(observations.points, len(observations.pair_stop))
    high = np.full(observations.points, -1)
    np.minimum.at(low, observations.point, observations.stop)
    np.maximum.at(high, observations.point, observations.stop)
    return (high > low)[observations.point]


def joint_covariances(problem: Problem, inverse: np.ndarray) -> np.ndarray:
    """(pairs, 9, 9) of turn and shift of the stop and pointing of the pair; zero where held."""
    unknowns = problem.unknowns
    local = unknowns.columns(np.arange(len(unknowns.pair_stop)))
    stops = np.repeat(unknowns.pair_stop[:, None], local.shape[1], axis=1).astype(np.int64)
    return inverse[problem.pattern.indices(stops, local)]


def single_sightings(
    observations: Observations, state: State, rows: np.ndarray, joint: np.ndarray
) -> np.ndarray:
    """Covariance of points placed by one stereo observation each."""
    A_o, A_t = partials(state, observations, rows)
    back = np.linalg.inv(A_t)
    C = np.zeros((len(rows), 3, 3))
    diagonal = 1.0 / observations.weight[rows] ** 2
    C[:, range(3), range(3)] = diagonal
    total = C + A_o @ joint[observations.pair[rows]] @ A_o.swapaxes(1, 2)
    return back @ total @ back.swapaxes(1, 2)


def reinstated(  # noqa: PLR0913, PLR0917 - the network, where it stands, and what is known of it
    problem: Problem,
    state: State,
    ties: tuple[EliminatedTies, ...],
    found: Residuals,
    used: np.ndarray,
    inverse: np.ndarray,
    params: AdjustmentParams,
) -> np.ndarray:
    """Numbers of observations set aside that fit after all.

    An observation that was left out is predicted from the point that the others give; it comes back
    when its misclosure is within its gate of what both uncertainties explain.
    """
    observations = problem.observations
    joint = joint_covariances(problem, inverse)
    C = point_covariances(problem, state, ties, inverse)
    alone = used & observations.is_stereo
    alone[problem.rows] = False
    single = np.flatnonzero(alone)
    C[observations.point[single]] = single_sightings(observations, state, single, joint)
    rows = np.flatnonzero(~used & observations.is_stereo)
    point = observations.point[rows]
    rows = rows[
        np.isfinite(C[point]).all(axis=(1, 2)) & np.isfinite(state.points[point]).all(axis=1)
    ]
    if not len(rows):
        return rows
    l = misclosures(state, observations, rows)
    A_o, A_t = partials(state, observations, rows)
    S = A_o @ joint[observations.pair[rows]] @ A_o.swapaxes(1, 2)
    S += A_t @ C[observations.point[rows]] @ A_t.swapaxes(1, 2)
    S[:, range(3), range(3)] += 1.0 / observations.weight[rows] ** 2
    l_finite = np.nan_to_num(l, nan=np.inf)
    with np.errstate(invalid="ignore"):
        misfit = (l_finite * np.linalg.solve(S, l_finite[:, :, None])[:, :, 0]).sum(axis=1)
    parallax = observations.measured[rows, 2] - l[:, 2]
    sharp = np.sqrt(np.maximum(S[:, 2, 2], 0.0)) < LINEAR * parallax
    small = np.sqrt(misfit) < gates(observations, found, used, params)[rows]
    return rows[np.isfinite(l).all(axis=1) & sharp & small]
