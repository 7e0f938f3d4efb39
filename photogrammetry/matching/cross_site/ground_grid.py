"""Heights and brightness of the ground around a stop, on a level grid.

Both are means over the facets that the dense parallax of all pairs determines well
(`kernels.sum_facets`).

**Detail** is the part of brightness that is alike under any sun: albedo. Cast shadows, which change
places with the sun, are left out; of the rest the logarithm is taken, so that a slowly varying
illumination is an addend, and its mean over 30 cm is subtracted. Shading by slopes remains. It is
reversed under opposite suns, which makes two stops less alike, but it displaces nothing: the
correlation of two slopes of the same relief is symmetric about zero shift. Correlation of shadows
is not.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    Float64,
    Int32,
    Mask,
    ObjectPoints,
    PerPoint,
    Raster,
    Vector3,
)
from solmap.photogrammetry.matching.cross_site.birds_eye import level_camera
from solmap.photogrammetry.matching.cross_site.kernels import sum_facets
from solmap.photogrammetry.matching.cross_site.light import mean_sun
from solmap.photogrammetry.matching.height_bias import (
    HeightBias,
    mean_of_known,
    metres_per_line,
)
from solmap.photogrammetry.matching.records import MatchedStop

LEAST_KNOWN = 0.15
"""Fraction of a Gaussian's weight on known cells."""

RELIEF_WAVE_M = 1.2
"""Relief is height minus its Gaussian mean of this standard deviation."""

DETAIL_M, DETAIL_WAVE_M = 0.05, 0.3
"""Standard deviations of the two Gaussian means of brightness whose difference is its detail."""

DETAIL_STEP = 2
"""Rows and columns from one point of detail to the next: at two standard deviations of its Gaussian
points have as much information as all cells."""

CONTRAST_M = 1.0
"""Standard deviation of the Gaussian over which the contrast of detail is made equal."""

SHADOW_WAVE_M = 0.6
"""Standard deviation of the Gaussian mean of brightness,"""

SHADOW = 0.35
"""below which by more than this, in natural logarithms, ground is in shadow."""

FAINT = 1e-3
"""Least contrast of detail, in natural logarithms."""

RELIEF_RANGE_M = 3.0, 6.0
"""Ground whose relief is measured for the height bias (`height_bias`),"""

RELIEF_BAND_M = 0.2, 0.4
"""standard deviations of the Gaussians between which it is measured,"""

LEAST_RELIEF = 1000
"""and the fewest cells of it: 2.5 m2."""

ROW = 1000
"""Row length in which points are interpolated: OpenCV's rasters are at most 32767 wide."""

Slopes = tuple[Raster, Raster]
"""Derivatives by north and east."""


