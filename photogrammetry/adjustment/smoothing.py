"""What later observations say of stops that have left a sequential adjustment.

Each stop that left kept its conditional, own z_s + other z_T = right (`retire`). From the stops of
the window backwards, the last one that left first,

    z_s = own^-1 (right - other z_T)                     G = own^-1 other
    C_sT = -G C_TT,     C_ss = (own' own)^-1 + G C_TT G'

which gives all unknowns and covariances of the simultaneous solution, linearised for every stop
where it left. A stop costs the same however long the traverse; nothing is solved again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedStop
from solmap.photogrammetry.adjustment.model.collinearity import State
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.sequential import Departure, Traverse
from solmap.photogrammetry.adjustment.solver.marginal import Chart
from solmap.photogrammetry.adjustment.solver.marginalisation import Conditional, Linear
from solmap.photogrammetry.adjustment.solver.normal_equations import linearise
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """All unknowns of a traverse as all its observations have them."""

    stops: tuple[AdjustedStop, ...]
    """In the order of the traverse, those that have left first."""
    pointings: dict[str, Vector3]
    """Mast pointing by pair, as in `AdjustedPair.pointing`."""
    pointing_covariances: dict[str, np.ndarray]


def smoothed(traverse: Traverse, network: Network, params: AdjustmentParams) -> Smoothed:
    """All stops since the traverse was last re-opened; `network` is that of the last step."""
    known = [*(d.adjusted for d in traverse.departures), *_staying(traverse)]
    places = _Places.of(traverse, known)
    state = _state(traverse, places, known)
    blocks = {6 * k: stop.covariance for k, stop in enumerate(known)}
    for pair in traverse.window.pairs:
        blocks[places.first(pair.pair_id)] = pair.pointing_covariance
    joint = _Joint(np.zeros(0, dtype=np.int64), np.zeros((0, 0)))
    if traverse.departures:
        joint = _of_window(traverse, network, params, places)
    for departure in reversed(traverse.departures):
        chart = places.chart(departure)
        state = _carried_back(departure.conditional, chart, state)
        joint = _widened(departure.conditional, chart, state, joint, places.columns(chart))
        blocks.update(_own_blocks(departure, places, joint))
    return Smoothed(
        tuple(_moved(stop, state, k, blocks[6 * k]) for k, stop in enumerate(known)),
        {name: state.pointings[k] for name, k in places.pair.items()},
        {name: blocks[places.first(name)] for name in places.pair},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Numbers of all stops, pairs and frames; of their columns, in this order: 6, 3, 5 each."""

    stop: dict[StopId, int]
    pair: dict[str, int]
    frame: dict[str, int]

    @classmethod
    def of(cls, traverse: Traverse, known: list[AdjustedStop]) -> _Places:
        names = [name for departure in traverse.departures for name in departure.own_pairs]
        names += [pair.pair_id for pair in traverse.window.pairs]
        return cls(
            {stop.stop: k for k, stop in enumerate(known)},
            {name: k for k, name in enumerate(dict.fromkeys(names))},
            {frame.frame.name: k for k, frame in enumerate(traverse.window.frames)},
        )

    def first(self, pair_id: str) -> int:
        """First column of a pair's pointing."""
        return 6 * len(self.stop) + 3 * self.pair[pair_id]

    def chart(self, departure: Departure) -> Chart:
        """The chart of a departure, in these numbers."""
        return replace(
            departure.conditional.chart,
            stops=np.array([self.stop[stop] for stop in departure.stops], dtype=np.int32),
            pairs=np.array([self.pair[name] for name in departure.pair_ids], dtype=np.int32),
            frames=np.array([self.frame[name] for name in departure.frames], dtype=np.int32),
        )

    def columns(self, chart: Chart) -> np.ndarray:
        """All columns of a chart."""
        stops = 6 * chart.stops[:, None].astype(np.int64) + np.arange(6)
        pairs = 3 * chart.pairs[:, None].astype(np.int64) + np.arange(3)
        frames = 5 * chart.frames[:, None].astype(np.int64) + np.arange(5)
        first = 6 * len(self.stop)
        last = first + 3 * len(self.pair)
        return np.concatenate([stops.ravel(), first + pairs.ravel(), last + frames.ravel()])


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """Covariance of corrections in the LSL, of some columns of all."""

    at: np.ndarray
    C: np.ndarray

    def of(self, columns: np.ndarray) -> np.ndarray:
        """The part for some of the columns."""
        order = np.argsort(self.at)
        found = order[np.searchsorted(self.at, columns, sorter=order)]
        return self.C[np.ix_(found, found)]


