"""Bird's-eye views of a stop, and the search of one in another over position and azimuth.

Seen from above, the ground keeps its scale and its shape whatever the stop it was looked at from
(the idea of Landform, arXiv 2509.18330, and of the orthophoto tool of Di et al. 2008, section 3.1).
Every pixel of the dense parallax is triangulated and dropped into a cell of the level plane of the
stop: axes of the LSL as telemetry has them, origin at the rover. Two channels are kept,

    grey     mean grey value: albedo and shading, changes with the sun,
    relief   mean elevation, band-passed: tilt of the surface, the same under every sun,

each made free of brightness, contrast and long waves by subtracting and dividing by a Gaussian
neighbourhood. The later view is turned through every azimuth and correlated with the earlier one
at every shift by masked normalised cross-correlation in the frequency domain (Padfield 2012),

    c = sum(a b) - sum(a) sum(b) / n over the cells that both views have seen,

divided by both standard deviations over the same cells. A coefficient over n cells scatters as
1/sqrt(n) by chance; z = c sqrt(n), divided by its own robust scatter over all shifts, therefore
says how far a peak stands out, whatever the overlap. The channels' z are averaged as independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from scipy import fft

from photogrammetry.arrays import Float, Float32, Float64, Picture, Raster
from photogrammetry.errors import MatchingError
from photogrammetry.matching.records import MatchedPair, MatchedStop

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
Spectrum: TypeAlias = np.ndarray
"""Half of a real picture's discrete Fourier transform, complex."""
LEAST_REACH_M = 4.0
"""What correlates by chance is judged by shifts of this much at least, wherever the gate ends."""
CLIP = 3.0
"""Channels are clipped here, in local standard deviations: rocks and shadows must not rule."""


@dataclass(frozen=True, slots=True)
class BirdsEyeParams:
    """How a stop is drawn from above and searched."""

    cell_m: float = 0.16
    """The footprint of a Navcam pixel along the ground is 0.15 m at 15 m range."""
    surface_cell_m: float = 0.08
    """Of the elevations that patches of ground are drawn over."""
    radius_m: float = 30.0
    """Beyond it a Navcam's range is off by a metre and more."""
    grey_wave_m: float = 1.0
    relief_waves_m: tuple[float, float] = (0.2, 1.0)
    """Relief between these wavelengths: rocks and ripples; slopes move with errors of the tilt."""
    azimuth_step: float = 0.0087
    """Radians (0.5 degrees): moves the ground by a cell at 18 m."""
    min_overlap_m2: float = 40.0
    peaks: int = 5
    """Handed on; the lower ones, which are wrong, show what chance can do."""
    separation_m: float = 1.5
    """Two peaks nearer than this are one."""

    def __post_init__(self) -> None:
        if not (0 < self.cell_m < self.grey_wave_m and self.radius_m > self.grey_wave_m):
            raise MatchingError(
                f"a bird's-eye view needs cell < wave < radius, not {self.cell_m}, "
                f"{self.grey_wave_m} and {self.radius_m} m"
            )


@dataclass(frozen=True, slots=True, eq=False)
class BirdsEyeView:
    """The ground around a stop in its level plane; row 0 is the northernmost, the rover central."""

    cell_m: float
    grey: Raster
    elevation: Raster
    """Metres above the rover origin."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A later view's place on an earlier one: turned by `azimuth`, then moved."""

    azimuth: float
    """Radians, clockwise seen from above."""
    north_m: float
    east_m: float
    down_m: float
    z: float
    """Height of the correlation peak over its scatter by chance."""
    overlap_m2: float


@dataclass(frozen=True, slots=True)
class SearchGate:
    """Where the later rover can stand in the level frame of the earlier one."""

    north_m: float
    east_m: float
    reach_m: float
    """Largest horizontal distance from there."""
    azimuth_reach: float


def birds_eye_view(stop: MatchedStop, params: BirdsEyeParams) -> BirdsEyeView:
    """Draw the ground around a stop from its dense parallax."""
    return birds_eye_views(stop, params, (params.cell_m,))[0]


def birds_eye_views(
    stop: MatchedStop, params: BirdsEyeParams, cells_m: Sequence[float]
) -> tuple[BirdsEyeView, ...]:
    """Draw the ground around a stop from its dense parallax, once with every size of cells."""
    sizes = [2 * round(params.radius_m / cell_m) for cell_m in cells_m]
    sums = [np.zeros((3, size * size)) for size in sizes]
    for pair in stop.pairs:
        ground, grey = _level_points(stop, pair, 1.2 * params.radius_m)
        for total, size, cell_m in zip(sums, sizes, cells_m, strict=True):
            _add_points(total, ground, grey, params.radius_m, cell_m, size)
    views = []
    for total, size, cell_m in zip(sums, sizes, cells_m, strict=True):
        count, grey_sum, up_sum = total.astype(np.float32).reshape(3, size, size)
        with np.errstate(invalid="ignore"):
            views.append(BirdsEyeView(cell_m, grey_sum / count, up_sum / count))
    return tuple(views)


