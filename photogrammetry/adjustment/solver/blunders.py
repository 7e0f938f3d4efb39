"""Data snooping: detect observations that contradict their standard deviations (Baarda 1968).

**Tie points.** An observation is suspected where its test T (see `residuals`) exceeds its gate, and
is used again where the point by the other observations predicts it. The gate is multiplied by s =
max(1, robust spread 1.48 median |w| of its kind, cross-site or not): where matching stated too
small standard deviations, or the stereo rig is bent, every residual is large; that is a matter of
sigma0, not a thousand blunders.

The gate depends on how many blunders there are (Benjamini and Hochberg 1995): it rejects good
observations with probability alpha (`critical_value`), or, among ties of a kind of which a share of
k/n is wrong, with q k/n, so that at most a share q of what is set aside is good. With few blunders
almost no good tie is lost, and among many blunders the small ones are found. This requires that the
other ties are as good as stated: where s is above one, alpha is kept. With an infinite
`critical_value` nothing is set aside.

**Control.** With the whitened misclosure l of a stop's control at the solution, its derivatives A,
the cofactors Z of all unknowns and the weight w that it had (1; 0 if set aside; less than 1 under a
robust loss), the control is tested as a whole against its prediction by all other observations,

    T^2 = l' [(I + (1 - w) A Z A') (I - w A Z A')]^-1 l             chi distributed

which is v' Q_vv^-1 v for w = 1. Of a frame only the worst is set aside in a round, because a wrong
position distorts its neighbours; those that fit later are used again. Where one of two
contradicting positions was set aside and no other observation checks the second, it cannot be
decided which is wrong: both are set aside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import gammaincc, gammainccinv

from solmap.photogrammetry.adjustment.model.collinearity import (
    Observations,
    State,
    Views,
    misclosures,
    partials,
    seen_from_several,
)
from solmap.photogrammetry.adjustment.model.control_equations import Control
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.solver.elimination import EliminatedTies
from solmap.photogrammetry.adjustment.solver.normal_equations import control_weights
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.adjustment.solver.residuals import (
    CERTAIN,
    UNCHECKED,
    Residuals,
    joint_covariances,
    pair_covariances,
    point_covariances,
    single_sighting_covariances,
)
from solmap.photogrammetry.arrays import Float64, PerPoint

FALSE_SHARE = 0.1
"""Share of good ones among excluded observations down to which the gate is lowered where many are
wrong."""


LINEAR = 0.1
"""Relative depth error up to which a prediction is valid, because errors propagate linearly."""
CHI_MEDIAN = {2: 1.177, 3: 1.538, 4: 1.832}
"""Median length of a standard normal vector by its number of coordinates."""
ALONE = 0.05
"""Redundancy below which the rest of a frame counts as unchecked."""


def gates(
    observations: Observations, found: Residuals, used: np.ndarray, params: AdjustmentParams
) -> np.ndarray:
    """Gate of the test of every observation, by spread and blunders of its kind."""
    T, measured = found.test.copy(), (observations.sights.weight > 0).sum(axis=0)
    aside, joining = ~used & observations.is_stereo, _joins_stops(observations)
    # below this no observation is suspected, whatever the fraction of blunders
    loose = _quantile(FALSE_SHARE, 3)
    gate = np.full(len(T), np.inf)
    for of_kind in (joining, ~joining):
        tested = of_kind & (found.test > 0)
        spread = found.spread(of_kind)
        T[of_kind] /= spread
        p = np.sort(_chance(T[tested & (loose < T)], 3))
        set_aside = int((aside & of_kind).sum())
        share = _share_of_blunders(p, int(tested.sum()), set_aside)
        if spread > 1.0 or np.isinf(params.critical_value):
            # the stated sigmas or the model are wrong, so the tails carry no information
            share = 0.0
        for coordinates in (2, 3):
            least = coordinates * float(gammaincc(0.5, params.critical_value**2 / 2))
            alpha = max(least, FALSE_SHARE * share)
            gate[of_kind & (measured == coordinates)] = spread * _quantile(alpha, coordinates)
    return gate


def _share_of_blunders(p: np.ndarray, tested: int, aside: int) -> float:
    """Lower bound of the fraction of wrong observations of a kind.

    `p` are the smallest probabilities of their tests, ascending; others are set `aside` already.
    """
    found = aside + np.arange(len(p) + 1)
    lower_bound = np.maximum(found - CERTAIN * np.sqrt(found), 0.0) / max(tested + aside, 1)
    passed = np.flatnonzero(p <= FALSE_SHARE * lower_bound[1:])
    return float(lower_bound[passed[-1] + 1 if len(passed) else 0])


def _chance(T: np.ndarray, coordinates: int) -> np.ndarray:
    """Probability that noise alone exceeds T (chi distribution)."""
    return gammaincc(coordinates / 2, np.square(T) / 2)


@cache
def _quantile(alpha: float, coordinates: int) -> float:
    """Value that noise exceeds with probability alpha."""
    return float(np.sqrt(2 * gammainccinv(coordinates / 2, alpha)))


def _joins_stops(observations: Observations) -> np.ndarray:
    """Which observations are of points that several stops see."""
    point = observations.point
    return seen_from_several(point, observations.stop, observations.points)[point]


def suspects(
    problem: Problem, found: Residuals, used: np.ndarray, params: AdjustmentParams
) -> np.ndarray:
    """Numbers of the observations to remove: beyond their gate, and the worst in their pairs.

    A blunder distorts its neighbourhood, so that good observations there fail the test too;
    therefore only the worst tie point of each pair is removed in a round.
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


