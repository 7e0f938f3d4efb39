"""The whitened observation equations that touch a stop, in the columns of a chart.

A x = l for corrections in the LSL, one row an observation, l in the last column. Where a stop is
held its columns fall onto the last one too and are overwritten there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.collinearity import State, whitened_equations
from photogrammetry.adjustment.control import FRAME_UNKNOWNS
from photogrammetry.adjustment.control_equations import ROWS
from photogrammetry.adjustment.linear import Linear
from photogrammetry.adjustment.marginal import Chart, Marginal
from photogrammetry.adjustment.priors import telemetry_misclosures, telemetry_partials


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
    """Whitened observation equations of tie points, freed of the points."""
    observations = network.observations
    order = np.argsort(observations.point[rows], kind="stable")
    rows = rows[order]
    l, A_o, A_t = whitened_equations(network.state, observations, rows)
    pair = observations.pair[rows]
    places = np.hstack([columns.of_stop[observations.pair_stop[pair]], columns.of_pair[pair]])
    first = np.flatnonzero(np.diff(observations.point[rows], prepend=-1))
    counts = np.diff(first, append=len(rows))
    parts = [np.zeros((0, columns.count + 1))]
    for k in np.flatnonzero(np.bincount(counts)).tolist():
        members = first[counts == k][:, None] + np.arange(k)
        n = len(members)
        free = np.linalg.qr(A_t[members].reshape(n, 3 * k, 3), mode="complete")[0][:, :, 3:]
        dense = np.zeros((n, k, 3, columns.count + 1))
        point, seen, row, _ = np.ogrid[:n, :k, :3, :1]
        dense[point, seen, row, places[members][:, :, None]] = A_o[members]
        dense[..., -1] = l[members]  # over the bin of what is held
        by_point = dense.reshape(n, 3 * k, -1)
        parts.append((free.mT @ by_point).reshape(-1, columns.count + 1))
    return np.concatenate(parts)


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
