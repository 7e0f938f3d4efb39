"""Bird's-eye views of a stop: the ground around it, rasterised from its dense parallax.

In a vertical view, scale and shape of the ground do not depend on the stop (the idea of Landform,
arXiv 2509.18330, and of the orthophoto tool of Di et al. 2008, section 3.1). Every pixel of the
dense parallax is triangulated and assigned to a cell of the level plane of the stop: axes of the
LSL by telemetry, origin at the rover. A view has three channels,

    grey     mean grey value between neighbouring cells: albedo and shading, depends on the sun,
    relief   mean elevation, wavelengths between two and twelve cells: rocks, ripples,
    detail   the same between neighbouring cells: stones,

each normalised for brightness, contrast and slope by a Gaussian neighbourhood. The elevation does
not depend on the sun, and the shorter its wavelengths, the more independent samples the common
ground has and the narrower is the correlation peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, Raster, Vector3
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.kernels import sum_ground
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop
from solmap.photogrammetry.ranges import MOST_SIDE, CellSize, Few, Metres, SquareMetres

CLIP = 3.0
"""Limit of channels, in local standard deviations, so that rocks and shadows do not dominate."""


DETAIL, RELIEF = (0.3, 2.0), (1.25, 6.0)
"""Standard deviations, in cells, of the two Gaussian means whose difference is the channel. Longer
waves are affected by errors of the tilt."""


SEPARATION_M = 1.5
"""Distance below which two peaks count as one."""


@dataclass(frozen=True, slots=True)
class BirdsEyeParams:
    """How bird's-eye views are made and searched."""

    cell_m: CellSize = 0.16
    """Side of a cell: the footprint of a Navcam pixel along the ground is 0.15 m at 15 m range."""
    surface_cell_m: CellSize = 0.08
    """Side of a cell for the elevations of patches of ground."""
    radius_m: Metres = 30.0
    """Farthest ground: beyond it the range error of a Navcam exceeds a metre."""
    min_overlap_m2: SquareMetres = 40.0
    """Least common ground of two views."""
    peaks: Few = 4
    """Number of hypotheses of the later stop's position that are tested."""

    def __post_init__(self) -> None:
        if not 0 < 2 * RELIEF[1] * self.cell_m < self.radius_m:
            raise MatchingError(
                f"a bird's-eye view needs cells far smaller than its radius, not {self.cell_m} and "
                f"{self.radius_m} m"
            )
        if 2 * self.radius_m > MOST_SIDE * min(self.cell_m, self.surface_cell_m):
            raise MatchingError(
                f"ground as far as {self.radius_m} m has more than {MOST_SIDE} cells a side: give "
                "larger cells or a smaller radius"
            )


@dataclass(frozen=True, slots=True, eq=False)
class BirdsEyeView:
    """The ground around a stop in its level plane; row 0 is the northernmost, the rover central."""

    cell_m: float
    grey: Raster
    elevation: Raster
    """Metres above the rover origin."""

    @property
    def halved(self) -> BirdsEyeView:
        """The view with cells of twice the size."""
        grey, elevation = (_mean_of_four(raster) for raster in (self.grey, self.elevation))
        return BirdsEyeView(2 * self.cell_m, grey, elevation)


def _mean_of_four(raster: Raster) -> Float32[np.ndarray, "half_rows half_cols"]:
    """The mean of the measured cells in every square of four; the rover stays central."""
    half = raster.shape[0] // 4 * 2
    middle = raster.shape[0] // 2
    inner = raster[middle - half : middle + half, middle - half : middle + half]
    quarters = inner.reshape(half, 2, half, 2)
    seen = np.isfinite(quarters).sum(axis=(1, 3), dtype=np.float32)
    with np.errstate(invalid="ignore"):
        return (np.nansum(quarters, axis=(1, 3)) / seen).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """Position of a later view on an earlier one: rotated by `azimuth`, then shifted."""

    azimuth: float
    """Radians, clockwise seen from above."""
    north_m: float
    east_m: float
    down_m: float
    z: float
    """Height of the correlation peak over the standard deviation of random correlation."""
    overlap_m2: float


@dataclass(frozen=True, slots=True)
class SearchGate:
    """Possible positions of the later rover in the level frame of the earlier one."""

    north_m: float
    east_m: float
    reach_m: float
    """Largest horizontal distance from the centre."""
    azimuth_reach: float
    azimuth: float = 0.0
    """Central azimuth, radians."""
    apart_m: float = 0.0
    """Least distance of both rovers: errors that both panoramas share, by dust on the optics and
    where images meet, correlate where the rovers would stand at the same place."""

    def holds(self, fit: PlaneFit) -> bool:
        """Whether a fit lies in the gate."""
        away_m = float(np.hypot(fit.north_m - self.north_m, fit.east_m - self.east_m))
        turned = abs(fit.azimuth - self.azimuth)
        return away_m <= self.reach_m and turned <= self.azimuth_reach