def reinstate(  # noqa: PLR0913, PLR0917 - the network, where it stands, and what is known of it
    problem: Problem,
    state: State,
    ties: tuple[EliminatedTies, ...],
    found: Residuals,
    used: np.ndarray,
    inverse: np.ndarray,
    params: AdjustmentParams,
) -> np.ndarray:
    """Numbers of observations set aside that fit now.

    An observation that was left out is predicted from the point by the others; it is used again
    when its misclosure is within the gate by both uncertainties.
    """
    observations = problem.observations
    joint = joint_covariances(problem, inverse)
    C = point_covariances(problem, state, ties, inverse)
    alone = used & observations.is_stereo
    alone[problem.rows] = False
    single = np.flatnonzero(alone)
    views = Views.of(state, observations)
    C[observations.point[single]] = single_sighting_covariances(
        views, observations.sights.at(single), pair_covariances(views, joint)
    )
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


@dataclass(frozen=True, slots=True, eq=False)
class ControlTests:
    """Agreement of all control with all other observations."""

    length: PerPoint
    """T; zero where no other observation checks it."""
    redundancy: PerPoint
    """Mean redundancy number."""
    gate: PerPoint
    """T beyond which it is a blunder."""

    def worst(self, control: Control) -> np.ndarray:
        """Numbers of the worst blunder of every frame, and of control indistinguishable from it."""
        wrong = control.used & (self.length > self.gate) & ~control.is_datum
        doubtful = control.used & (self.redundancy < ALONE) & ~control.is_datum
        doubtful &= np.isin(control.frame, control.frame[~control.used])
        found = [np.flatnonzero(doubtful)]
        for frame in np.unique(control.frame[wrong]):
            mine = wrong & (control.frame == frame)
            found.append(np.flatnonzero(mine)[[self.length[mine].argmax()]])
        return np.concatenate(found)

    def fitting(self, control: Control) -> np.ndarray:
        """Numbers of control that was set aside and fits now."""
        return np.flatnonzero(~control.used & (self.length <= self.gate))


def control_stands_out(control: Control, state: State, params: AdjustmentParams) -> bool:
    """Whether some control is far enough off to mask others, or is set aside."""
    far = np.linalg.norm(control.whitened_misclosures(state), axis=1) > params.critical_value
    return bool((far | ~control.used).any())


def control_tests(
    problem: Problem,
    state: State,
    inverse: np.ndarray,
    params: AdjustmentParams,
    threshold: float | None = None,
) -> ControlTests:
    """Tests of all control at a solution; `threshold` is that of the robust loss."""
    control, places = problem.control, problem.control_places
    if control is None or places is None or not len(control.stop):
        none = np.zeros(0)
        return ControlTests(none, none, none)
    l, (of_stop, of_frame) = control.whitened_misclosures(state), control.partials(state)
    A = np.concatenate([of_frame, of_stop], axis=2)
    predicted = A @ inverse[places] @ A.mT
    weight = control_weights(control, l, threshold)
    w, unit = weight[:, None, None], np.eye(l.shape[1])
    Q = unit - w * predicted
    spread = (unit + (1.0 - w) * predicted) @ (Q + UNCHECKED * unit)
    T = np.sqrt(np.maximum((l * np.linalg.solve(spread, l[:, :, None])[:, :, 0]).sum(axis=1), 0.0))
    checked = np.clip(np.diagonal(Q, axis1=1, axis2=2), 0.0, 1.0) * control.is_given
    count = control.is_given.sum(axis=1)
    redundancy = checked.sum(axis=1) / count
    T = np.where(checked.max(axis=1) > UNCHECKED, T, 0.0)
    return ControlTests(T, redundancy, _gates(T, redundancy, count, control, params))


def _gates(
    T: PerPoint,
    redundancy: PerPoint,
    count: np.ndarray,
    control: Control,
    params: AdjustmentParams,
) -> Float64[np.ndarray, " n"]:
    """Thresholds of control: alpha of `critical_value`, wider if all of it fits badly."""
    gate = np.empty(len(T))
    chance = float(gammaincc(0.5, params.critical_value**2 / 2))
    median = np.array([CHI_MEDIAN[k] for k in count.tolist()])
    for frame in np.unique(control.frame):
        mine = control.frame == frame
        free = float((redundancy * count)[mine].sum())
        sure = 1.0 - CERTAIN * 1.17 / np.sqrt(max(free, 1.0))
        gate[mine] = max(1.0, sure * float(np.median((T / median)[mine])))
    for k in np.unique(count).tolist():
        gate[count == k] *= np.sqrt(2 * gammainccinv(k / 2, k * chance))
    return gate
