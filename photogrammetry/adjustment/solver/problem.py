"""A network laid out for the solver: observations, free unknowns, and their indices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import (
    STOP_UNKNOWNS,
    Observations,
    Sights,
)
from solmap.photogrammetry.adjustment.model.control_equations import Control
from solmap.photogrammetry.adjustment.model.network import FRAME_UNKNOWNS
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.solver.block_matrix import BlockPattern
from solmap.photogrammetry.adjustment.solver.layout import TieGroup, Unknowns, tie_groups
from solmap.photogrammetry.adjustment.solver.marginal import Marginal

LINK_TRIANGLE = np.tril_indices(2 * STOP_UNKNOWNS)
"""Lower triangle of the active columns of a telemetry increment: the previous stop and the stop."""
CONTROL_SLOTS = np.repeat([0, 1], [FRAME_UNKNOWNS, STOP_UNKNOWNS])
"""Active columns of control: its frame, and the stop."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A network ready for the solver: observations, free unknowns, and their layout."""

    observations: Observations
    telemetry: Telemetry
    held: np.ndarray
    unknowns: Unknowns
    pattern: BlockPattern
    groups: tuple[TieGroup, ...]
    places: tuple[np.ndarray, ...]
    """Indices in the flat normal matrix of the lower triangle of every group, by signature."""
    right_places: tuple[np.ndarray, ...]
    """Indices in the vector of unknowns of the columns of every group (signatures, columns)."""
    link_places: np.ndarray
    link_right: np.ndarray
    link_weight: np.ndarray
    """Telemetry weights, zero where a row depends on held unknowns only."""
    rows: np.ndarray
    """Observations that belong to a group, by group."""
    sights: Sights
    """The rows of the groups, in their order; repeated ones have zero weight."""
    points: np.ndarray
    """Numbers of the points in the adjustment, by group."""
    bases: np.ndarray
    """Base stop of each of these points."""
    anchors: np.ndarray
    """The pair nearest to each of these points."""
    pointing_places: np.ndarray
    """(pairs, 3) indices of mast pointings on the diagonal of the flat normal matrix."""
    mast_places: np.ndarray
    """(pairs, 3, k) indices of the block of pointings and the k systematic errors of the mast."""
    mast_own: np.ndarray
    """(k, k) indices of the systematic errors of the mast."""
    inherited_places: tuple[np.ndarray, np.ndarray]
    """Indices of the marginal in the flat normal matrix, and in the vector of unknowns."""
    inherited: Marginal | None = None
    """The marginal of earlier observations of these stops."""
    control: Control | None = None
    control_places: np.ndarray | None = None
    """(control, 11, 11) indices in the flat normal matrix, the frame's columns first; empty for
    control that is set aside."""
    frame_places: np.ndarray | None = None
    """(frames, 5, 5) indices of the priors of frames."""

    @classmethod
    def of(
        cls,
        observations: Observations,
        telemetry: Telemetry,
        held: np.ndarray,
        used: np.ndarray,
        inherited: Marginal | None = None,
        control: Control | None = None,
    ) -> Problem:
        """Lay out a network: `held` by stop, `used` by observation."""
        free = control.is_free if control else None
        unknowns = Unknowns.of(
            held,
            observations.pair_stop,
            turning=telemetry.masts_turn,
            frames=free,
            mast=telemetry.mast_unknowns,
        )
        mast = len(unknowns.sizes) - 1
        groups = tie_groups(observations, used, unknowns)
        before = telemetry.before
        cliques: set[tuple[int, ...]] = {
            (int(b), k) for k, b in enumerate(before) if not (held[k] or held[b])
        }
        for group in groups:
            if group.slots[-1]:
                cliques.update(map(tuple, group.stops.tolist()))
        if inherited:
            frames = unknowns.frame_blocks[inherited.frames]
            cliques.add((*inherited.stops.tolist(), *frames.tolist(), mast))
        if control:
            ends = np.column_stack([control.stop, unknowns.frame_blocks[control.frame]])
            cliques.update(map(tuple, ends.tolist()))
        cliques.update((stop, mast) for stop in set(observations.pair_stop.tolist()))
        pattern = BlockPattern.of(unknowns.sizes, cliques)
        places = tuple(pattern.lower(g.stops, g.column_slots, g.local, g.triangle) for g in groups)
        right_places = tuple(
            unknowns.places(g.blocks[:, : g.active], g.local[:, : g.active]) for g in groups
        )
        ends = np.column_stack([before, np.arange(len(before))])
        local = unknowns.stop_columns[ends].reshape(len(ends), -1)
        slots = np.repeat([0, 1], STOP_UNKNOWNS)
        link_places = pattern.lower(ends, slots, local, LINK_TRIANGLE)
        link_right = unknowns.places(ends[:, slots], local)
        weight = telemetry.weight.copy()
        weight[held, :2] = 0.0
        weight[held & (telemetry.is_fine | held[before]), 2] = 0.0
        weight[held & held[before], 3:] = 0.0
        none = np.zeros(0, dtype=np.int64)
        rows = np.concatenate([none, *(g.rows.ravel() for g in groups)])
        counts = np.concatenate([none == 0, *(g.counts.ravel() for g in groups)])
        sights = observations.sights.at(rows).mask(counts)
        first = np.concatenate([none, *(g.rows[0] for g in groups)])
        nearest = np.concatenate([none, *(_nearest(observations, g.rows) for g in groups)])
        return cls(
            observations, telemetry, held, unknowns, pattern, groups, places, right_places,
            link_places, link_right, weight, rows[counts], sights,
            observations.point[first], observations.stop[first], observations.pair[nearest],
            _pointing_places(unknowns, pattern),
            *_mast_places(unknowns, pattern),
            _inherited_places(inherited, unknowns, pattern), inherited,
            control, *_control_places(control, unknowns, pattern),
        )  # fmt: skip

    @property
    def redundancy(self) -> int:
        """Observations minus unknowns."""
        coordinates = int((self.observations.weight[self.rows] > 0).sum())
        pointings = self.unknowns.per_pair * len(self.observations.pair_stop)
        telemetry = int((self.link_weight > 0).sum()) + pointings
        points = 3 * sum(group.points for group in self.groups)
        known = self.inherited.surplus if self.inherited else 0
        known += self.control.surplus if self.control else 0
        frames = int((self.unknowns.frame_columns >= 0).sum())  # each has a prior
        known += self.unknowns.mast  # with priors, as frames have
        return coordinates + telemetry + known + frames - points - self.unknowns.count


