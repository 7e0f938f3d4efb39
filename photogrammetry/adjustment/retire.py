"""A stop leaves the adjustment: its conditional, and the marginal of those that stay.

Everything that touches the stop is linearised once more where the adjustment ended and triangulated
(see `marginal`): all tie points that it saw, with all their observations and freed of the points as
in `elimination`; its tilt and azimuth, the step to the next stop, its mast pointing; and what it
had inherited itself. Of a tie point that it saw, no later observation can be used any more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from photogrammetry.adjustment.collinearity import STOP_UNKNOWNS, Observations, State
from photogrammetry.adjustment.linear import Linear
from photogrammetry.adjustment.marginal import Chart, Marginal
from photogrammetry.adjustment.touching import (
    Columns,
    control_rows,
    inherited_rows,
    pointing_rows,
    telemetry_rows,
    tie_rows,
)
from photogrammetry.arrays import Float64

_geqrf = get_lapack_funcs("geqrf", dtype=np.float64)
BLOCK = 32
"""Columns that are triangulated together."""


@dataclass(frozen=True, slots=True, eq=False)
class Conditional:
    """Where a stop and its pairs are, given those that stayed: own z_s + other z_T = right."""

    chart: Chart
    leaving: np.ndarray
    """Columns of the chart that left."""
    own: Float64[np.ndarray, "s s"]
    other: Float64[np.ndarray, "s t"]
    right: Float64[np.ndarray, " s"]

    @property
    def staying(self) -> np.ndarray:
        """Columns of the chart that stayed."""
        return _others(self.chart.size, self.leaving)


def _others(count: int, some: np.ndarray) -> np.ndarray:
    """The numbers below `count` that are not among some."""
    rest = np.ones(count, dtype=bool)
    rest[some] = False
    return np.flatnonzero(rest)


def neighbours(network: Linear, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What stop k leaves behind: tie rows that go with it, stops that stay, pairs that stay."""
    observations, inherited = network.observations, network.inherited
    seen = np.zeros(observations.points, dtype=bool)
    seen[observations.point[observations.stop == k]] = True
    rows = np.flatnonzero(network.used & seen[observations.point])
    counts = np.bincount(observations.point[rows], minlength=observations.points)
    rows = rows[counts[observations.point[rows]] > 1]
    stops, pairs = observations.stop[rows], observations.pair[rows]
    following = np.array([k + 1]) if k + 1 < len(network.held) else np.zeros(0, dtype=np.int64)
    if inherited:
        stops = np.concatenate([stops, inherited.stops])
        pairs = np.concatenate([pairs, inherited.pairs])
    stops, pairs = _numbers(np.concatenate([stops, following])), _numbers(pairs)
    stays = (stops != k) & ~network.held[stops]
    return rows, stops[stays], pairs[observations.pair_stop[pairs] != k]


def _numbers(found: np.ndarray) -> np.ndarray:
    """Which numbers occur, ascending."""
    return np.flatnonzero(np.bincount(found))


def retire(network: Linear, k: int) -> tuple[Conditional, Marginal]:
    """Take stop k, the first that is left, out of a network."""
    rows, stops, pairs = neighbours(network, k)
    mine = np.flatnonzero(network.observations.pair_stop == k)
    own = np.zeros(0, dtype=np.int64) if network.held[k] else np.array([k])
    frames = _frames(network, k)
    chart = Chart.at(
        network.state, np.concatenate([own, stops]), np.concatenate([mine, pairs]), frames
    )
    state = network.state
    columns = Columns.of(chart, len(network.held), len(state.pointings), len(state.frames))
    ties, told = tie_rows(network, rows, columns), telemetry_rows(network, k, columns)
    placed = control_rows(network, k, columns)
    parts = [ties, told, placed, pointing_rows(network, mine, columns)]
    told_of = len(told) + len(placed) + 3 * len(mine)
    spent, surplus = 0.0, _coordinates(network.observations, rows) + told_of
    if network.inherited:
        parts.append(inherited_rows(network.inherited, network.state, columns))
        spent, surplus = network.inherited.spent, surplus + network.inherited.surplus
    leaving = np.concatenate([columns.of_stop[own].ravel(), columns.of_pair[mine].ravel()])
    conditional, root, right, rest = _triangulated(
        chart, network.state, np.concatenate(parts), leaving
    )
    stays = Chart.at(network.state, stops, pairs, frames)
    grounded = network.grounded[stops]
    return conditional, Marginal(stays, root, right, grounded, spent + rest, surplus - len(leaving))


def _frames(network: Linear, k: int) -> np.ndarray:
    """Control frames that stop k, or what it inherited, speaks of, and whose place is unknown."""
    frames, control = np.zeros(0, dtype=np.int64), network.control
    if control:
        used = control.frame[control.used & (control.stop == k)]
        frames = np.unique(used[control.is_free[used].any(axis=1)])
    return np.union1d(frames, network.inherited.frames) if network.inherited else frames


def _coordinates(observations: Observations, rows: np.ndarray) -> int:
    """Coordinates measured in some rows, beyond those that their points take up."""
    return int((observations.weight[rows] > 0).sum()) - 3 * len(_numbers(observations.point[rows]))


def _triangulated(
    chart: Chart, state: State, A: np.ndarray, leaving: np.ndarray
) -> tuple[Conditional, np.ndarray, np.ndarray, float]:
    """Conditional, and root, right-hand side and spent sum of squares of the marginal."""
    posed, columns = STOP_UNKNOWNS * len(chart.stops), A.T.copy()
    J = chart.partials(state)[:posed, :posed]  # pointings are their own z
    columns[:posed] = np.linalg.solve(J.T, columns[:posed])
    s, n = len(leaving), chart.size
    full = columns[np.concatenate([leaving, _others(n, leaving), [n]])].T
    R = np.triu(_geqrf(full, lwork=BLOCK * (n + 1), overwrite_a=True)[0][: n + 1])
    conditional = Conditional(chart, leaving, R[:s, :s], R[:s, s:n], R[:s, n])
    spent = float(R[n, n] ** 2) if len(R) > n else 0.0
    return conditional, np.ascontiguousarray(R[s:n, s:n]), R[s:n, n].copy(), spent
