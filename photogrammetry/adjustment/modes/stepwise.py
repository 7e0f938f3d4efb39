"""The stepwise adjustment: earlier stops are held, the new stops are estimated.

The mode of the mission (Di et al. 2008, section 3.2): the previous stop is held and the current one
estimated; where ties reach back further, to m-2 or m-3, the earliest stop reached is held and those
after it are estimated again. It is quick and leaves maps of earlier stops unchanged, but the
information of new ties about held stops is lost: use `sequential` where accuracy counts.

Held stops have errors, which a step takes over. With the normal equations of the step over free (f)
and held (h) unknowns, an error e_h moves the estimate by S e_h, so that

    S = -N_ff^-1 N_fh              C_f = N_ff^-1 + S C_hh S'

(consider covariance, Schmidt 1966). Covariances between held stops are not known; the later of two
stops is assumed to move rigidly with the error of the earlier one. Control frames were placed by
stops that are held now, so they share their errors: a frame is assumed to move rigidly with the
error of the last held stop, and the step estimates the rest of its error.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.initial.loops import REACH
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedPair,
    AdjustedStop,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.assembly import merge_networks
from solmap.photogrammetry.adjustment.model.network import ControlFrame, Network
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import cross_matrix
from solmap.photogrammetry.adjustment.modes.overall import adjust, adjust_overall
from solmap.photogrammetry.adjustment.solver.marginalisation import SolvedNetwork
from solmap.photogrammetry.adjustment.solver.normal_equations import normal_equations
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId

LEAST_SHARE = 1e-6
"""Smallest fraction of the variances of a frame's position that is its own."""