def draw_birds_eye(
    stop: MatchedStop, params: BirdsEyeParams, cells_m: Sequence[float]
) -> tuple[BirdsEyeView, ...]:
    """Rasterise the ground around a stop from its dense parallax, for all cell sizes at once.

    Grey values are relative to the median of their image's ground.
    """
    sizes = [2 * round(params.radius_m / cell_m) for cell_m in cells_m]
    sums = [np.zeros((3, size * size)) for size in sizes]
    for pair in stop.pairs:
        camera, rotation, origin = level_camera(stop, pair)
        least_px = camera[0] / (1.2 * params.radius_m)
        seen = pair.left_mask[:, ::2] & (pair.parallax[:, ::2] > least_px)
        grey = pair.left[:, ::2][seen]
        median = max(float(np.median(grey)), 1e-6) if len(grey) else 1.0
        rasters = pair.parallax, pair.left_mask, pair.left
        for total, size, cell_m in zip(sums, sizes, cells_m, strict=True):
            grid = cell_m, params.radius_m, size
            own = sum_ground(rasters, camera, rotation, origin, least_px, grid)
            own[1] /= median
            np.add(total, own, out=total)
    views = []
    for total, size, cell_m in zip(sums, sizes, cells_m, strict=True):
        count, grey_sum, up_sum = total.astype(np.float32).reshape(3, size, size)
        with np.errstate(invalid="ignore"):
            views.append(BirdsEyeView(cell_m, grey_sum / count, up_sum / count))
    return tuple(views)


def level_camera(
    stop: MatchedStop, pair: MatchedPair
) -> tuple[Float64[np.ndarray, " 4"], Float64[np.ndarray, "3 3"], Vector3]:
    """A pair in the level frame of its stop, as the compiled loops expect it.

    Returns:
        (f B in pixel metres, f in pixels, principal point), rotation, origin in metres.
    """
    geometry, level_from_rover = pair.geometry, stop.lsl_from_rover.rotation
    scale = geometry.focal_px * geometry.base_m
    return (
        np.array([scale, geometry.focal_px, *geometry.centre_px]),
        level_from_rover @ geometry.rover_from_pair.rotation,
        level_from_rover @ geometry.rover_from_pair.translation_m,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One quantity of a view, normalised, zero where not measured, and a weight of 0 or 1."""

    value: Float32[np.ndarray, "rows cols"]
    weight: Float32[np.ndarray, "rows cols"]


@lru_cache(maxsize=4)
def channels(view: BirdsEyeView) -> tuple[Channel, Channel, Channel]:
    """(grey, relief, detail) of a view, over the same cells."""
    every = [
        band_pass(view.grey, *DETAIL),
        band_pass(view.elevation, *RELIEF),
        band_pass(view.elevation, *DETAIL),
    ]
    weight = every[0].weight * every[1].weight * every[2].weight
    grey, relief, detail = (Channel(c.value * weight, weight) for c in every)
    return grey, relief, detail


def band_pass(raster: Raster, fine: float, coarse: float) -> Channel:
    """Local mean over `fine` minus that over `coarse` cells, in local standard deviations."""
    seen = np.isfinite(raster).astype(np.float32)
    value = np.nan_to_num(raster)

    def blur(what: Raster, sigma: float) -> Raster:
        return cv2.GaussianBlur(what, (0, 0), sigma).astype(np.float32)

    density_fine = blur(seen, fine)
    density = np.maximum(blur(seen, coarse), 1e-6)
    weight = (density_fine > 0.1).astype(np.float32)  # noqa: PLR2004 - a tenth of the neighbours seen
    detail = blur(value, fine) / np.maximum(density_fine, 1e-6) - blur(value, coarse) / density
    detail *= weight
    around = np.maximum(blur(weight, coarse), 1e-6)
    spread = np.sqrt(blur(detail * detail, coarse) / around)
    value = np.clip(detail / np.maximum(spread, 1e-6), -CLIP, CLIP) * weight
    return Channel(value.astype(np.float32), weight)


def place_on(
    raster: Raster, cell_m: float, azimuth: float, north_m: float, east_m: float
) -> Raster:
    """A raster of the later view on the grid of the earlier one; NaN where not measured."""
    size = raster.shape[0]
    place = cv2.getRotationMatrix2D(((size - 1) / 2,) * 2, -float(np.degrees(azimuth)), 1.0)
    place[:, 2] = place[:, 2] + np.array([east_m, -north_m]) / cell_m
    return cv2.warpAffine(
        raster, place, (size, size), flags=cv2.INTER_NEAREST, borderValue=float("nan")
    ).astype(np.float32)
