"""Loop closure: correct the drift where a traverse returns to ground that it saw long before.

Errors accumulate from stop to stop along a traverse. Where it returns to earlier ground, its error
may be tens of metres and degrees, and image rays do not intersect at all. The pose graph has a node
for every stop and an edge for every two stops that see the same ground: a rigid motion (R, t), the
pose of stop b in the frame of stop a, with its information matrix N from the tie points,

    r = (Log(R_a'R_b R'), R_a'(c_b - c_a) - t)             minimise sum_edges r'N r + telemetry

Consecutive stops keep the relative motion of the alignment (`values`), with the information of the
ties that fit it, so that only the loops change it. For two stops further apart, the rigid motion of
their ties is found without an initial value. Ties too few to check each other close no loop: they
are set aside, and used again if they fit the adjusted network. A loop that contradicts the others
is down-weighted by the truncated least-squares loss of `alignment`, with r'N r in place of the
squared misfit of a tie.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from solmap.photogrammetry.adjustment.initial.alignment import (
    GROSS,
    HALF,
    ROUNDS,
    RigidPoints,
    TruncatedLoss,
    rigid_motion,
)
from solmap.photogrammetry.adjustment.model.collinearity import State
from solmap.photogrammetry.adjustment.model.sightings import Couple, Overview
from solmap.photogrammetry.adjustment.model.small_matrices import (
    cross_matrix,
    inverse_left_jacobian,
    move_along_arcs,
    rotation_of_vector,
)
from solmap.photogrammetry.adjustment.model.telemetry import (
    Telemetry,
    telemetry_misclosures,
    telemetry_partials,
)
from solmap.photogrammetry.arrays import Bool, Float64

REACH = 3
"""Ties to this many earlier stops (m-2, m-3) count as ties of neighbours; ties further back close
loops."""
LOOP_TIES = 5
"""Fewest ties of a loop: three determine the pose, two more are unlikely to agree by chance."""


GATE = float(np.sqrt(chdtri(6, 0.001)))
"""Misfit above which a loop is wrong: 99.9 % of the chi distribution, six degrees of freedom."""
STEPS = 20
"""Gauss-Newton steps of the graph for each sharpness of the loss."""
HALVINGS = 8
TOLERANCE = 1e-6
"""Squared length of a step, as a fraction of the cost, at which the iteration ends."""


def close_loops(
    state: State,
    telemetry: Telemetry,
    held: np.ndarray,
    overview: Overview,
) -> tuple[State, np.ndarray]:
    """The state with its loops closed, and the observations that contradict it."""
    couples = overview.couples
    if not any(b - a > REACH for a, b in couples):
        return state, np.zeros(0, dtype=np.int64)
    found: list[tuple[int, int, np.ndarray, np.ndarray, np.ndarray]] = []
    loops: dict[int, np.ndarray] = {}
    contradicting = []
    for (a, b), (theirs, ours) in couples.items():
        points = RigidPoints(*overview.in_rover(theirs), *overview.in_rover(ours))
        if b - a <= REACH:
            found.append((a, b, *_as_aligned(state, a, b, points)))
        elif len(ours) >= LOOP_TIES:
            rotation, place, information, weights = rigid_motion(points, GROSS)
            right = weights > HALF
            contradicting.append(ours[~right])
            if right.sum() >= LOOP_TIES:
                loops[len(found)] = ours[right]
                found.append((a, b, rotation, place, information))
            else:
                contradicting.append(ours[right])
        else:
            contradicting.append(ours)
    if loops:
        edges = _edges(found, np.array(list(loops)))
        state, weights = relax(state, telemetry, held, edges)
        contradicting += [rows for k, rows in loops.items() if weights[k] <= HALF]
    return state, _only_of_loops(np.concatenate(contradicting), couples)


def _as_aligned(
    state: State, a: int, b: int, points: RigidPoints
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The relative motion of two stops, and its information from the ties that fit it."""
    R = state.rotations[a].T @ state.rotations[b]
    t = state.rotations[a].T @ (state.centres[b] - state.centres[a])
    misfit = points.misfit(R, t)
    fits = misfit.standardised <= GROSS
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
    """The rows whose stop has no tie with a neighbour."""
    near = [np.concatenate(both) for (a, b), both in couples.items() if b - a <= REACH]
    tied = np.unique(np.concatenate([*near, np.zeros(0, dtype=np.int64)]))
    return np.setdiff1d(rows, tied)


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Relative motions of pairs of stops: stop b in the frame of stop a."""

    a: np.ndarray
    b: np.ndarray
    rotation: Float64[np.ndarray, "edges 3 3"]
    translation: Float64[np.ndarray, "edges 3"]
    information: Float64[np.ndarray, "edges 6 6"]
    is_loop: Bool[np.ndarray, " edges"]

    @property
    def root(self) -> Float64[np.ndarray, "edges 6 6"]:
        """W with W'W = N; directions without information stay so."""
        values, vectors = np.linalg.eigh(self.information)
        return np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.swapaxes(1, 2)

    def misfit(self, state: State) -> Float64[np.ndarray, "edges 6"]:
        """The residual r of every edge."""
        to_a = state.rotations[self.a].swapaxes(1, 2)
        turn = to_a @ state.rotations[self.b] @ self.rotation.swapaxes(1, 2)
        apart = state.centres[self.b] - state.centres[self.a]
        place = (to_a @ apart[:, :, None])[:, :, 0] - self.translation
        return np.concatenate([Rotation.from_matrix(turn).as_rotvec(), place], axis=1)

    def partials(self, state: State) -> Float64[np.ndarray, "edges 6 12"]:
        """Derivatives of the residual by (d, dc) of a and (d, dc) of b."""
        to_a = state.rotations[self.a].swapaxes(1, 2)
        turn = inverse_left_jacobian(self.misfit(state)[:, :3]) @ to_a
        A = np.zeros((len(self.a), 6, 12))
        A[:, :3, 0:3], A[:, :3, 6:9] = -turn, turn
        A[:, 3:, 0:3] = to_a @ cross_matrix(state.centres[self.b] - state.centres[self.a])
        A[:, 3:, 3:6], A[:, 3:, 9:12] = -to_a, to_a
        return A


