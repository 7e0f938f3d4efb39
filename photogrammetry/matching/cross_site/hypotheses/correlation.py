"""Search one bird's-eye view in another, over position and azimuth.

The later view is rotated through every azimuth and correlated with the earlier one at every shift
in the frequency domain. Channels have a mean of zero and a variance of one around every cell, so
over the n cells measured in both views

    q = sum(a b) / sqrt(n)

has the same standard deviation for random ground at any overlap; on repetitive ground, such as
ripples, it is larger. Hence z: q over its standard deviation at all shifts nearby, so that a peak
is compared with its neighbourhood. The z of relief and detail, which do not depend on the sun, are
added as independent and divided by the standard deviation of the sum, z_h; then

    z = max(z_h, (z_h + z_grey) / sqrt(2)),

grey values are used where they agree with the heights and have no effect elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from scipy import fft

from solmap.photogrammetry.arrays import Float, Float32, Mask, Raster
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    SEPARATION_M,
    BirdsEyeView,
    Channel,
    PlaneFit,
    SearchGate,
    channels,
    place_on,
)
from solmap.photogrammetry.robust import robust_sigma

STEP_RADIUS_M = 18.0
"""Distance at which one azimuth step moves the ground by a cell."""

LEAST_REACH_M = 4.0
"""Least range of shifts for the statistics of random correlation, beyond the gate if necessary."""

AROUND_M = 8.0
"""Side of the square of shifts for the local standard deviation of q."""

CAP = 3.0
"""Limit of q in that estimate, in standard deviations, so that a peak does not mask itself."""

LEAST_SCATTER = 0.5
"""Least local standard deviation of q, as a fraction of that of all shifts."""

Framed: TypeAlias = Float32[np.ndarray, "frame_rows frame_cols"]

Spectrum: TypeAlias = np.ndarray
"""Half of a real raster's discrete Fourier transform, complex."""


@dataclass(frozen=True, slots=True)
class _Frame:
    """The part of the earlier view's grid that both views can share, and shifts about its centre.

    With a margin of `reach` cells on every side, empty in `fixed`, shifts never wrap around.
    """

    start: tuple[int, int]
    """Shift in rows and columns at the centre of the gate."""
    reach: int
    first: tuple[int, int]
    """Row and column of the frame's first cell in the earlier view, the margin included."""
    shape: tuple[int, int]

    @classmethod
    def of(cls, size: int, cell_m: float, gate: SearchGate) -> _Frame:
        """The frame of a gate between views of size x size cells."""
        start = (-round(gate.north_m / cell_m), round(gate.east_m / cell_m))
        reach = int(np.ceil(max(gate.reach_m + SEPARATION_M, LEAST_REACH_M) / cell_m)) + 1
        first = [max(0, s - reach) - reach for s in start]
        end = [min(size, size + s + reach) + reach for s in start]
        rows, cols = (
            fft.next_fast_len(max(e - f, 2 * reach + 1), real=True)
            for f, e in zip(first, end, strict=True)
        )
        return cls(start, reach, (first[0], first[1]), (rows, cols))

    def place_earlier(self, raster: Raster) -> Framed:
        """A raster of the earlier view in the frame, with an empty margin."""
        size, margin = raster.shape[0], self.reach
        lows = [max(0, f + margin) for f in self.first]
        highs = [min(size, f + n - margin) for f, n in zip(self.first, self.shape, strict=True)]
        there = tuple(slice(low, max(low, high)) for low, high in zip(lows, highs, strict=True))
        here = tuple(
            slice(part.start - f, part.stop - f) for part, f in zip(there, self.first, strict=True)
        )
        drawn = np.zeros(self.shape, np.float32)
        drawn[here] = raster[there]
        return drawn

    def place_later(self, raster: Raster, azimuth: float) -> Framed:
        """A raster of the later view rotated clockwise about its rover and shifted to the start."""
        size = raster.shape[0]
        turn = cv2.getRotationMatrix2D(((size - 1) / 2,) * 2, -float(np.degrees(azimuth)), 1.0)
        turn[:, 2] += self.start[1] - self.first[1], self.start[0] - self.first[0]
        return cv2.warpAffine(raster, turn, self.shape[::-1]).astype(np.float32)


def azimuth_step(view: BirdsEyeView) -> float:
    """Radians between the azimuths of the search."""
    return view.cell_m / STEP_RADIUS_M


