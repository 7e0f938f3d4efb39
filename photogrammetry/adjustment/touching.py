"""The whitened observation equations that touch a stop, in the columns of a chart.

A x = l for corrections in the LSL, one row an observation, l in the last column. Where a stop is
held its columns fall onto the last one too and are overwritten there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from solmap.photogrammetry.adjustment.collinearity import State
from solmap.photogrammetry.adjustment.control import FRAME_UNKNOWNS
from solmap.photogrammetry.adjustment.control_equations import ROWS
from solmap.photogrammetry.adjustment.linear import Linear
from solmap.photogrammetry.adjustment.marginal import Chart, Marginal
from solmap.photogrammetry.adjustment.observations import numbers
from solmap.photogrammetry.adjustment.priors import telemetry_misclosures, telemetry_partials
from solmap.photogrammetry.arrays import Float64

_geqrf = get_lapack_funcs("geqrf", dtype=np.float64)
BLOCK = 32
"""Columns that are triangulated together."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of a chart by number of stop, pair, frame; the last one is for what is held."""

    of_stop: np.ndarray
    of_pair: np.ndarray
    of_frame: np.ndarray
    count: int

    @classmethod
    def of(cls, chart: Chart, stops: int, pairs: int, frames: int = 0) -> Columns:
        """Of a chart in a network with so many stops, pairs and control frames."""
        count, n, m = chart.size, len(chart.stops), len(chart.frames)
        of_stop, of_pair = np.full((stops, 6), count), np.full((pairs, 3), count)
        of_stop[chart.stops] = np.arange(6 * n).reshape(n, 6)
        of_frame = np.full((frames, FRAME_UNKNOWNS), count)
        end = count - FRAME_UNKNOWNS * m
        of_pair[chart.pairs] = np.arange(6 * n, end).reshape(-1, 3)
        of_frame[chart.frames] = np.arange(end, count).reshape(m, FRAME_UNKNOWNS)
        return cls(of_stop, of_pair, of_frame, count)


def tie_rows(network: Linear, rows: np.ndarray, columns: Columns) -> np.ndarray:
    """Whitened observation equations of the tie points that some rows see, freed of the points."""
    observations = network.observations
    touched = np.zeros(observations.points, dtype=bool)
    touched[observations.point[rows]] = True
    parts = [np.zeros((0, columns.count + 1))]
    for tie in network.ties:
        mine = np.flatnonzero(touched[observations.point[tie.group.rows[0]]])
        if not len(mine):
            continue
        group = tie.group.of_points(mine)
        at = group.columns(columns.of_stop, columns.of_pair, observations.pair)[:, : group.felt]
        own = at[:, group.posed : group.relative]
        own[np.repeat(~group.counts.T, 3, axis=1)] = columns.count  # what repeats has none
        parts.append(_in_columns(tie.free[mine], at, columns.count))
    return np.concatenate(parts)


def _in_columns(free: np.ndarray, at: np.ndarray, count: int) -> np.ndarray:
    """Rows (n, 3 k, felt columns and l) of points whose columns belong `at` others of so many.

    Triangulated where they touch so few columns that this saves products: fewer rows say the same.
    """
    n, rows, _ = free.shape
    touched = np.append(numbers(at[at < count]), count)
    narrow = np.zeros((n, rows, len(touched)))
    each = np.arange(n)[:, None, None], np.arange(rows)[:, None]
    narrow[*each, np.searchsorted(touched, at)[:, None]] = free[:, :, :-1]
    narrow[:, :, -1] = free[:, :, -1]  # over the bin of what is held
    equations = narrow.reshape(n * rows, -1)
    m, own, all_ = len(equations), len(touched), count + 1
    if m * own**2 + own * all_**2 < m * all_**2:
        equations = triangulated(equations)
    wide = np.zeros((len(equations), count + 1))
    wide[:, touched] = equations
    return wide


def triangulated(rows: Float64[np.ndarray, "m n"]) -> Float64[np.ndarray, "r n"]:
    """R of rows = Q R, with min(m, n) rows."""
    n = rows.shape[1]
    R = _geqrf(rows, lwork=BLOCK * n)[0]
    return np.triu(R[:n])


def telemetry_rows(network: Linear, k: int, columns: Columns) -> np.ndarray:
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


def pointing_rows(network: Linear, pairs: np.ndarray, columns: Columns) -> np.ndarray:
    """The mast pointing of some pairs, observed to be zero."""
    dense = np.zeros((3 * len(pairs), columns.count + 1))
    dense[np.arange(3 * len(pairs)), columns.of_pair[pairs].ravel()] = 1.0
    dense[:, -1] = -network.state.pointings[pairs].ravel()
    return dense * network.telemetry.pointing_weight


def control_rows(network: Linear, k: int, columns: Columns) -> np.ndarray:
    """Where control has the stop, in frames whose place stays unknown."""
    control = network.control
    if control is None:
        return np.zeros((0, columns.count + 1))
    l, (of_stop, of_frame) = control.whitened(network.state), control.partials(network.state)
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
    """What the stop had inherited, in the columns of the chart."""
    A, l = inherited.rows(state)
    parts = (
        columns.of_stop[inherited.stops],
        columns.of_pair[inherited.pairs],
        columns.of_frame[inherited.frames],
    )
    at = np.concatenate(parts, None)
    dense = np.zeros((len(A), columns.count + 1))
    dense[:, at] = A
    dense[:, -1] = l
    return dense
