"""Marginalise a stop: keep exactly what its observations determine of the remaining stops.

All observations that depend on the stop are linearised at the solution and triangulated (see
`marginal`): all tie points that it saw, with all their observations, after elimination of the
points (`elimination`); its tilt and azimuth, the increment to the next stop, its mast pointing; and
the earlier marginal. No later observation of these tie points can be used.

The Jacobian rows are whitened, A x = l for corrections in the LSL in the columns of a chart, one
row per observation, with l in the last column. Columns of a held stop are mapped to the last one
too, and are overwritten there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import get_lapack_funcs

from solmap.photogrammetry.adjustment.model.adjusted_network import USED, AdjustedNetwork
from solmap.photogrammetry.adjustment.model.collinearity import (
    STOP_UNKNOWNS,
    Observations,
    State,
    distinct,
)
from solmap.photogrammetry.adjustment.model.control_equations import (
    ROWS,
    Control,
    frame_places,
    was_used,
)
from solmap.photogrammetry.adjustment.model.network import FRAME_UNKNOWNS, Network
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.telemetry import (
    Telemetry,
    telemetry_misclosures,
    telemetry_partials,
)
from solmap.photogrammetry.adjustment.solver.elimination import EliminatedTies
from solmap.photogrammetry.adjustment.solver.estimate import Outcome
from solmap.photogrammetry.adjustment.solver.marginal import Chart, Marginal
from solmap.photogrammetry.adjustment.solver.scatter import weigh
from solmap.photogrammetry.arrays import Bool, Float64

_geqrf = get_lapack_funcs("geqrf", dtype=np.float64)
BLOCK = 32
"""Number of columns that are triangulated together."""


@dataclass(frozen=True, slots=True, eq=False)
class SolvedNetwork:
    """A network at its adjusted state, which is the linearisation point."""

    observations: Observations
    telemetry: Telemetry
    held: Bool[np.ndarray, " stops"]
    state: State
    used: Bool[np.ndarray, " rows"]
    inherited: Marginal | None
    grounded: Bool[np.ndarray, " stops"]
    """Stops joined to the datum by images."""
    control: Control | None = None
    ties: tuple[EliminatedTies, ...] = ()
    """The used tie points that several pairs see, at the last linearisation."""

    @classmethod
    def of(
        cls, adjusted: AdjustedNetwork, network: Network, params: AdjustmentParams
    ) -> SolvedNetwork:
        """A network at its adjusted state, with its earlier marginal."""
        stops = {stop.stop: stop for stop in adjusted.stops}
        pairs = {pair.pair_id: pair for pair in adjusted.pairs}
        poses = [stops[stop] for stop in network.stop_ids]
        state = State(
            np.array([stop.lsl_from_rover.rotation for stop in poses]),
            np.array([stop.lsl_from_rover.translation_m for stop in poses]),
            np.array([pairs[pair.pair_id].pointing for pair in network.pairs]).reshape(-1, 3),
            adjusted.ties.points,
            frame_places(adjusted.frames, network),
            adjusted.mast.values,
        )
        return cls(
            weigh(network, adjusted.components),
            Telemetry.of(network, adjusted.components.apply(params)),
            np.array([stop.held for stop in poses], dtype=bool),
            state,
            adjusted.ties.status == USED,
            Marginal.of(adjusted.memory, network) if adjusted.memory else None,
            np.array([stop.is_tied for stop in poses], dtype=bool),
            _control(adjusted, network),
        )

    @classmethod
    def of_outcome(cls, outcome: Outcome, grounded: Bool[np.ndarray, " stops"]) -> SolvedNetwork:
        """The network at the solution of an adjustment."""
        problem = outcome.problem
        return cls(
            outcome.observations,
            problem.telemetry,
            problem.held,
            outcome.solution.state,
            outcome.used,
            problem.inherited,
            grounded,
            problem.control,
            outcome.ties,
        )

    def without_stop(self, k: int, inherited: Marginal) -> SolvedNetwork:
        """The network after stop k, and every tie point that it saw, was marginalised."""
        seen = np.zeros(self.observations.points, dtype=bool)
        seen[self.observations.point[self.observations.stop == k]] = True
        used = self.used & ~seen[self.observations.point]
        return replace(self, used=used, inherited=inherited)


def _control(adjusted: AdjustedNetwork, network: Network) -> Control | None:
    """The control of a network, used where the adjustment used it."""
    if not network.frames:
        return None
    control = Control.of(network)
    return control.with_used(was_used(network.control, adjusted.control))


def _others(count: int, some: np.ndarray) -> np.ndarray:
    """The numbers below `count` that are not among the given ones."""
    rest = np.ones(count, dtype=bool)
    rest[some] = False
    return np.flatnonzero(rest)


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """A stop to marginalise: its observations, and the unknowns that they couple it with."""

    stop: int
    rows: np.ndarray
    """Observations of the tie points that it sees; they are marginalised with it."""
    stops: np.ndarray
    """Remaining stops that are not held."""
    pairs: np.ndarray
    """Pairs of other stops."""


def coupling_of(network: SolvedNetwork, k: int) -> Coupling:
    """The coupling of stop k with the rest of a network."""
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
    stops, pairs = distinct(np.concatenate([stops, following])), distinct(pairs)
    stays = (stops != k) & ~network.held[stops]
    return Coupling(k, rows, stops[stays], pairs[observations.pair_stop[pairs] != k])


def marginalise(network: SolvedNetwork, coupling: Coupling) -> Marginal:
    """Marginalise the first stop of a network: its information about the remaining ones."""
    k, rows, stops, pairs = coupling.stop, coupling.rows, coupling.stops, coupling.pairs
    mine = np.flatnonzero(network.observations.pair_stop == k)
    own = np.zeros(0, dtype=np.int64) if network.held[k] else np.array([k])
    frames = _frames(network, k)
    state, of_chart = network.state, (np.append(own, stops), np.append(mine, pairs), frames)
    mast = network.telemetry.mast_unknowns
    chart = Chart.at(state, *of_chart, mast)
    columns = Columns.of(chart, len(network.held), len(state.pointings), len(state.frames))
    others = [
        telemetry_rows(network, k, columns),
        control_rows(network, k, columns),
        pointing_rows(network, mine, columns),
    ]
    spent, surplus = 0.0, _coordinates(network.observations, rows) + sum(map(len, others))
    if network.inherited:
        others.append(inherited_rows(network.inherited, state, columns))
        spent, surplus = network.inherited.spent, surplus + network.inherited.surplus
    everything = np.concatenate([tie_rows(network, rows, columns), *others])
    gone = np.append(columns.of_stop[own], columns.of_pair[mine])
    root, right, rest = _marginal_root(chart, _in_coordinates(everything, chart), gone)
    stays = Chart.at(state, stops, pairs, frames, mast)
    grounded = network.grounded[stops]
    return Marginal(stays, root, right, grounded, spent + rest, surplus - len(gone))


def _frames(network: SolvedNetwork, k: int) -> np.ndarray:
    """Control frames of unknown position in the control of stop k, or in the earlier marginal."""
    frames, control = np.zeros(0, dtype=np.int64), network.control
    if control:
        used = control.frame[control.used & (control.stop == k)]
        frames = np.unique(used[control.is_free[used].any(axis=1)])
    return np.union1d(frames, network.inherited.frames) if network.inherited else frames


def _coordinates(observations: Observations, rows: np.ndarray) -> int:
    """Coordinates measured in some rows, minus those of their points."""
    return int((observations.weight[rows] > 0).sum()) - 3 * len(distinct(observations.point[rows]))


def _in_coordinates(rows: np.ndarray, chart: Chart) -> np.ndarray:
    """Equations of corrections in the LSL, at a chart's values, in its coordinates."""
    posed = STOP_UNKNOWNS * len(chart.stops)
    rows[:, :posed] = rows[:, :posed] @ chart.poses_by_coordinates
    return rows


