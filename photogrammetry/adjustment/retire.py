"""A stop leaves the adjustment: its conditional, and the marginal of those that stay.

Everything that touches the stop is linearised where the adjustment ended and triangulated (see
`marginal`): all tie points that it saw, with all their observations and freed of the points as the
adjustment did last (`elimination`); its tilt and azimuth, the step to the next stop, its mast
pointing; and what it had inherited itself. Of a tie point that it saw, no later observation can be
used any more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import STOP_UNKNOWNS, Observations
from solmap.photogrammetry.adjustment.linear import Linear
from solmap.photogrammetry.adjustment.marginal import Chart, Marginal
from solmap.photogrammetry.adjustment.observations import numbers
from solmap.photogrammetry.adjustment.touching import (
    Columns,
    control_rows,
    inherited_rows,
    pointing_rows,
    telemetry_rows,
    tie_rows,
    triangulated,
)
from solmap.photogrammetry.arrays import Float64


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


@dataclass(frozen=True, slots=True, eq=False)
class Leaving:
    """A stop that is to leave a network, what goes with it, and what stays that it is tied to."""

    stop: int
    rows: np.ndarray
    """Observations that go with it."""
    stops: np.ndarray
    pairs: np.ndarray


def leaving(network: Linear, k: int) -> Leaving:
    """Stop k, and what it leaves behind."""
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
    stops, pairs = numbers(np.concatenate([stops, following])), numbers(pairs)
    stays = (stops != k) & ~network.held[stops]
    return Leaving(k, rows, stops[stays], pairs[observations.pair_stop[pairs] != k])


def retire(network: Linear, leaves: Leaving) -> tuple[Conditional, Marginal]:
    """Take a stop, the first that is left, out of a network."""
    k, rows, stops, pairs = leaves.stop, leaves.rows, leaves.stops, leaves.pairs
    mine = np.flatnonzero(network.observations.pair_stop == k)
    own = np.zeros(0, dtype=np.int64) if network.held[k] else np.array([k])
    frames = _frames(network, k)
    state, of_chart = network.state, (np.append(own, stops), np.append(mine, pairs), frames)
    chart = Chart.at(state, *of_chart)
    columns = Columns.of(chart, len(network.held), len(state.pointings), len(state.frames))
    told, placed = telemetry_rows(network, k, columns), control_rows(network, k, columns)
    others = [told, placed, pointing_rows(network, mine, columns)]
    told_of = len(told) + len(placed) + 3 * len(mine)
    spent, surplus = 0.0, _coordinates(network.observations, rows) + told_of
    if network.inherited:
        others.append(inherited_rows(network.inherited, state, columns))
        spent, surplus = network.inherited.spent, surplus + network.inherited.surplus
    everything = np.concatenate([tie_rows(network, rows, columns), *others])
    gone = np.append(columns.of_stop[own], columns.of_pair[mine])
    conditional, root, right, rest = _triangulated(chart, _in_coordinates(everything, chart), gone)
    stays = Chart.at(state, stops, pairs, frames)
    grounded = network.grounded[stops]
    return conditional, Marginal(stays, root, right, grounded, spent + rest, surplus - len(gone))


def _frames(network: Linear, k: int) -> np.ndarray:
    """Control frames that stop k, or what it inherited, speaks of, and whose place is unknown."""
    frames, control = np.zeros(0, dtype=np.int64), network.control
    if control:
        used = control.frame[control.used & (control.stop == k)]
        frames = np.unique(used[control.is_free[used].any(axis=1)])
    return np.union1d(frames, network.inherited.frames) if network.inherited else frames


def _coordinates(observations: Observations, rows: np.ndarray) -> int:
    """Coordinates measured in some rows, beyond those that their points take up."""
    return int((observations.weight[rows] > 0).sum()) - 3 * len(numbers(observations.point[rows]))


def _in_coordinates(rows: np.ndarray, chart: Chart) -> np.ndarray:
    """Equations of corrections in the LSL, where a chart is, as those of its coordinates."""
    posed = STOP_UNKNOWNS * len(chart.stops)
    rows[:, :posed] = rows[:, :posed] @ chart.poses_by_coordinates
    return rows


def _triangulated(
    chart: Chart, A: np.ndarray, gone: np.ndarray
) -> tuple[Conditional, np.ndarray, np.ndarray, float]:
    """Conditional, and root, right-hand side and spent sum of squares of the marginal."""
    s, n = len(gone), chart.size
    R = triangulated(A[:, np.concatenate([gone, _others(n, gone), [n]])])
    conditional = Conditional(chart, gone, R[:s, :s], R[:s, s:n], R[:s, n])
    spent = float(R[n, n] ** 2) if len(R) > n else 0.0
    return conditional, np.ascontiguousarray(R[s:n, s:n]), R[s:n, n].copy(), spent
