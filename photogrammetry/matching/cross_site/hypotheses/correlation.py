"""The search of one bird's-eye view in another, over position and azimuth.

The later view is turned through every azimuth and correlated with the earlier one at every shift by
masked normalised cross-correlation in the frequency domain (Padfield 2012). Over the n cells that
both views have seen,

    c = (sum(a b) - sum(a) sum(b) / n) / sqrt(variances of a and b over the same cells).

By chance c scatters as 1/sqrt(n); z = c sqrt(n), divided by its own robust scatter over all shifts,
says how far a peak stands out, whatever the overlap. The z of the two channels are averaged as
independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from scipy import fft

from solmap.photogrammetry.arrays import Float, Float32, Raster
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    AZIMUTH_STEP,
    SEPARATION_M,
    BirdsEyeParams,
    BirdsEyeView,
    Channel,
    PlaneFit,
    SearchGate,
    channels,
    place_on,
)
from solmap.photogrammetry.robust import robust_sigma

LEAST_REACH_M = 4.0
"""What correlates by chance is judged by shifts of this much at least, wherever the gate ends."""

Spectrum: TypeAlias = np.ndarray
"""Half of a real picture's discrete Fourier transform, complex."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Fourier transforms of a channel's value, its square and its weight."""

    value: Spectrum
    square: Spectrum
    weight: Spectrum

    @classmethod
    def of(
        cls, channel: Channel, shape: tuple[int, int], weight: Spectrum | None = None
    ) -> Spectra:
        """Transforms over `shape`; channels over the same cells share that of the weight."""
        value, square = (fft.rfft2(k, shape) for k in (channel.value, channel.value**2))
        return cls(value, square, fft.rfft2(channel.weight, shape) if weight is None else weight)


@dataclass(frozen=True, slots=True)
class _Frame:
    """The part of the earlier view's grid that both views can share, and shifts around a start.

    With a margin of `reach` cells on every side that `fixed` leaves empty, shifts never wrap.
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
        reach = int(np.ceil(max(gate.reach_m, LEAST_REACH_M) / cell_m)) + 1
        first = [max(0, s - reach) - reach for s in start]
        end = [min(size, size + s + reach) + reach for s in start]
        rows, cols = (
            fft.next_fast_len(max(e - f, 2 * reach + 1), real=True)
            for f, e in zip(first, end, strict=True)
        )
        return cls(start, reach, (first[0], first[1]), (rows, cols))

    def place_earlier(self, channel: Channel) -> Channel:
        """The earlier view's channel in the frame, nothing in the margin."""
        size, margin = channel.value.shape[0], self.reach
        lows = [max(0, f + margin) for f in self.first]
        highs = [min(size, f + n - margin) for f, n in zip(self.first, self.shape, strict=True)]
        there = tuple(slice(low, max(low, high)) for low, high in zip(lows, highs, strict=True))
        here = tuple(
            slice(part.start - f, part.stop - f) for part, f in zip(there, self.first, strict=True)
        )
        parts = []
        for part in (channel.value, channel.weight):
            drawn = np.zeros(self.shape, np.float32)
            drawn[here] = part[there]
            parts.append(drawn)
        return Channel(*parts)

    def place_later(self, channel: Channel, azimuth: float) -> Channel:
        """The later view's channel turned clockwise about its rover and put at the start."""
        size = channel.value.shape[0]
        turn = cv2.getRotationMatrix2D(((size - 1) / 2,) * 2, -float(np.degrees(azimuth)), 1.0)
        turn[:, 2] += self.start[1] - self.first[1], self.start[0] - self.first[0]
        shape = self.shape[::-1]
        value, weight = (cv2.warpAffine(p, turn, shape) for p in (channel.value, channel.weight))
        weight = (weight > 0.99).astype(np.float32)  # noqa: PLR2004 - whole cells only
        return Channel((value * weight).astype(np.float32), weight)


