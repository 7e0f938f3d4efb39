"""Find what the images do not determine, before solving, and state it for each stop.

Telemetry is a weighted observation, so the normal equations of a network are never singular; but
where ties are too few or badly placed a pose depends on telemetry, and the report must state it.
Stops are taken in the order of the traverse, those first that ties join to stops already placed.
With the normal matrix N of the rigid alignment of the stop on those, and D the standard deviations
of its rotation and position by telemetry,

    rank = number of eigenvalues of D N D above one

is the number of unknowns, of six, that images determine better than telemetry: 0 without ties, 3
with one, 5 with ties on a line. Where a stop has a single tie, no other observation can show
whether the tie is wrong; it is set aside, and the pose remains at telemetry.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.initial.alignment import RigidPoints
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustmentReport,
    Finding,
    Lack,
)
from solmap.photogrammetry.adjustment.model.assembly import merge_ties
from solmap.photogrammetry.adjustment.model.collinearity import Observations, State
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.sightings import Couple, Overview
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.imagery import StopId

FULL = 6
MANY = 12
"""Number of ties whose spread across their line shows that the rotation about it is determined."""
MOSTLY = 0.5
SAME_M, SAME_RAD = 1e-3, 1e-4
"""Telemetry is rounded to a millimetre; two stops closer than that are the same."""

Rows = tuple[np.ndarray, np.ndarray]


Result = tuple[AdjustedNetwork, AdjustmentReport]
IN_HELD_BY = {Lack.NO_TIES, Lack.DETACHED}
"""Beginning of every value of `AdjustedStop.held_by`."""


@dataclass(frozen=True, slots=True, eq=False)
class Initial:
    """A network after the alignment."""

    names: tuple[StopId, ...]
    observations: Observations
    telemetry: Telemetry
    overview: Overview
    state: State
    fits: np.ndarray
    """Which observations agree with the alignment."""
    placed: np.ndarray
    """Stops that are held fixed, or that earlier observations join to the datum."""
    controlled: frozenset[int] = frozenset()
    """Stops whose position in an orbital image is known."""

    def holder(self, stops: AbstractSet[int]) -> str:
        """Observations that determine stops without ties to the datum, as text."""
        return "control and telemetry hold" if stops & self.controlled else "telemetry holds"


def diagnose(network: Initial) -> tuple[tuple[Finding, ...], np.ndarray]:
    """Undetermined unknowns of stops, and the rows of ties that no other observation checks."""
    couples = network.overview.couples
    fitting = _by_stop(_fitting(couples, network.fits))
    expected = _by_stop(couples)
    findings: list[Finding] = []
    unchecked = [np.zeros(0, dtype=np.int64)]
    placed = set(np.flatnonzero(network.placed).tolist())
    waiting = [k for k in range(len(network.names)) if k not in placed]
    while waiting:
        k = next((k for k in waiting if any(o in placed for o in fitting.get(k, {}))), None)
        if k is None:
            found, block = _detached_block(network, waiting, fitting, expected)
            findings += found
        else:
            block = {k}
            rows = [rows for o, rows in fitting[k].items() if o in placed]
            ours, theirs = (np.concatenate(part) for part in zip(*rows, strict=True))
            found, alone = _weak(network, k, ours, theirs)
            findings += found
            unchecked.append(alone)
        placed |= block
        waiting = [k for k in waiting if k not in block]
    return (*findings, *_same_places(network)), np.concatenate(unchecked)


def _fitting(couples: dict[Couple, Rows], fits: np.ndarray) -> dict[Couple, Rows]:
    """The ties of which both sightings agree with the alignment."""
    kept = {}
    for couple, (a, b) in couples.items():
        good = fits[a] & fits[b]
        if good.any():
            kept[couple] = (a[good], b[good])
    return kept


def _by_stop(couples: dict[Couple, Rows]) -> dict[int, dict[int, Rows]]:
    """For each stop the stops it shares points with, and the rows: its own, then theirs."""
    near: dict[int, dict[int, Rows]] = {}
    for (a, b), (rows_a, rows_b) in couples.items():
        near.setdefault(a, {})[b] = (rows_a, rows_b)
        near.setdefault(b, {})[a] = (rows_b, rows_a)
    return near


def _weak(
    network: Initial, k: int, ours: np.ndarray, theirs: np.ndarray
) -> tuple[list[Finding], np.ndarray]:
    """Unknowns that ties with earlier stops do not determine, and the row of a single tie."""
    name = network.names[k]
    count = len(np.unique(network.observations.point[ours]))
    if count == 1 and not _is_tied_otherwise(network, k, ours):
        text = "one tie, which nothing checks, is set aside: telemetry holds it"
        return [Finding(name, Lack.ONE_TIE, 1, 0, text)], ours
    if count >= MANY and _is_spread(network, k, ours):
        return [], ours[:0]
    values, vectors = _known_better(network, k, ours, theirs)
    rank = int((values > 1.0).sum())
    if rank == FULL:
        return [], ours[:0]
    is_turn = (vectors[:3, 0] ** 2).sum() > MOSTLY  # what is known worst is a turn
    lack = Lack.LINE if is_turn else Lack.PARTLY
    what = "the turn about their line" if is_turn else "some freedom"
    text = f"{count} ties leave {what} to telemetry, which determines {FULL - rank} of six better"
    return [Finding(name, lack, count, rank, text)], ours[:0]


def _is_tied_otherwise(network: Initial, k: int, ours: np.ndarray) -> bool:
    """Whether a stop shares points that cannot align it: far ones, or seen in one image only."""
    observations = network.observations
    rows = network.fits & ~np.isin(observations.point, observations.point[ours])
    mine = rows & (observations.stop == k)
    return bool(np.isin(observations.point[rows & ~mine], observations.point[mine]).any())


def _known_better(
    network: Initial, k: int, ours: np.ndarray, theirs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (ascending) and eigenvectors of the normals in units of telemetry's sigmas."""
    state, overview = network.state, network.overview
    points = RigidPoints(*overview.in_lsl(state, theirs), *overview.in_rover(ours))
    N, _ = points.misfit(state.rotations[k], state.centres[k]).normals(np.ones(len(ours)))
    sigma = _telemetry_sigmas(network.telemetry, k)
    return np.linalg.eigh(N * np.outer(sigma, sigma))