def _staying(traverse: Traverse) -> list[AdjustedStop]:
    stays = set(traverse.staying)
    return [stop for stop in traverse.window.stops if stop.stop in stays]


def _state(traverse: Traverse, places: _Places, known: list[AdjustedStop]) -> State:
    """Stops as last known; the pointings of pairs that have left are yet to be found."""
    pointings = np.zeros((len(places.pair), 3))
    for pair in traverse.window.pairs:
        pointings[places.pair[pair.pair_id]] = pair.pointing
    return State(
        np.array([stop.lsl_from_rover.rotation for stop in known]),
        np.array([stop.lsl_from_rover.translation_m for stop in known]),
        pointings,
        np.zeros((0, 3)),
        np.array([frame.place for frame in traverse.window.frames]).reshape(-1, 5),
    )


def _of_window(
    traverse: Traverse, network: Network, params: AdjustmentParams, places: _Places
) -> _Joint:
    """The joint covariance of the stops of the window that inherit, and of their pairs."""
    last, stays = traverse.window, set(traverse.staying)
    of_pair = {pair.pair_id: pair.stop for pair in last.pairs}
    ties = last.ties.observations
    inside = np.array([of_pair[name] in stays for name in ties.pair_ids], dtype=bool)[ties.pair]
    rows = np.flatnonzero(inside & ~np.isin(ties.point, ties.point[~inside]))
    part = replace(network.within(stays), ties=select(ties, rows))
    now = Linear.of(last, part, params, rows)
    problem = Problem.of(
        now.observations, now.telemetry, now.held, now.used, now.inherited, now.control
    )
    inverse = linearise(problem, now.state, None).factor.inverse()
    C = inverse[problem.inherited_places[0]]
    last_gone = traverse.departures[-1]
    columns = places.columns(places.chart(last_gone))[last_gone.conditional.staying]
    return _Joint(columns, C)


def _carried_back(conditional: Conditional, chart: Chart, state: State) -> State:
    """The state with a stop placed by those that it hangs on."""
    z = chart.coordinates(state)
    right = conditional.right - conditional.other @ z[conditional.staying]
    z[conditional.leaving] = solve_triangular(conditional.own, right)
    return chart.placed(z, state)


def _widened(
    conditional: Conditional, chart: Chart, state: State, joint: _Joint, columns: np.ndarray
) -> _Joint:
    """The covariance of all columns of a chart, from that of the columns that stayed."""
    leaving, staying = conditional.leaving, conditional.staying
    J = chart.partials(state)
    J_T = J[np.ix_(staying, staying)]
    C_TT = J_T @ joint.of(columns[staying]) @ J_T.T
    G = solve_triangular(conditional.own, conditional.other)
    root = solve_triangular(conditional.own, np.eye(len(leaving)))
    C = np.zeros_like(J)
    C[np.ix_(staying, staying)] = C_TT
    C[np.ix_(leaving, staying)] = -G @ C_TT
    C[np.ix_(staying, leaving)] = -C_TT @ G.T
    C[np.ix_(leaving, leaving)] = root @ root.T + G @ C_TT @ G.T
    back = np.linalg.inv(J)
    return _Joint(columns, back @ C @ back.T)


def _own_blocks(departure: Departure, places: _Places, joint: _Joint) -> dict[int, np.ndarray]:
    """Covariances of a stop that has left and of the pointing of its pairs, by first column."""
    stop = 6 * places.stop[departure.adjusted.stop]
    blocks = {places.first(name): 3 for name in departure.own_pairs}
    if stop in joint.at:  # the first stop of all is held
        blocks[stop] = 6
    return {first: joint.of(first + np.arange(size)) for first, size in blocks.items()}


def _moved(stop: AdjustedStop, state: State, k: int, covariance: np.ndarray) -> AdjustedStop:
    pose = Pose(LSL, stop.stop.frame, state.rotations[k], state.centres[k])
    return replace(stop, lsl_from_rover=pose, covariance=(covariance + covariance.T) / 2)
