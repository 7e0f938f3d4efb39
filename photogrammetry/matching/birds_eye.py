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

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import fft

from photogrammetry.arrays import Float, Float32, Picture, Raster
from photogrammetry.errors import MatchingError
from photogrammetry.matching.records import MatchedPair, MatchedStop

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
CLIP = 3.0
"""Channels are clipped here, in local standard deviations: rocks and shadows must not rule."""


@dataclass(frozen=True, slots=True)
class BirdsEyeParams:
    """How a stop is drawn from above and searched."""

    cell_m: float = 0.16
    """The footprint of a Navcam pixel along the ground is 0.15 m at 15 m range."""
    radius_m: float = 30.0
    """Beyond it a Navcam's range is off by a metre and more."""
    grey_wave_m: float = 1.0
    relief_waves_m: tuple[float, float] = (0.2, 1.0)
    """Relief between these wavelengths: rocks and ripples; slopes move with errors of the tilt."""
    azimuth_step: float = 0.0087
    """Radians (0.5 degrees): moves the ground by a cell at 18 m."""
    min_overlap_m2: float = 40.0
    hypotheses: int = 3
    """Peaks handed on; those that are wrong also show what chance can do."""
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
    cells = 2 * round(params.radius_m / params.cell_m)
    sums = np.zeros((3, cells * cells))
    for pair in stop.pairs:
        ground, grey = _level_points(stop, pair, 1.2 * params.radius_m)
        row = np.floor((params.radius_m - ground[:, 0]) / params.cell_m).astype(np.int64)
        col = np.floor((params.radius_m + ground[:, 1]) / params.cell_m).astype(np.int64)
        inside = (row >= 0) & (row < cells) & (col >= 0) & (col < cells)
        index = row[inside] * cells + col[inside]
        weights = (None, grey[inside], -ground[inside, 2])
        sums += [np.bincount(index, weight, minlength=cells * cells) for weight in weights]
    count, grey_sum, up_sum = sums.reshape(3, cells, cells)
    with np.errstate(invalid="ignore"):
        return BirdsEyeView(
            params.cell_m,
            (grey_sum / count).astype(np.float32),
            (up_sum / count).astype(np.float32),
        )


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
    """(grey, relief) of a view."""
    fine, coarse = (wave / view.cell_m for wave in params.relief_waves_m)
    return (
        _band(view.grey, 0.8, params.grey_wave_m / view.cell_m),
        _band(view.elevation, fine, coarse),
    )


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


def masked_correlation(
    fixed: Channel, moved: Channel, reach: int
) -> tuple[Float[np.ndarray, "rows cols"], Float[np.ndarray, "rows cols"]]:
    """Correlation coefficient and number of common cells, for every shift of `moved` over `fixed`.

    Entry (reach + i, reach + j) belongs to a shift of i rows down and j columns right.
    """
    rows, cols = (fft.next_fast_len(n + reach, real=True) for n in fixed.value.shape)

    def forward(what: Raster) -> np.ndarray:
        return fft.rfft2(what, (rows, cols))

    def lagged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        every = fft.irfft2(a * np.conj(b), (rows, cols))
        lags = np.arange(-reach, reach + 1)
        return every[np.ix_(lags, lags)]

    a, m, aa = (forward(f) for f in (fixed.value, fixed.weight, fixed.value**2))
    b, w, bb = (forward(f) for f in (moved.value, moved.weight, moved.value**2))
    n = np.maximum(lagged(m, w), 1.0)
    sum_a, sum_b = lagged(a, w), lagged(m, b)
    variance_a = np.maximum(lagged(aa, w) - sum_a**2 / n, 1e-3)
    variance_b = np.maximum(lagged(m, bb) - sum_b**2 / n, 1e-3)
    return (lagged(a, b) - sum_a * sum_b / n) / np.sqrt(variance_a * variance_b), n


def turned(channel: Channel, azimuth: float) -> Channel:
    """A channel turned clockwise about the rover."""
    size = channel.value.shape[0]
    turn = cv2.getRotationMatrix2D(((size - 1) / 2,) * 2, -float(np.degrees(azimuth)), 1.0)
    value = cv2.warpAffine(channel.value, turn, (size, size))
    weight = (cv2.warpAffine(channel.weight, turn, (size, size)) > 0.99).astype(np.float32)  # noqa: PLR2004
    return Channel((value * weight).astype(np.float32), weight)


def search(
    earlier: BirdsEyeView, later: BirdsEyeView, gate: SearchGate, params: BirdsEyeParams
) -> list[PlaneFit]:
    """The best places of the later view on the earlier one inside the gate, best first."""
    fixed, moving = channels(earlier, params), channels(later, params)
    steps = int(np.ceil(gate.azimuth_reach / params.azimuth_step))
    azimuths = np.arange(-steps, steps + 1) * params.azimuth_step
    reach = int(np.ceil((np.hypot(gate.north_m, gate.east_m) + gate.reach_m) / params.cell_m)) + 1
    surfaces = [_surface(fixed, moving, float(a), reach, params) for a in azimuths]
    z = np.stack([s[0] for s in surfaces])
    shift = np.arange(-reach, reach + 1) * params.cell_m
    distance = np.hypot(-shift[:, None] - gate.north_m, shift[None, :] - gate.east_m)
    z[:, distance > gate.reach_m] = -np.inf
    fits = []
    for _ in range(params.hypotheses):
        k, i, j = np.unravel_index(int(np.argmax(z)), z.shape)
        if not z[k, i, j] > 0:
            break
        di, dj = _vertex(z[k], int(i), int(j))
        north, east = -(shift[i] + di * params.cell_m), shift[j] + dj * params.cell_m
        azimuth = float(azimuths[k] + params.azimuth_step * _vertex_1d(z[:, i, j], int(k)))
        down = _drop(earlier, later, azimuth, north, east)
        overlap = float(surfaces[k][1][i, j]) * params.cell_m**2
        fits.append(PlaneFit(azimuth, float(north), float(east), down, float(z[k, i, j]), overlap))
        z[
            :, np.hypot(-shift[:, None] - north, shift[None, :] - east) < params.separation_m
        ] = -np.inf
    return fits


def _surface(
    fixed: tuple[Channel, Channel],
    moving: tuple[Channel, Channel],
    azimuth: float,
    reach: int,
    params: BirdsEyeParams,
) -> tuple[Raster, Raster]:
    """(z, common cells) of both channels together at every shift, at one azimuth."""
    total = np.zeros((2 * reach + 1,) * 2)
    common = np.zeros_like(total)
    for one, other in zip(fixed, moving, strict=True):
        coefficient, common = masked_correlation(one, turned(other, azimuth), reach)
        enough = common * params.cell_m**2 > params.min_overlap_m2
        z = np.where(enough, coefficient * np.sqrt(common), 0.0)
        if enough.any():
            z /= max(MAD_TO_SIGMA * float(np.median(np.abs(z[enough]))), 1e-9)
        total += z / np.sqrt(len(fixed))
    return total.astype(np.float32), common.astype(np.float32)


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