def _add_points(
    sums: Float64[np.ndarray, "3 cells"],
    ground: Float32[np.ndarray, "n 3"],
    grey: Float32[np.ndarray, " n"],
    radius_m: float,
    cell_m: float,
    size: int,
) -> None:
    """Add number, grey value and elevation of points to the cells they fall into."""
    row = np.floor((radius_m - ground[:, 0]) / cell_m).astype(np.int32)
    col = np.floor((radius_m + ground[:, 1]) / cell_m).astype(np.int32)
    inside = (row >= 0) & (row < size) & (col >= 0) & (col < size)
    index = row[inside] * size + col[inside]
    for k, weight in enumerate((None, grey[inside], -ground[inside, 2])):
        sums[k] += np.bincount(index, weight, minlength=size * size)


def _level_points(
    stop: MatchedStop, pair: MatchedPair, farthest_m: float
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
    """Dense points of a pair in the level frame and their grey value over the image's median.

    Every second column will do: on the ground, columns lie far closer than rows.
    """
    geometry, images = pair.images.geometry, pair.images
    scale = geometry.focal_px * geometry.base_m
    parallax, mask = pair.parallax[:, ::2], images.left_mask[:, ::2]
    line, half_sample = np.nonzero(mask & (parallax > scale / farthest_m))
    grey = images.left[:, ::2][line, half_sample]
    z = (scale / parallax[line, half_sample]).astype(np.float32)
    x = (2 * half_sample - geometry.centre_px[0]).astype(np.float32) / np.float32(geometry.focal_px)
    y = (line - geometry.centre_px[1]).astype(np.float32) / np.float32(geometry.focal_px)
    level_from_rover = stop.lsl_from_rover.rotation
    rotation = level_from_rover @ geometry.rover_from_pair.rotation
    origin = level_from_rover @ geometry.rover_from_pair.translation_m
    points = np.column_stack([x * z, y * z, z]) @ rotation.T.astype(np.float32)
    usual = float(np.median(grey)) if len(grey) else 1.0
    return points + origin.astype(np.float32), grey / np.float32(max(usual, 1e-6))


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One quantity of a view made comparable, zero where unseen, and a weight of 0 or 1."""

    value: Float32[np.ndarray, "rows cols"]
    weight: Float32[np.ndarray, "rows cols"]


def channels(view: BirdsEyeView, params: BirdsEyeParams) -> tuple[Channel, Channel]:
    """(grey, relief) of a view, over the same cells."""
    fine, coarse = (wave / view.cell_m for wave in params.relief_waves_m)
    grey = _band(view.grey, 0.8, params.grey_wave_m / view.cell_m)
    relief = _band(view.elevation, fine, coarse)
    weight = grey.weight * relief.weight
    return Channel(grey.value * weight, weight), Channel(relief.value * weight, weight)


def _band(raster: Raster, fine: float, coarse: float) -> Channel:
    """Local mean over `fine` minus that over `coarse` cells, in local standard deviations."""
    seen = np.isfinite(raster).astype(np.float32)
    value = np.nan_to_num(raster)

    def blurred(what: Raster, sigma: float) -> Raster:
        return cv2.GaussianBlur(what, (0, 0), sigma).astype(np.float32)

    density_fine = blurred(seen, fine)
    density = np.maximum(blurred(seen, coarse), 1e-6)
    weight = (density_fine > 0.1).astype(np.float32)  # noqa: PLR2004 - a tenth of the neighbours seen
    detail = (
        blurred(value, fine) / np.maximum(density_fine, 1e-6) - blurred(value, coarse) / density
    )
    detail *= weight
    around = np.maximum(blurred(weight, coarse), 1e-6)
    spread = np.sqrt(blurred(detail * detail, coarse) / around)
    value = np.clip(detail / np.maximum(spread, 1e-6), -CLIP, CLIP) * weight
    return Channel(value.astype(np.float32), weight)


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


def masked_correlation(
    fixed: Channel, moved: Channel, reach: int
) -> tuple[Float[np.ndarray, "rows cols"], Float[np.ndarray, "rows cols"]]:
    """Correlation coefficient and number of common cells, for every shift of `moved` over `fixed`.

    Entry (reach + i, reach + j) belongs to a shift of i rows down and j columns right.
    """
    rows, cols = (fft.next_fast_len(n + reach, real=True) for n in fixed.value.shape)
    one, other = (Spectra.of(c, (rows, cols)) for c in (fixed, moved))
    common = np.maximum(_lagged(one.weight, other.weight, reach, cols), 1.0)
    return _coefficient(one, other, common, reach, cols), common


def _lagged(a: Spectrum, b: Spectrum, reach: int, cols: int) -> Float[np.ndarray, "lags lags"]:
    """sum(a(x) b(x - lag)) for lags of up to `reach` cells each way."""
    every = fft.irfft2(a * np.conj(b), (a.shape[0], cols))
    lags = np.arange(-reach, reach + 1)
    return every[np.ix_(lags, lags)]


def _coefficient(
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
    ab, a, b, aa, bb = (_lagged(*pair, reach, cols) for pair in pairs)
    variance_a = np.maximum(aa - a**2 / common, 1e-3)
    variance_b = np.maximum(bb - b**2 / common, 1e-3)
    return (ab - a * b / common) / np.sqrt(variance_a * variance_b)


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

    def fixed(self, channel: Channel) -> Channel:
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

    def moved(self, channel: Channel, azimuth: float) -> Channel:
        """The later view's channel turned clockwise about its rover and put at the start."""
        size = channel.value.shape[0]
        turn = cv2.getRotationMatrix2D(((size - 1) / 2,) * 2, -float(np.degrees(azimuth)), 1.0)
        turn[:, 2] += self.start[1] - self.first[1], self.start[0] - self.first[0]
        shape = self.shape[::-1]
        value, weight = (cv2.warpAffine(p, turn, shape) for p in (channel.value, channel.weight))
        weight = (weight > 0.99).astype(np.float32)  # noqa: PLR2004 - whole cells only
        return Channel((value * weight).astype(np.float32), weight)


def search(
    earlier: BirdsEyeView, later: BirdsEyeView, gate: SearchGate, params: BirdsEyeParams
) -> list[PlaneFit]:
    """The best places of the later view on the earlier one inside the gate, best first."""
    cell_m = params.cell_m
    frame = _Frame.of(earlier.grey.shape[0], cell_m, gate)
    fixed = _spectra([frame.fixed(c) for c in channels(earlier, params)], frame)
    moving = channels(later, params)
    steps = int(np.ceil(gate.azimuth_reach / params.azimuth_step))
    azimuths = np.arange(-steps, steps + 1) * params.azimuth_step
    surfaces = [
        _surfaces(fixed, _spectra([frame.moved(c, float(a)) for c in moving], frame), frame, params)
        for a in azimuths
    ]
    z = _over_chance(np.stack([s[0] for s in surfaces], axis=1))
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
        azimuth = float(azimuths[k] + params.azimuth_step * _vertex_1d(z[:, i, j], int(k)))
        down = _drop(earlier, later, azimuth, north, east)
        overlap = float(surfaces[k][1][i, j]) * cell_m**2
        fits.append(PlaneFit(azimuth, north, east, down, float(z[k, i, j]), overlap))
        near = np.hypot(norths[:, None] - north, easts[None, :] - east) < params.separation_m
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
    common = np.maximum(_lagged(fixed[0].weight, moving[0].weight, frame.reach, cols), 1.0)
    scaled = [
        _coefficient(one, other, common, frame.reach, cols) * np.sqrt(common)
        for one, other in zip(fixed, moving, strict=True)
    ]
    enough = common * params.cell_m**2 > params.min_overlap_m2
    return np.where(enough, scaled, np.nan).astype(np.float32), common.astype(np.float32)


def _over_chance(
    scaled: Float32[np.ndarray, "channels azimuths lags lags"],
) -> Float32[np.ndarray, "azimuths lags lags"]:
    """z: all channels as independent, each over its robust scatter; 0 where there is none."""
    total = np.zeros(scaled.shape[1:], np.float32)
    for channel in scaled:
        known = np.isfinite(channel)
        if known.any():
            scatter = MAD_TO_SIGMA * float(np.median(np.abs(channel[known])))
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


def placed_on(
    raster: Raster, cell_m: float, azimuth: float, north_m: float, east_m: float
) -> Raster:
    """A raster of the later view on the grid of the earlier one; NaN where unseen."""
    size = raster.shape[0]
    place = cv2.getRotationMatrix2D(((size - 1) / 2,) * 2, -float(np.degrees(azimuth)), 1.0)
    place[:, 2] = place[:, 2] + np.array([east_m, -north_m]) / cell_m
    return cv2.warpAffine(
        raster, place, (size, size), flags=cv2.INTER_NEAREST, borderValue=float("nan")
    ).astype(np.float32)


def _drop(
    earlier: BirdsEyeView, later: BirdsEyeView, azimuth: float, north_m: float, east_m: float
) -> float:
    """How much lower the later rover stands, by the median over the common ground."""
    over = placed_on(later.elevation, later.cell_m, azimuth, north_m, east_m)
    both = np.isfinite(over) & np.isfinite(earlier.elevation)
    return float(np.median(over[both] - earlier.elevation[both])) if both.any() else 0.0


def overlay_picture(earlier: BirdsEyeView, later: BirdsEyeView, fit: PlaneFit) -> Picture:
    """Both views in one picture, the earlier in red, the later in green and blue.

    Where they agree the picture is grey; where only one saw the ground it has that one's colour.
    """
    over = placed_on(later.grey, later.cell_m, fit.azimuth, fit.north_m, fit.east_m)
    wave = 1.0 / earlier.cell_m
    red, cyan = (_band(grey, 0.8, wave) for grey in (earlier.grey, over))
    stretched = [
        np.where(c.weight > 0, 40 + 215 * (c.value + CLIP) / (2 * CLIP), 0).astype(np.uint8)
        for c in (red, cyan, cyan)
    ]
    return np.dstack(stretched)