def _nearest(observations: Observations, rows: np.ndarray) -> np.ndarray:
    """For each of n points with rows (k, n), the row with the largest parallax."""
    parallax = observations.measured[rows, 2]
    return rows[len(rows) - 1 - parallax[::-1].argmax(axis=0), np.arange(rows.shape[1])]


def _pointing_places(unknowns: Unknowns, pattern: BlockPattern) -> np.ndarray:
    stop = unknowns.pair_stop
    per_row = unknowns.sizes[stop][:, None] + 1
    return pattern.start(stop, stop)[:, None] + unknowns.pair_columns * per_row


def _mast_places(unknowns: Unknowns, pattern: BlockPattern) -> tuple[np.ndarray, np.ndarray]:
    """Lower triangle: rows are systematic errors, columns pointings."""
    block, errors = np.array([len(unknowns.sizes) - 1]), np.arange(unknowns.mast)
    stop = unknowns.pair_stop
    row = pattern.start(block, stop)[:, None] + errors * unknowns.sizes[stop][:, None]
    places = row[:, None, :] + unknowns.pair_columns[:, :, None]
    return places, pattern.own(block, errors[None])[0]


def _inherited_places(
    inherited: Marginal | None, unknowns: Unknowns, pattern: BlockPattern
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the normal equations of the marginal."""
    if inherited is None:
        return np.zeros((0, 0), dtype=np.int64), np.zeros(0, dtype=np.int64)
    stops, pairs, frames = inherited.stops, inherited.pairs, inherited.frames
    errors = np.arange(len(inherited.chart.mast))
    blocks = np.concatenate(
        [
            np.repeat(stops, STOP_UNKNOWNS),
            np.repeat(unknowns.pair_stop[pairs], 3),
            np.repeat(unknowns.frame_blocks[frames], FRAME_UNKNOWNS),
            np.full(len(errors), len(unknowns.sizes) - 1),
        ]
    )
    local = np.concatenate(
        [
            unknowns.stop_columns[stops].ravel(),
            unknowns.pair_columns[pairs].ravel(),
            unknowns.frame_columns[frames].ravel(),
            errors,
        ]
    )
    return pattern.indices(blocks[None], local[None])[0], unknowns.places(blocks, local)


def _control_places(
    control: Control | None, unknowns: Unknowns, pattern: BlockPattern
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Indices of the normal equations of control, and of the frames' own positions."""
    if control is None:
        return None, None
    ends = np.column_stack([unknowns.frame_blocks[control.frame], control.stop]).astype(np.int64)
    local = np.hstack([unknowns.frame_columns[control.frame], unknowns.stop_columns[control.stop]])
    return (
        pattern.indices(ends[:, CONTROL_SLOTS], local),
        pattern.own(unknowns.frame_blocks, unknowns.frame_columns),
    )