def relax(
    state: State, telemetry: Telemetry, held: np.ndarray, edges: Edges
) -> tuple[State, np.ndarray]:
    """The state with its stops moved to fit edges and telemetry; weight (0..1) of each edge."""
    loops, root = edges.is_loop, edges.root
    weights = np.ones(len(loops))
    loss = TruncatedLoss(weights[loops])
    for _ in range(ROUNDS):
        state = _solve(state, telemetry, held, edges, root * np.sqrt(weights)[:, None, None])
        r = np.linalg.norm((root @ edges.misfit(state)[:, :, None])[:, :, 0], axis=1)[loops]
        loss = loss.sharpen(r, GATE)
        weights[loops] = loss.weights
        if loss.is_settled:
            break
    return state, weights


def _solve(
    state: State, telemetry: Telemetry, held: np.ndarray, edges: Edges, root: np.ndarray
) -> State:
    """Gauss-Newton along arcs; each step is halved until it does not raise the cost."""
    cost = _cost(state, telemetry, edges, root)
    for _ in range(STEPS):
        x, length2 = _step(state, telemetry, held, edges, root)
        for halvings in range(HALVINGS):
            part = x * 0.5**halvings
            centres = move_along_arcs(state.centres, part[:, :3], part[:, 3:], held)
            turned = rotation_of_vector(part[:, :3]) @ state.rotations
            trial = replace(state, rotations=turned, centres=centres)
            trial_cost = _cost(trial, telemetry, edges, root)
            if trial_cost <= cost:
                state, cost = trial, trial_cost
                break
        if length2 < TOLERANCE * (1.0 + cost):
            break
    return state


def _cost(state: State, telemetry: Telemetry, edges: Edges, root: np.ndarray) -> float:
    off = (root @ edges.misfit(state)[:, :, None])[:, :, 0]
    telemetry_residuals = telemetry_misclosures(state, telemetry) * telemetry.weight
    return float((off**2).sum() + (telemetry_residuals**2).sum())


def _step(
    state: State, telemetry: Telemetry, held: np.ndarray, edges: Edges, root: np.ndarray
) -> tuple[np.ndarray, float]:
    """Corrections (stops, 6), zero where held, and their squared length in their own sigmas."""
    place = np.cumsum(~held) - 1
    place[held] = (~held).sum()  # a bin
    before = telemetry.before
    stops = np.arange(len(held))
    parts = (
        (root @ edges.partials(state), -(root @ edges.misfit(state)[:, :, None])[:, :, 0],
         np.column_stack([edges.a, edges.b])),
        (telemetry_partials(state, telemetry) * telemetry.weight[:, :, None],
         telemetry_misclosures(state, telemetry) * telemetry.weight,
         np.column_stack([before, stops])),
    )  # fmt: skip
    size = 6 * int(place.max(initial=0)) + 6
    N, n = csc_matrix((size, size)), np.zeros(size)
    for A, l, ends in parts:
        at = (6 * place[ends][:, :, None] + np.arange(6)).reshape(len(ends), 12)
        rows, columns = np.repeat(at, 12, axis=1), np.tile(at, (1, 12))
        N += csc_matrix(
            ((A.swapaxes(1, 2) @ A).ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)
        )
        np.add.at(n, at.ravel(), (l[:, None, :] @ A).ravel())
    free = 6 * int((~held).sum())
    x = splu(N[:free, :free].tocsc()).solve(n[:free])
    full = np.zeros((len(held), 6))
    full[~held] = x.reshape(-1, 6)
    return full, float(x @ n[:free])