def _marginal_root(
    chart: Chart, A: np.ndarray, gone: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Root, right-hand side and constant part of the sum of squares of the marginal."""
    s, n = len(gone), chart.size
    R = triangulate(A[:, np.concatenate([gone, _others(n, gone), [n]])])
    spent = float(R[n, n] ** 2) if len(R) > n else 0.0
    return np.ascontiguousarray(R[s:n, s:n]), R[s:n, n].copy(), spent


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of a chart by number of stop, pair, frame; held ones map to the last."""

    of_stop: np.ndarray
    of_pair: np.ndarray
    of_frame: np.ndarray
    of_mast: np.ndarray
    count: int

    @classmethod
    def of(cls, chart: Chart, stops: int, pairs: int, frames: int) -> Columns:
        """Of a chart in a network with these numbers of stops, pairs and control frames."""
        count, n, m = chart.size, len(chart.stops), len(chart.frames)
        of_stop, of_pair = np.full((stops, 6), count), np.full((pairs, 3), count)
        of_stop[chart.stops] = np.arange(6 * n).reshape(n, 6)
        of_frame = np.full((frames, FRAME_UNKNOWNS), count)
        own = count - len(chart.mast)
        end = own - FRAME_UNKNOWNS * m
        of_pair[chart.pairs] = np.arange(6 * n, end).reshape(-1, 3)
        of_frame[chart.frames] = np.arange(end, own).reshape(m, FRAME_UNKNOWNS)
        return cls(of_stop, of_pair, of_frame, np.arange(own, count), count)


def tie_rows(network: SolvedNetwork, rows: np.ndarray, columns: Columns) -> np.ndarray:
    """Whitened observation equations of the tie points that some rows see, points eliminated."""
    observations = network.observations
    involved = np.zeros(observations.points, dtype=bool)
    involved[observations.point[rows]] = True
    parts = [np.zeros((0, columns.count + 1))]
    for tie in network.ties:
        mine = np.flatnonzero(involved[observations.point[tie.group.rows[0]]])
        if not len(mine):
            continue
        group = tie.group.of_points(mine)
        at = group.columns(columns.of_stop, columns.of_pair, observations.pair)[:, : group.active]
        own = at[:, group.posed : group.relative]
        # repeated observations have no weight
        own[np.repeat(~group.counts.T, 3, axis=1)] = columns.count
        parts.append(_in_columns(tie.free[mine], at, columns.count))
    return np.concatenate(parts)


def _in_columns(free: np.ndarray, at: np.ndarray, count: int) -> np.ndarray:
    """Rows (n, 3 k, active columns and l) of points, moved to columns `at` of a wider matrix.

    Triangulated where so few columns are active that this saves products: fewer rows hold the same
    information.
    """
    n, rows, _ = free.shape
    active = np.append(distinct(at[at < count]), count)
    narrow = np.zeros((n, rows, len(active)))
    each = np.arange(n)[:, None, None], np.arange(rows)[:, None]
    narrow[*each, np.searchsorted(active, at)[:, None]] = free[:, :, :-1]
    narrow[:, :, -1] = free[:, :, -1]  # over the column of held unknowns
    equations = narrow.reshape(n * rows, -1)
    m, own, all_ = len(equations), len(active), count + 1
    if m * own**2 + own * all_**2 < m * all_**2:
        equations = triangulate(equations)
    wide = np.zeros((len(equations), count + 1))
    wide[:, active] = equations
    return wide


def triangulate(rows: Float64[np.ndarray, "m n"]) -> Float64[np.ndarray, "r n"]:
    """R of rows = Q R, with min(m, n) rows."""
    n = rows.shape[1]
    R = _geqrf(rows, lwork=BLOCK * n)[0]
    return np.triu(R[:n])


def telemetry_rows(network: SolvedNetwork, k: int, columns: Columns) -> np.ndarray:
    """Tilt and measured azimuth of the stop, and the increment from it to the next."""
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
    counts[0, 3:] = False  # marginalised with the stop before
    counts[0, 2] &= link.is_fine[0]
    counts[1:, :2] = False  # remain
    counts[1:, 2] &= ~link.is_fine[1:]
    return dense[counts]


def pointing_rows(network: SolvedNetwork, pairs: np.ndarray, columns: Columns) -> np.ndarray:
    """The mast pointing of some pairs, observed as its systematic part."""
    telemetry = network.telemetry
    dense = np.zeros((3 * len(pairs), columns.count + 1))
    dense[np.arange(3 * len(pairs)), columns.of_pair[pairs].ravel()] = 1.0
    if telemetry.mast_unknowns:
        dense[:, columns.of_mast] = -telemetry.mast[pairs].reshape(len(dense), -1)
    dense[:, -1] = -telemetry.misses(network.state)[pairs].ravel()
    return dense * telemetry.pointing_weight


def control_rows(network: SolvedNetwork, k: int, columns: Columns) -> np.ndarray:
    """Control of the stop in frames whose position stays unknown."""
    control = network.control
    if control is None:
        return np.zeros((0, columns.count + 1))
    l, (of_stop, of_frame) = (
        control.whitened_misclosures(network.state),
        control.partials(network.state),
    )
    mine = np.flatnonzero(control.used & (control.stop == k))
    dense = np.zeros((len(mine), ROWS, columns.count + 1))
    for row, n in enumerate(mine.tolist()):
        frame = control.frame[n]
        free = control.is_free[frame]
        dense[row][:, columns.of_stop[k]] = of_stop[n]
        dense[row][:, columns.of_frame[frame][free]] = of_frame[n][:, free]
    dense[:, :, -1] = l[mine]
    return dense[control.is_given[mine]]


def inherited_rows(inherited: Marginal, state: State, columns: Columns) -> np.ndarray:
    """The earlier marginal, in the columns of the chart."""
    A, l = inherited.rows(state)
    parts = (
        columns.of_stop[inherited.stops],
        columns.of_pair[inherited.pairs],
        columns.of_frame[inherited.frames],
        columns.of_mast[: len(inherited.chart.mast)],
    )
    at = np.concatenate(parts, None)
    dense = np.zeros((len(A), columns.count + 1))
    dense[:, at] = A
    dense[:, -1] = l
    return dense