@dataclass(frozen=True, eq=False)
class GroundGrid:
    """The ground around a stop in its level frame; row 0 is the northernmost, the rover central."""

    cell_m: float
    up: Raster
    """Metres above the rover origin; NaN where nothing was measured well."""
    mast_m: float
    """Height of the cameras above the rover origin."""
    scale_px_m: float
    """f B, and"""
    focal_px: float
    """f, of the pairs with the smallest f B."""
    sun: Vector3 | None = None
    """Mean direction towards the Sun in the axes of the LSL; None if not known."""
    brightness: Raster | None = None
    """Grey values over their median in each image; None if not known."""
    smoothed: dict[float, Raster] = field(default_factory=dict, init=False)
    _surfaces: dict[tuple[float, bool], Surface] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, stop: MatchedStop, cell_m: float, farthest_m: float) -> GroundGrid:
        """From everything nearer than `farthest_m` that the pairs of a stop measured well."""
        size = 2 * round(farthest_m / cell_m)
        total, grid = np.zeros((3, size * size)), (cell_m, size / 2 * cell_m, size)
        for pair in stop.pairs:
            rasters = pair.parallax, pair.left
            own = sum_facets(rasters, *level_camera(stop, pair), farthest_m, grid)
            known = own[0] > 0
            median = float(np.median(own[2, known] / own[0, known])) if known.any() else 1.0
            own[2] /= max(median, 1e-6)
            total += own
        weight, *sums = total.reshape(3, size, size)
        with np.errstate(invalid="ignore"):
            up, brightness = ((part / weight).astype(np.float32) for part in sums)
        shapes = [pair.geometry for pair in stop.pairs]
        coarsest = min(shapes, key=lambda g: g.focal_px * g.base_m)
        level = stop.lsl_from_rover.rotation @ coarsest.rover_from_pair.translation_m
        scale_px_m = coarsest.focal_px * coarsest.base_m
        mast_m = -float(level[2])
        return cls(cell_m, up, mast_m, scale_px_m, coarsest.focal_px, mean_sun(stop), brightness)

    @cached_property
    def expected_bias(self) -> HeightBias:
        """Prior of the height bias, by the relief of near ground."""
        half = self.up.shape[0] / 2 - 0.5
        along = (np.arange(self.up.shape[0]) - half) * self.cell_m
        distance = np.hypot(along[:, None], along[None, :])
        nearest, farthest = RELIEF_RANGE_M
        fine, coarse = (self.smooth(sigma_m) for sigma_m in RELIEF_BAND_M)
        relief = (fine - coarse)[(distance >= nearest) & (distance < farthest)]
        relief = relief[np.isfinite(relief)]
        if len(relief) < LEAST_RELIEF:
            return HeightBias.expected(float("nan"))
        return HeightBias.expected(float(np.sqrt(np.mean(relief**2, dtype=np.float64))))

    @cached_property
    def detail(self) -> Raster:
        """Small-scale brightness without shadows, its standard deviation 1; NaN where unknown."""
        if self.brightness is None:
            return np.full_like(self.up, np.nan)
        log = np.log(np.maximum(self.brightness, np.float32(FAINT)))
        log[self._shadows(log)] = np.nan
        fine, coarse = (self._mean(log, sigma_m) for sigma_m in (DETAIL_M, DETAIL_WAVE_M))
        detail = fine - coarse
        contrast = np.sqrt(self._mean(detail * detail, CONTRAST_M))
        return detail / np.maximum(contrast, np.float32(FAINT))

    def _shadows(self, log: Raster) -> Mask:
        """Cells in shadow or beside one."""
        with np.errstate(invalid="ignore"):
            dark = log < self._mean(log, SHADOW_WAVE_M) - np.float32(SHADOW)
        return cv2.dilate(dark.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0

    def _mean(self, raster: Raster, sigma_m: float) -> Raster:
        """Gaussian mean, NaN where it covers too little."""
        return mean_of_known(raster, sigma_m / self.cell_m, LEAST_KNOWN)

    def noise_m(self, distance_m: PerPoint, parallax_px: float) -> PerPoint:
        """Height error of level ground at this distance for an error of its parallax."""
        return parallax_px * self.mast_m / self.scale_px_m * distance_m

    def along_rays(self, places: ObjectPoints) -> ObjectPoints:
        """Displacement of positions, given from the rover, by a bias of parallax, metres/pixel."""
        from_mast = places + np.array([0.0, 0.0, self.mast_m])
        return np.linalg.norm(from_mast, axis=1)[:, None] * from_mast / self.scale_px_m

    def too_high_m(self, sigma_m: float) -> Raster:
        """Height bias of heights smoothed by a Gaussian, for one line of b."""
        half = self.up.shape[0] / 2 - 0.5
        east = ((np.arange(self.up.shape[1]) - half) * self.cell_m).astype(np.float32)
        up = self.smooth(sigma_m)
        return self._mean(metres_per_line(up, -east, east, self.mast_m, self.focal_px), sigma_m)

    def smooth(self, sigma_m: float) -> Raster:
        """Heights smoothed by a Gaussian, NaN where it covers too little."""
        if sigma_m not in self.smoothed:
            self.smoothed[sigma_m] = self._mean(self.up, sigma_m)
        return self.smoothed[sigma_m]

    def surface(self, sigma_m: float, *, relief: bool) -> Surface:
        """Heights smoothed by a Gaussian, or only their relief; computed once."""
        key = sigma_m, relief
        if key not in self._surfaces:
            heights = self.smooth(sigma_m)
            shape = heights - self.smooth(RELIEF_WAVE_M) if relief else heights
            points = self.points(heights, max(1, round(sigma_m / self.cell_m)))
            self._surfaces[key] = Surface.of(self, shape, points)
        return self._surfaces[key]

    def brightness_surface(self, sigma_m: float) -> Surface:
        """Detail of brightness, with points where heights smoothed by a Gaussian are known too."""
        heights = np.where(np.isfinite(self.detail), self.smooth(sigma_m), np.float32(np.nan))
        return Surface.of(self, self.detail, self.points(heights, DETAIL_STEP))

    def at(self, raster: Raster, places: ObjectPoints) -> PerPoint:
        """Values of a raster on this grid at positions of the level frame, NaN where unknown."""
        if not len(places):
            return np.zeros(0)
        half, size = self.up.shape[0] / 2 - 0.5, -(-len(places) // ROW) * ROW
        col = np.resize(places[:, 1] / self.cell_m + half, size).astype(np.float32)
        row = np.resize(half - places[:, 0] / self.cell_m, size).astype(np.float32)
        value = cv2.remap(
            raster, col.reshape(-1, ROW), row.reshape(-1, ROW), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
        )  # fmt: skip
        return value.ravel()[: len(places)].astype(np.float64)

    def both_at(self, rasters: Slopes, places: ObjectPoints) -> Float64[np.ndarray, "n 2"]:
        """Values of two rasters."""
        return np.column_stack([self.at(raster, places) for raster in rasters])

    def points(self, heights: Raster, step: int) -> ObjectPoints:
        """Positions of known heights, of every n-th row and column."""
        row, col = np.nonzero(np.isfinite(heights[::step, ::step]))
        row, col, half = step * row, step * col, heights.shape[0] / 2 - 0.5
        north, east = (half - row) * self.cell_m, (col - half) * self.cell_m
        return np.column_stack([north, east, -heights[row, col].astype(np.float64)])


def blocks_of(places: ObjectPoints, side_m: float) -> Int32[np.ndarray, " n"]:
    """Number of the square block of ground, of a side in metres, in which each place lies.

    From 0 on, without gaps. Places are (n, 3) or (n, 2), north and east first, metres.
    """
    square = np.floor(places[:, :2] / side_m).astype(np.int64) @ (10_000, 1)
    return np.unique(square, return_inverse=True)[1].ravel().astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A raster of a stop's ground to be compared: its heights, their relief, or detail."""

    shape: Raster
    slopes: Slopes
    points: ObjectPoints
    """Positions of n of its cells in the level frame,"""
    values: PerPoint
    """its values there,"""
    point_slopes: Float64[np.ndarray, "n 2"]
    """and its derivatives by north and east."""

    @classmethod
    def of(cls, grid: GroundGrid, shape: Raster, points: ObjectPoints) -> Surface:
        """With its derivatives, by central differences."""
        south, east = np.gradient(shape)
        slopes = -south / grid.cell_m, east / grid.cell_m
        return cls(shape, slopes, points, grid.at(shape, points), grid.both_at(slopes, points))