def adjust_stepwise(
    previous: AdjustedNetwork | None,
    network: Network,
    new_stops: Iterable[StopId],
    params: AdjustmentParams,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Add new stops to an adjusted traverse with the earlier ones held.

    `network` holds old and new stops; `previous` is the result of earlier steps for the old ones,
    or None at the first stop, which is held at its telemetry pose. The result covers both. The
    pointing of pairs of held stops is estimated again, because new ties determine it too. The
    covariance of the new stops includes the errors taken over from the held ones.
    """
    new = [stop for stop in network.stop_ids if stop in set(new_stops)]
    if previous is None:
        needed = network.within(set(new))
        adjusted, report = adjust_overall(needed, params)
        return _with_past(adjusted), report
    old = {stop.stop for stop in previous.stops}
    if not new or not old:
        raise AdjustmentError(
            "a step along the traverse needs at least one earlier stop and one new stop"
        )
    held, window = _window(network, old, new)
    part = with_frames_as_left(network.within(window), previous, held)
    adjusted, report = adjust(part, held, params, previous, f"step to {new[-1]}")
    adjusted = _with_past(adjusted)
    adjusted = _consider_held(adjusted, previous, part, held, params)
    return merge_networks(previous, adjusted, network), report


def _with_past(adjusted: AdjustedNetwork) -> AdjustedNetwork:
    """Count all observations so far as past, so that later steps count them once."""
    components = adjusted.components
    return replace(adjusted, components=replace(components, past=components.scatter))


def _window(
    network: Network, old: set[StopId], new: list[StopId]
) -> tuple[set[StopId], set[StopId]]:
    """Stops to hold, and all stops to include, when `new` ones are added."""
    order = network.stop_ids
    first_new = order.index(new[0])
    recent = [k for k in range(max(0, first_new - REACH), first_new) if order[k] in old]
    if not recent:
        raise AdjustmentError(
            f"no adjusted stop comes within {REACH} stops before {new[0]}; adjust the traverse in "
            "order, or overall"
        )
    tied = _tied_stops(network, new)
    reached = min((k for k in recent if order[k] in tied), default=recent[-1])
    free = {order[k] for k in recent if k > reached} | set(new)
    near = _tied_stops(network, list(free)) & {order[k] for k in recent}
    held = (near | {order[reached]}) - free
    return held, held | free


def _tied_stops(network: Network, stops: list[StopId]) -> set[StopId]:
    """Stops that see tie points which some of `stops` see too."""
    ties = network.ties
    if not len(ties):
        return set()
    of_pair = {pair.pair_id: pair.stop for pair in network.pairs}
    names = [of_pair[name] for name in ties.pair_ids]
    needed = set(stops)
    inside = np.array([name in needed for name in names], dtype=bool)[ties.pair]
    shared = np.isin(ties.point, np.unique(ties.point[inside]))
    return {names[k] for k in np.unique(ties.pair[shared]).tolist()}


def _consider_held(
    adjusted: AdjustedNetwork,
    previous: AdjustedNetwork,
    part: Network,
    held: AbstractSet[StopId],
    params: AdjustmentParams,
) -> AdjustedNetwork:
    """The adjusted part with the errors of the held stops in all its covariances."""
    datum = {stop.stop: stop for stop in previous.stops if stop.stop in held}
    fixed = [k for k, stop in enumerate(part.stop_ids) if stop in held]
    free = [k for k, stop in enumerate(part.stop_ids) if stop not in held]
    C = _joint_covariance([datum[part.stop_ids[k]] for k in fixed])
    moves = {
        part.stop_ids[k]: np.eye(6 * len(fixed))[6 * i : 6 * i + 6] for i, k in enumerate(fixed)
    }
    pose = datum[part.stop_ids[fixed[-1]]].lsl_from_rover
    along = [frame_partials(frame, pose) for frame in part.frames]
    now = SolvedNetwork.of(adjusted, part, params)
    S = _sensitivity(now, np.array(free), np.array(fixed), along)
    moves.update({part.stop_ids[k]: S[6 * i : 6 * i + 6] for i, k in enumerate(free)})
    taken_over = {stop: move @ C @ move.T for stop, move in moves.items()}
    poses = {stop.stop: stop.lsl_from_rover for stop in adjusted.stops}
    return replace(
        adjusted,
        stops=tuple(
            datum.get(stop.stop, replace(stop, covariance=stop.covariance + taken_over[stop.stop]))
            for stop in adjusted.stops
        ),
        pairs=tuple(
            add_stop_covariance(pair, poses[pair.stop], taken_over[pair.stop])
            for pair in adjusted.pairs
        ),
    )


def _joint_covariance(stops: list[AdjustedStop]) -> np.ndarray:
    """Joint covariance of several held stops, each moved rigidly with the one before."""
    C = np.zeros((6 * len(stops), 6 * len(stops)))
    for i, stop in enumerate(stops):
        here = slice(6 * i, 6 * i + 6)
        own = stop.covariance
        if i:
            T = _rigid_partials(stops[i - 1].lsl_from_rover, stop.lsl_from_rover)
            before = slice(6 * i - 6, 6 * i)
            rest = np.linalg.eigh(own - T @ C[before, before] @ T.T)
            own = T @ C[before, before] @ T.T + (rest[1] * np.maximum(rest[0], 0.0)) @ rest[1].T
            C[: 6 * i, here] = C[: 6 * i, before] @ T.T
            C[here, : 6 * i] = C[: 6 * i, here].T
        C[here, here] = own
    return C


def _sensitivity(
    now: SolvedNetwork, free: np.ndarray, fixed: np.ndarray, frames: list[np.ndarray]
) -> np.ndarray:
    """S of the poses of free stops (6 rows each) to those of held ones (6 columns each)."""
    none = np.zeros_like(now.held)
    problem = Problem.of(now.observations, now.telemetry, none, now.used, control=now.control)
    flat, _, _ = normal_equations(problem, now.state, None)
    unknowns, n = problem.unknowns, problem.unknowns.count
    N = np.zeros((n, n))
    for (s, t), block in problem.pattern.views(flat[: problem.pattern.length]).items():
        i, j = unknowns.offsets[s], unknowns.offsets[t]
        N[i : i + block.shape[0], j : j + block.shape[1]] = block
    poses = unknowns.offsets[: len(now.held), None] + unknowns.stop_columns
    move_frames_along(N, problem, poses[fixed[-1]], frames)
    h = poses[fixed].ravel()
    f = np.setdiff1d(np.arange(n), h)
    S = np.zeros((n, len(h)))
    S[f] = -np.linalg.solve(N[np.ix_(f, f)], N[np.ix_(f, h)])
    return S[poses[free].ravel()]


def _rigid_partials(datum: Pose, pose: Pose) -> np.ndarray:
    """Effect of an error of a pose on another: d(rotation) = d_, d(place) = dc_ + d_ x (c - c_)."""
    T = np.eye(6)
    T[3:, :3] = -cross_matrix(pose.translation_m - datum.translation_m)
    return T


def add_stop_covariance(
    pair: AdjustedPair, lsl_from_rover: Pose, covariance: Float64[np.ndarray, "6 6"]
) -> AdjustedPair:
    """A pair whose covariance includes an uncertainty of its stop, which moves it rigidly."""
    T = _rigid_partials(lsl_from_rover, pair.lsl_from_pair)
    return replace(pair, covariance=pair.covariance + T @ covariance @ T.T)


def with_frames_as_left(
    network: Network, previous: AdjustedNetwork, held: AbstractSet[StopId]
) -> Network:
    """The network with its control frames at the positions of earlier steps.

    The error that a frame shares with the stop held last, by which both were placed, is not a
    relative error; `_sensitivity` takes it over with that of the stop. Control of earlier stops
    that are estimated again serves twice, as their ties do.
    """
    left = {frame.frame.name: frame for frame in previous.frames}
    (datum,) = (stop for stop in previous.stops if stop.stop == _last(network, held))
    frames = []
    for frame in network.frames:
        before = left.get(frame.name)
        if before is None or frame.is_certain:
            frames.append(frame)
            continue
        T = frame_partials(frame, datum.lsl_from_rover)
        free = np.ix_(frame.is_free, frame.is_free)
        values, vectors = np.linalg.eigh((before.covariance - T @ datum.covariance @ T.T)[free])
        own = np.zeros_like(before.covariance)
        least = LEAST_SHARE * np.diagonal(before.covariance[free])
        own[free] = (vectors * np.maximum(values, 0.0)) @ vectors.T + np.diag(least)
        frames.append(replace(frame, place=before.place, covariance=own))
    return replace(network, frames=tuple(frames))


def _last(network: Network, held: AbstractSet[StopId]) -> StopId:
    """The last of the held stops along the traverse."""
    return [stop for stop in network.stop_ids if stop in held][-1]


def move_frames_along(
    N: np.ndarray, problem: Problem, stop: np.ndarray, frames: list[np.ndarray]
) -> None:
    """Move the priors of control frames along with a held stop."""
    if problem.control is None:
        return
    unknowns = problem.unknowns
    for block, columns, W, T in zip(
        unknowns.frame_blocks, unknowns.frame_columns, problem.control.prior, frames, strict=True
    ):
        free = columns >= 0
        own = unknowns.offsets[block] + columns[free]
        cross = -(W.T @ W @ T)[free]
        N[np.ix_(own, stop)] += cross
        N[np.ix_(stop, own)] += cross.T


def frame_partials(frame: ControlFrame, pose: Pose) -> Float64[np.ndarray, "5 6"]:
    """Effect of a motion of a stop (d, dc) on a control frame that moves rigidly with it."""
    east, north = frame.centre_m
    n, e = north - pose.translation_m[0], east - pose.translation_m[1]
    T = np.zeros((5, 6))
    T[0, 4] = T[1, 3] = 1.0
    T[0, 2], T[1, 2] = n, -e
    T[2, 5], T[2, 0], T[2, 1] = -1.0, -e, n
    T[3, 2] = -1.0
    return T