def _telemetry_sigmas(telemetry: Telemetry, k: int) -> np.ndarray:
    """Standard deviations of a stop by telemetry alone: two of tilt, azimuth, three of position."""
    weight = telemetry.weight[k]
    return 1.0 / np.where(weight > 0, weight, telemetry.weight[telemetry.weight > 0].min())


def _is_spread(network: Initial, k: int, ours: np.ndarray) -> bool:
    """Whether the points spread so far off their line that the rotation about it is determined."""
    points = network.overview.places_in_rover(ours)
    off = points - points.mean(axis=0)
    spread = np.linalg.eigvalsh(off.T @ off)
    sigma = np.sqrt(np.median(network.overview.seen.size[ours]))
    return bool(sigma / np.sqrt(max(spread[1], 1e-12)) < 0.5 / network.telemetry.weight[k, 0])


def _detached_block(
    network: Initial,
    waiting: list[int],
    fitting: dict[int, dict[int, Rows]],
    expected: dict[int, dict[int, Rows]],
) -> tuple[list[Finding], set[int]]:
    """The first stop that no tie joins to those placed, with all that ties join to it."""
    block, front = {waiting[0]}, [waiting[0]]
    while front:
        more = set(fitting.get(front.pop(), {})) - block
        block |= more
        front += sorted(more)
    if len(block) > 1:
        names = ", ".join(str(network.names[k]) for k in sorted(block)[:3])
        text = (
            f"a block of {len(block)} stops ({names}) that no tie joins to the datum: "
            f"{network.holder(block)} it"
        )
        return [Finding(network.names[k], Lack.DETACHED, 0, 0, text) for k in sorted(block)], block
    k = waiting[0]
    lost = sum(len(rows) for rows, _ in expected.get(k, {}).values())
    if lost:
        text = (
            f"none of its {lost} ties agrees with telemetry or the others: {network.holder({k})} it"
        )
        return [Finding(network.names[k], Lack.BLUNDERS, 0, 0, text)], block
    text = f"no ties: {network.holder({k})} it"
    return [Finding(network.names[k], Lack.NO_TIES, 0, 0, text)], block


def _same_places(network: Initial) -> list[Finding]:
    """Stops that telemetry reports at the same pose as the stop before."""
    telemetry = network.telemetry
    moved = np.linalg.norm(np.diff(telemetry.centres, axis=0), axis=1)
    turned = np.abs(np.diff(telemetry.rotations, axis=0)).max(axis=(1, 2), initial=0.0)
    return [
        Finding(network.names[k + 1], Lack.SAME_PLACE, 0, 0,
                f"reported exactly where {network.names[k]} stood: one stop under two names?")
        for k in np.flatnonzero((moved < SAME_M) & (turned < SAME_RAD)).tolist()
    ]  # fmt: skip


def with_findings(result: Result, findings: tuple[Finding, ...]) -> Result:
    """The adjustment with the diagnosis written into its stops and its report."""
    adjusted, report = result
    texts = {finding.stop: finding.text for finding in findings if finding.lack not in IN_HELD_BY}
    stops = tuple(
        replace(stop, held_by=f"{stop.held_by}; {texts[stop.stop]}")
        if texts.get(stop.stop, stop.held_by) not in stop.held_by
        else stop
        for stop in adjusted.stops
    )
    return replace(adjusted, stops=stops), replace(report, findings=findings)


def without_unchecked(network: Network, observations: Observations, rows: np.ndarray) -> Network:
    """The network without some ties: their stops lose all observations of their points."""
    lost = np.zeros(len(observations), dtype=bool)
    for row in rows.tolist():
        same = observations.point == observations.point[row]
        lost |= same & (observations.stop == observations.stop[row])
    return replace(network, ties=select(network.ties, ~lost))


def complete(result: Result, network: Network, findings: tuple[Finding, ...]) -> Result:
    """The adjustment of a subset of the ties, with the others added as unused and the diagnosis."""
    adjusted, report = result
    whole = replace(adjusted, ties=merge_ties(network.ties, (adjusted.ties,)))
    return with_findings((whole, report), findings)
