"""Data snooping: which observations cannot be what they claim (Baarda 1968).

An observation is suspected where its test exceeds its gate (see `residuals` and `gates`), and comes
back where what the others give of its point predicts it after all.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import (
    Observations,
    State,
    Views,
    misclosures,
    partials,
)
from solmap.photogrammetry.adjustment.elimination import EliminatedTies
from solmap.photogrammetry.adjustment.gates import gates
from solmap.photogrammetry.adjustment.params import AdjustmentParams
from solmap.photogrammetry.adjustment.problem import Problem
from solmap.photogrammetry.adjustment.residuals import (
    Residuals,
    joint_covariances,
    pair_covariances,
    point_covariances,
    single_sightings,
)

LINEAR = 0.1
"""A prediction tells something only while its depth is known to a tenth: within, errors propagate
linearly."""


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
    views = Views.of(state, observations)
    C[observations.point[single]] = single_sightings(
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
