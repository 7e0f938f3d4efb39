"""Sums of squared residuals and of redundancy numbers, by variance component.

Residuals v of telemetry and of mast pointing are whitened misclosures; with their derivatives A and
the cofactors Z of the unknowns their redundancy numbers are 1 - (A Z A')_ii. One large slip or one
wrong label must not enlarge all standard deviations: a residual is limited to `GROSS` of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import Observations
from solmap.photogrammetry.adjustment.model.network import Network
from solmap.photogrammetry.adjustment.model.telemetry import (
    telemetry_misclosures,
    telemetry_partials,
)
from solmap.photogrammetry.adjustment.model.variance_components import (
    COMPONENTS,
    TIES,
    Component,
    Scatter,
    VarianceComponents,
)
from solmap.photogrammetry.adjustment.solver.elimination import symmetric
from solmap.photogrammetry.adjustment.solver.estimate import Outcome
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.arrays import Bool

GROSS = 3.0
"""Largest contribution of a single residual of telemetry, in standard deviations."""


def weigh(network: Network, components: VarianceComponents) -> Observations:
    """The observations of a network, with the estimated standard deviations of ties."""
    observations = Observations.of(network)
    factors = components.of_ties(observations.kind)
    return replace(observations, weight=observations.weight / factors[:, None])


def scatter_of(
    outcome: Outcome, components: VarianceComponents, counted: Bool[np.ndarray, " stops"]
) -> Scatter:
    """The scatter of all observations that depend on any of some stops."""
    found, problem = Scatter(), outcome.problem
    observations, residuals = problem.observations, outcome.residuals
    seen = np.zeros(observations.points, dtype=bool)
    seen[observations.point[counted[observations.stop]]] = True
    rows = problem.rows[seen[observations.point[problem.rows]]]
    r, kind = residuals.redundancy[rows], TIES + observations.kind[rows]
    squares = np.nan_to_num(residuals.standardised[rows]) ** 2 * r
    for c in range(3):
        found.squares[:, c] = np.bincount(kind, squares[:, c], len(COMPONENTS))
        found.redundancy[:, c] = np.bincount(kind, r[:, c], len(COMPONENTS))
    for component, v, q in (
        *_of_telemetry(problem, outcome, counted),
        *_of_pointing(problem, outcome, counted),
    ):
        number, free = COMPONENTS.index(component), np.clip(q, 0.0, 1.0)
        found.squares[number, 0] = np.minimum(v**2, GROSS**2 * free).sum()
        found.redundancy[number, 0] = free.sum()
    return Scatter(found.squares * components.factors[:, None] ** 2, found.redundancy)


def _of_telemetry(
    problem: Problem, outcome: Outcome, counted: np.ndarray
) -> list[tuple[Component, np.ndarray, np.ndarray]]:
    """Residuals and redundancy numbers of tilts, headings and increments."""
    state, telemetry, weight = outcome.solution.state, problem.telemetry, problem.link_weight
    v = telemetry_misclosures(state, telemetry) * weight
    A = telemetry_partials(state, telemetry) * weight[:, :, None]
    Z = symmetric(outcome.inverse[problem.link_places], A.shape[2])
    q = 1.0 - np.einsum("sij,sjk,sik->si", A, Z, A, optimize=True)
    own, step = (weight > 0) & counted[:, None], counted | counted[telemetry.before]
    fine = telemetry.is_fine
    return [
        (component, v[:, part][rows], q[:, part][rows])
        for component, part, rows in (
            (Component.TILT, slice(0, 2), own[:, :2]),
            (Component.HEADING, slice(2, 3), own[:, 2:3] & fine[:, None]),
            (
                Component.HEADING_STEP,
                slice(2, 3),
                (weight[:, 2:3] > 0) & (step & ~fine)[:, None],
            ),
            (Component.POSITION, slice(3, 6), (weight[:, 3:] > 0) & step[:, None]),
        )
    ]


def _of_pointing(
    problem: Problem, outcome: Outcome, counted: np.ndarray
) -> list[tuple[Component, np.ndarray, np.ndarray]]:
    """Residuals and redundancy numbers of mast pointings, and of errors that all of them share."""
    if not problem.telemetry.masts_turn:
        return []
    mine, w = counted[problem.unknowns.pair_stop], problem.telemetry.pointing_weight
    v = problem.telemetry.misses(outcome.solution.state)[mine] * w
    q = 1.0 - w**2 * outcome.inverse[problem.pointing_places[mine]]
    shared: list[tuple[Component, np.ndarray, np.ndarray]] = []
    if problem.unknowns.mast:
        B, Z = problem.telemetry.mast[mine], outcome.inverse[problem.mast_own]
        both = 2 * outcome.inverse[problem.mast_places[mine]] - B @ Z
        q += w**2 * (B * both).sum(axis=2)
        prior = problem.telemetry.mast_weight
        own = 1.0 - prior**2 * np.diagonal(Z)
        shared = [(Component.MAST, prior * outcome.solution.state.mast, own)]
    return [(Component.POINTING, v.ravel(), q.ravel()), *shared]