def correlate_views(
    earlier: BirdsEyeView,
    later: BirdsEyeView,
    gate: SearchGate,
    most: int,
    min_overlap_m2: float,
) -> list[PlaneFit]:
    """The best positions of the later view on the earlier one, best first.

    The rim of the gate is searched as well: a maximum there belongs to a peak outside the gate.
    """
    cell_m = earlier.cell_m
    frame = _Frame.of(earlier.grey.shape[0], cell_m, gate)
    fixed = [fft.rfft2(frame.place_earlier(raster)) for raster in _rasters(channels(earlier))]
    moving = _rasters(channels(later))
    step = azimuth_step(earlier)
    steps = int(np.ceil(gate.azimuth_reach / step)) + 1
    azimuths = gate.azimuth + np.arange(-steps, steps + 1) * step
    least_cells, around = min_overlap_m2 / cell_m**2, round(AROUND_M / cell_m)
    maps = []
    for azimuth in azimuths:
        turned = [fft.rfft2(frame.place_later(raster, float(azimuth))) for raster in moving]
        maps.append(_correlate(fixed, turned, frame, least_cells, around))
    z, common = (np.stack(part) for part in zip(*maps, strict=True))
    lags = np.arange(-frame.reach, frame.reach + 1)
    norths, easts = -(frame.start[0] + lags) * cell_m, (frame.start[1] + lags) * cell_m
    distance = np.hypot(norths[:, None] - gate.north_m, easts[None, :] - gate.east_m)
    z[:, distance > gate.reach_m + SEPARATION_M] = -np.inf
    z[:, np.hypot(norths[:, None], easts[None, :]) < gate.apart_m] = -np.inf
    fits: list[PlaneFit] = []
    while len(fits) < most:
        k, i, j = (int(at) for at in np.unravel_index(int(np.argmax(z)), z.shape))
        if not z[k, i, j] > 0:
            break
        di, dj = _vertex(z[k], i, j)
        north, east = float(norths[i] - di * cell_m), float(easts[j] + dj * cell_m)
        turn = float(azimuths[k] + step * _vertex_1d(z[:, i, j], k))
        down = _drop(earlier, later, turn, north, east)
        overlap_m2 = float(common[k, i, j]) * cell_m**2
        fits.append(PlaneFit(turn, north, east, down, float(z[k, i, j]), overlap_m2))
        near = np.hypot(norths[:, None] - north, easts[None, :] - east) < SEPARATION_M
        z[:, near] = -np.inf
    return fits


def _rasters(every: Sequence[Channel]) -> list[Raster]:
    """The common weight of the channels, then their values."""
    return [every[0].weight, *(channel.value for channel in every)]


def _correlate(
    fixed: Sequence[Spectrum],
    moving: Sequence[Spectrum],
    frame: _Frame,
    least_cells: float,
    around: int,
) -> tuple[Raster, Raster]:
    """(z, cells measured in both views) at every shift, at one azimuth."""
    common, *sums = (
        lagged_products(one, other, frame.reach, frame.shape[1])
        for one, other in zip(fixed, moving, strict=True)
    )
    known = common > least_cells
    root = np.sqrt(np.maximum(common, 1.0))
    grey, relief, detail = (standing_out(total / root, known, around) for total in sums)
    heights = standing_out(relief + detail, known, around)
    return np.maximum(heights, (heights + grey) / np.float32(np.sqrt(2))), common


def standing_out(q: Raster, known: Mask, around: int) -> Raster:
    """The sums over their standard deviation in squares `around` cells wide; 0 where unknown."""
    if not known.any():
        return np.zeros_like(q)
    z = np.where(known, q / max(robust_sigma(q[known]), 1e-9), 0).astype(np.float32)
    square = np.minimum(z * z, np.float32(CAP**2))
    power, share = (cv2.blur(what, (around, around)) for what in (square, known.astype(np.float32)))
    variance = np.maximum(power / np.maximum(share, 1e-6), LEAST_SCATTER**2)
    return (z / np.sqrt(variance)).astype(np.float32)


def _vertex_1d(values: Float[np.ndarray, " n"], at: int) -> float:
    """Offset of a parabola's vertex through a maximum and its neighbours, in steps."""
    if not 0 < at < len(values) - 1:
        return 0.0
    low, mid, high = (float(v) for v in values[at - 1 : at + 2])
    bend = low - 2 * mid + high
    if not np.isfinite(bend) or bend >= 0:
        return 0.0
    return float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5))


def _vertex(surface: Float[np.ndarray, "rows cols"], i: int, j: int) -> tuple[float, float]:
    """Sub-cell offset (rows, columns) of a maximum."""
    return _vertex_1d(surface[:, j], i), _vertex_1d(surface[i, :], j)


def _drop(
    earlier: BirdsEyeView, later: BirdsEyeView, azimuth: float, north_m: float, east_m: float
) -> float:
    """Height of the later rover below the earlier one, by the median over the common ground."""
    over = place_on(later.elevation, later.cell_m, azimuth, north_m, east_m)
    both = np.isfinite(over) & np.isfinite(earlier.elevation)
    return float(np.median(over[both] - earlier.elevation[both])) if both.any() else 0.0


def lagged_products(
    a: Spectrum, b: Spectrum, reach: int, cols: int
) -> Float[np.ndarray, "lags lags"]:
    """sum(a(x) b(x - lag)) for lags of up to `reach` cells each way."""
    every = fft.irfft2(a * np.conj(b), (a.shape[0], cols))
    lags = np.arange(-reach, reach + 1)
    return every[np.ix_(lags, lags)]