def correlate_views(
    earlier: BirdsEyeView, later: BirdsEyeView, gate: SearchGate, params: BirdsEyeParams
) -> list[PlaneFit]:
    """The best places of the later view on the earlier one inside the gate, best first."""
    cell_m = params.cell_m
    frame = _Frame.of(earlier.grey.shape[0], cell_m, gate)
    fixed = _spectra([frame.place_earlier(c) for c in channels(earlier, params)], frame)
    moving = channels(later, params)
    steps = int(np.ceil(gate.azimuth_reach / AZIMUTH_STEP))
    azimuths = np.arange(-steps, steps + 1) * AZIMUTH_STEP
    surfaces = [
        _surfaces(
            fixed, _spectra([frame.place_later(c, float(a)) for c in moving], frame), frame, params
        )
        for a in azimuths
    ]
    z = _significance(np.stack([s[0] for s in surfaces], axis=1))
    lags = np.arange(-frame.reach, frame.reach + 1)
    norths, easts = -(frame.start[0] + lags) * cell_m, (frame.start[1] + lags) * cell_m
    distance = np.hypot(norths[:, None] - gate.north_m, easts[None, :] - gate.east_m)
    z[:, distance > gate.reach_m] = -np.inf
    fits = []
    for _ in range(params.peaks):
        k, i, j = np.unravel_index(int(np.argmax(z)), z.shape)
        if not z[k, i, j] > 0:
            break
        di, dj = _vertex(z[k], int(i), int(j))
        north, east = float(norths[i] - di * cell_m), float(easts[j] + dj * cell_m)
        azimuth = float(azimuths[k] + AZIMUTH_STEP * _vertex_1d(z[:, i, j], int(k)))
        down = _drop(earlier, later, azimuth, north, east)
        overlap = float(surfaces[k][1][i, j]) * cell_m**2
        fits.append(PlaneFit(azimuth, north, east, down, float(z[k, i, j]), overlap))
        near = np.hypot(norths[:, None] - north, easts[None, :] - east) < SEPARATION_M
        z[:, near] = -np.inf
    return fits


def _spectra(both: Sequence[Channel], frame: _Frame) -> tuple[Spectra, ...]:
    """The spectra of channels that share their cells."""
    weight = fft.rfft2(both[0].weight, frame.shape)
    return tuple(Spectra.of(channel, frame.shape, weight) for channel in both)


def _surfaces(
    fixed: Sequence[Spectra], moving: Sequence[Spectra], frame: _Frame, params: BirdsEyeParams
) -> tuple[Float32[np.ndarray, "channels lags lags"], Raster]:
    """(c sqrt(n) of every channel, n) at every shift, at one azimuth; NaN with too few cells."""
    cols = frame.shape[1]
    common = np.maximum(lagged_products(fixed[0].weight, moving[0].weight, frame.reach, cols), 1.0)
    scaled = [
        correlation_coefficient(one, other, common, frame.reach, cols) * np.sqrt(common)
        for one, other in zip(fixed, moving, strict=True)
    ]
    enough = common * params.cell_m**2 > params.min_overlap_m2
    return np.where(enough, scaled, np.nan).astype(np.float32), common.astype(np.float32)


def _significance(
    scaled: Float32[np.ndarray, "channels azimuths lags lags"],
) -> Float32[np.ndarray, "azimuths lags lags"]:
    """z: all channels as independent, each over its robust scatter; 0 where there is none."""
    total = np.zeros(scaled.shape[1:], np.float32)
    for channel in scaled:
        known = np.isfinite(channel)
        if known.any():
            scatter = robust_sigma(channel[known])
            total += np.nan_to_num(channel) / np.float32(max(scatter, 1e-9) * len(scaled) ** 0.5)
    return total


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
    """How much lower the later rover stands, by the median over the common ground."""
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


def correlation_coefficient(
    one: Spectra, other: Spectra, common: Float[np.ndarray, "lags lags"], reach: int, cols: int
) -> Float[np.ndarray, "lags lags"]:
    """Correlation coefficient over the common cells at every lag."""
    pairs = (
        (one.value, other.value),
        (one.value, other.weight),
        (one.weight, other.value),
        (one.square, other.weight),
        (one.weight, other.square),
    )
    ab, a, b, aa, bb = (lagged_products(*pair, reach, cols) for pair in pairs)
    variance_a = np.maximum(aa - a**2 / common, 1e-3)
    variance_b = np.maximum(bb - b**2 / common, 1e-3)
    return (ab - a * b / common) / np.sqrt(variance_a * variance_b)
