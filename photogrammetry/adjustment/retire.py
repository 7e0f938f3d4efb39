"""A stop leaves the adjustment: its conditional, and the marginal of those that stay.

Everything that touches the stop is linearised once more where the adjustment ended and triangulated
(see `marginal`): all tie points that it saw, with all their observations and freed of the points as
in `elimination`; its tilt and azimuth, the step to the next stop, its mast pointing; and what it
had inherited itself. Of a tie point that it saw, no later observation can be used any more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from photogrammetry.adjustment.collinearity import (
    Observations,
    State,
    misclosures,
    partials,
)
from photogrammetry.adjustment.marginal import Chart, Marginal
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.priors import Telemetry, telemetry_misclosures, telemetry_partials
from photogrammetry.adjustment.records import USED, AdjustedNetwork, Network
from photogrammetry.arrays import Bool, Float64


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
        return np.setdiff1d(np.arange(self.chart.size), self.leaving)


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """A network at the state where it is linearised."""

    observations: Observations
    telemetry: Telemetry
    held: Bool[np.ndarray, " stops"]
    state: State
    used: Bool[np.ndarray, " rows"]
    inherited: Marginal | None
    grounded: Bool[np.ndarray, " stops"]
    """Stops that images join to the datum."""

    @classmethod
    def of(
        cls,
        adjusted: AdjustedNetwork,
        network: Network,
        params: AdjustmentParams,
        rows: np.ndarray | None = None,
    ) -> Linear:
        """A network at the state to which it was adjusted, with what it has inherited.

        `rows` are those of the adjusted ties that the network has, if not all.
        """
        status = adjusted.ties.status if rows is None else adjusted.ties.status[rows]
        stops = {stop.stop: stop for stop in adjusted.stops}
        pairs = {pair.pair_id: pair for pair in adjusted.pairs}
        poses = [stops[stop] for stop in network.stop_ids]
        state = State(
            np.array([stop.lsl_from_rover.rotation for stop in poses]),
            np.array([stop.lsl_from_rover.translation_m for stop in poses]),
            np.array([pairs[pair.pair_id].pointing for pair in network.pairs]).reshape(-1, 3),
            adjusted.ties.points,
        )
        return cls(
            Observations.of(network),
            Telemetry.of(network, params),
            np.array([stop.held for stop in poses], dtype=bool),
            state,
            status == USED,
            Marginal.of(adjusted.memory, network) if adjusted.memory else None,
            np.array([stop.is_tied for stop in poses], dtype=bool),
        )

    def without(self, k: int, inherited: Marginal) -> Linear:
        """The network after stop k has left, and every tie point that it saw."""
        seen = np.zeros(self.observations.points, dtype=bool)
        seen[self.observations.point[self.observations.stop == k]] = True
        used = self.used & ~seen[self.observations.point]
        return replace(self, used=used, inherited=inherited)


@dataclass(frozen=True, slots=True, eq=False)
class _Columns:
    """Columns of a chart by number of stop and pair; the last one is for what is held."""

    of_stop: np.ndarray
    of_pair: np.ndarray
    count: int

    @classmethod
    def of(cls, chart: Chart, stops: int, pairs: int) -> _Columns:
        count, n = chart.size, len(chart.stops)
        of_stop, of_pair = np.full((stops, 6), count), np.full((pairs, 3), count)
        of_stop[chart.stops] = np.arange(6 * n).reshape(n, 6)
        of_pair[chart.pairs] = np.arange(6 * n, count).reshape(-1, 3)
        return cls(of_stop, of_pair, count)


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
    stops, pairs = np.union1d(stops, following), np.unique(pairs)
    stays = (stops != k) & ~network.held[stops]
    return rows, stops[stays], pairs[observations.pair_stop[pairs] != k]


def retire(network: Linear, k: int) -> tuple[Conditional, Marginal]:
    """Take stop k, the first that is left, out of a network."""
    rows, stops, pairs = neighbours(network, k)
    mine = np.flatnonzero(network.observations.pair_stop == k)
    own = np.zeros(0, dtype=np.int64) if network.held[k] else np.array([k])
    chart = Chart.at(network.state, np.concatenate([own, stops]), np.concatenate([mine, pairs]))
    columns = _Columns.of(chart, len(network.held), len(network.state.pointings))
    ties, told = _tie_rows(network, rows, columns), _telemetry_rows(network, k, columns)
    parts = [ties, told, _pointing_rows(network, mine, columns)]
    spent, surplus = 0.0, _coordinates(network.observations, rows) + len(told) + 3 * len(mine)
    if network.inherited:
        parts.append(_inherited_rows(network.inherited, network.state, columns))
        spent, surplus = network.inherited.spent, surplus + network.inherited.surplus
    leaving = np.concatenate([columns.of_stop[own].ravel(), columns.of_pair[mine].ravel()])
    conditional, root, right, rest = _triangulated(
        chart, network.state, np.concatenate(parts), leaving
    )
    stays = Chart.at(network.state, stops, pairs)
    grounded = network.grounded[stops]
    return conditional, Marginal(stays, root, right, grounded, spent + rest, surplus - len(leaving))


def _coordinates(observations: Observations, rows: np.ndarray) -> int:
    """Coordinates measured in some rows, beyond those that their points take up."""
    return int((observations.weight[rows] > 0).sum()) - 3 * len(np.unique(observations.point[rows]))


def _triangulated(
    chart: Chart, state: State, A: np.ndarray, leaving: np.ndarray
) -> tuple[Conditional, np.ndarray, np.ndarray, float]:
    """Conditional, and root, right-hand side and spent sum of squares of the marginal."""
    staying = np.setdiff1d(np.arange(chart.size), leaving)
    in_z = np.linalg.solve(chart.partials(state).T, A[:, :-1].T).T
    full = np.column_stack([in_z[:, leaving], in_z[:, staying], A[:, -1]])
    (R,) = qr(full, mode="r", check_finite=False, overwrite_a=True)
    s, n = len(leaving), chart.size
    conditional = Conditional(chart, leaving, R[:s, :s], R[:s, s:n], R[:s, n])
    spent = float(R[n, n] ** 2) if len(R) > n else 0.0
    return conditional, np.ascontiguousarray(R[s:n, s:n]), R[s:n, n].copy(), spent


def _tie_rows(network: Linear, rows: np.ndarray, columns: _Columns) -> np.ndarray:
    """Whitened observation equations of tie points, freed of the points."""
    observations, state = network.observations, network.state
    weight = observations.weight[rows]
    l = misclosures(state, observations, rows) * weight
    A_o, A_t = partials(state, observations, rows)
    A_o, A_t = A_o * weight[:, :, None], A_t * weight[:, :, None]
    order = np.argsort(observations.point[rows], kind="stable")
    _, first, counts = np.unique(
        observations.point[rows[order]], return_index=True, return_counts=True
    )
    parts = [np.zeros((0, columns.count + 1))]
    for k in np.unique(counts).tolist():
        members = order[first[counts == k][:, None] + np.arange(k)]
        n = len(members)
        free = np.linalg.qr(A_t[members].reshape(n, 3 * k, 3), mode="complete")[0][:, :, 3:]
        dense = np.zeros((n, 3 * k, columns.count + 1))
        for i in range(k):
            pair = observations.pair[rows[members[:, i]]]
            at = np.column_stack(
                [columns.of_stop[observations.pair_stop[pair]], columns.of_pair[pair]]
            )
            part = dense[:, 3 * i : 3 * i + 3]
            np.put_along_axis(part, np.repeat(at[:, None], 3, axis=1), A_o[members[:, i]], axis=2)
        dense[:, :, -1] = l[members].reshape(n, 3 * k)  # over the bin of what is held
        parts.append((free.swapaxes(1, 2) @ dense).reshape(-1, columns.count + 1))
    return np.concatenate(parts)


def _telemetry_rows(network: Linear, k: int, columns: _Columns) -> np.ndarray:
    """Tilt and measured azimuth of the stop, and the step from it to the next."""
    stops = np.arange(k, min(k + 2, len(network.held)))
    ends, link = network.state.of_stops(stops), network.telemetry.of_stops(stops)
    l = telemetry_misclosures(ends, link) * link.weight
    A = telemetry_partials(ends, link) * link.weight[:, :, None]
    dense = np.zeros((len(stops), 6, columns.count + 1))
    dense[0][:, columns.of_stop[k]] = A[0, :, 6:]
    if len(stops) > 1:
        dense[1][:, columns.of_stop[k]] = A[1, :, :6]
        dense[1][:, columns.of_stop[k + 1]] = A[1, :, 6:]
    dense[:, :, -1] = l
    counts = link.weight > 0
    counts[0] &= not network.held[k]
    counts[0, 3:] = False  # went with the stop before
    counts[0, 2] &= link.is_fine[0]
    counts[1:, :2] = False  # stay
    counts[1:, 2] &= ~link.is_fine[1:]
    return dense[counts]


def _pointing_rows(network: Linear, pairs: np.ndarray, columns: _Columns) -> np.ndarray:
    """The mast pointing of some pairs, observed to be zero."""
    dense = np.zeros((3 * len(pairs), columns.count + 1))
    dense[np.arange(3 * len(pairs)), columns.of_pair[pairs].ravel()] = 1.0
    dense[:, -1] = -network.state.pointings[pairs].ravel()
    return dense * network.telemetry.pointing_weight


def _inherited_rows(inherited: Marginal, state: State, columns: _Columns) -> np.ndarray:
    """What the stop had inherited, in the columns of the chart."""
    A, l = inherited.rows(state)
    at = np.concatenate([columns.of_stop[inherited.stops], columns.of_pair[inherited.pairs]], None)
    dense = np.zeros((len(A), columns.count + 1))
    dense[:, at] = A
    dense[:, -1] = l
    return dense
