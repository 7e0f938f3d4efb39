"""Where a traverse meets ground that it saw long ago: the loops of the graph of stops.

The edges of `pose_graph` are found from tie points: stops that follow each other keep the motion
that the alignment gave them, with the information of the ties that fit it; two stops further apart
get the rigid motion of their ties, found without any initial value. So few ties that nothing checks
them make no loop; they are set aside and come back when they fit the adjusted network.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.adjustment.alignment import HALF, RigidPoints, rigid_motion
from solmap.photogrammetry.adjustment.collinearity import State
from solmap.photogrammetry.adjustment.params import AdjustmentParams
from solmap.photogrammetry.adjustment.pose_graph import Edges, relaxed
from solmap.photogrammetry.adjustment.priors import Telemetry
from solmap.photogrammetry.adjustment.sightings import Couple, Overview

REACH = 3
"""Stops back to which ties of neighbours reach (m-2, m-3); beyond, they close loops."""
LOOP_TIES = 5
"""Ties that make a loop: three place a stop, and two more agree with them by no chance."""


def closed_loops(
    state: State,
    telemetry: Telemetry,
    held: np.ndarray,
    overview: Overview,
    params: AdjustmentParams,
) -> tuple[State, np.ndarray]:
    """The state with its loops closed, and the observations that contradict it."""
    couples = overview.couples
    if not any(b - a > REACH for a, b in couples):
        return state, np.zeros(0, dtype=np.int64)
    found: list[tuple[int, int, np.ndarray, np.ndarray, np.ndarray]] = []
    loops: dict[int, np.ndarray] = {}
    astray = []
    for (a, b), (theirs, ours) in couples.items():
        points = RigidPoints(*overview.in_rover(theirs), *overview.in_rover(ours))
        if b - a <= REACH:
            found.append((a, b, *_as_aligned(state, a, b, points, params)))
        elif len(ours) >= LOOP_TIES:
            rotation, place, information, weights = rigid_motion(points, params.gross)
            right = weights > HALF
            astray.append(ours[~right])
            if right.sum() >= LOOP_TIES:
                loops[len(found)] = ours[right]
                found.append((a, b, rotation, place, information))
            else:
                astray.append(ours[right])
        else:
            astray.append(ours)
    if loops:
        edges = _edges(found, np.array(list(loops)))
        state, weights = relaxed(state, telemetry, held, edges)
        astray += [rows for k, rows in loops.items() if weights[k] <= HALF]
    return state, _only_of_loops(np.concatenate(astray), couples)


def _as_aligned(
    state: State, a: int, b: int, points: RigidPoints, params: AdjustmentParams
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The motion that two stops have, and what the ties that fit it know of it."""
    R = state.rotations[a].T @ state.rotations[b]
    t = state.rotations[a].T @ (state.centres[b] - state.centres[a])
    misfit = points.misfit(R, t)
    fits = misfit.standardised <= params.gross
    return R, t, misfit.normals(fits.astype(float))[0]


def _edges(
    found: list[tuple[int, int, np.ndarray, np.ndarray, np.ndarray]], loops: np.ndarray
) -> Edges:
    a, b, rotations, translations, informations = zip(*found, strict=True)
    is_loop = np.zeros(len(found), dtype=bool)
    is_loop[loops] = True
    return Edges(
        np.array(a),
        np.array(b),
        np.array(rotations),
        np.array(translations),
        np.array(informations),
        is_loop,
    )


def _only_of_loops(
    rows: np.ndarray,
    couples: dict[Couple, tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Those of some rows that tie their stop to no neighbour as well."""
    near = [np.concatenate(both) for (a, b), both in couples.items() if b - a <= REACH]
    tied = np.unique(np.concatenate([*near, np.zeros(0, dtype=np.int64)]))
    return np.setdiff1d(rows, tied)
