"""Conjugates of image points in another view, by patches transformed over the local surface.

Another stop may see a Navcam patch rotated by up to 180 degrees, at another range and at another
grazing angle. The patch is therefore transformed by the homography H of its local surface
(`parallax_planes`), and both images are resampled to a common grid whose cells are as large as the
larger pixel of the two images in every direction, because detail can only be averaged: with J the
derivative of H, a pixel of the target covers the ellipse (J'J)^-1 of the source, and the grid is

    source = point + G grid,      G = V diag(sqrt(max(1, l_i))) V',      (J'J)^-1 = V diag(l_i) V'.

At 10 m a Navcam pixel covers 1 x 5 cm of ground; two stops whose views are at right angles have
square cells of 5 cm in common and nothing finer. On the grid the patch is found by normalised
cross-correlation inside a window; a second, nearly equal peak makes it ambiguous (Di et al. 2008,
section 5, require uniqueness). It is refined by least-squares matching (`least_squares`).

A conjugate found in the left image of a pair (`TieView`) is a tie once its parallax is known. The
dense parallax gives the local surface; the parallax itself is measured at the point, by
least-squares matching of the left patch in the right image over that surface, so that a tie is free
of the smoothing and pixel-locking of the dense matcher.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    Flags,
    Float32,
    Float64,
    GreyImage,
    ImagePoints,
    Mask,
    PerPoint,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.least_squares import fit_patches
from solmap.photogrammetry.matching.parallax_planes import (
    map_points,
    parallax_planes,
    stereo_homographies,
)
from solmap.photogrammetry.matching.records import MatchedPair
from solmap.photogrammetry.ranges import HalfWindow, PixelsOrZero, Share

CORNER_PX = 7
"""Side of the window whose gradients make a corner, pixels."""

PYRAMID_LEVELS = 5
"""Number of images, each half as wide as the one before."""
MOST_SAMPLES = 8
"""Most samples of a finer image, each way, whose mean is a cell of the grid."""

LARGEST_CELL_PX = 24.0
"""Most source pixels in a cell: a coarser one is not used."""

SMALLEST_SPREAD = 0.5
"""Least variation of a patch in grey values (DN): below it there is only rounding noise."""

STILL_MOVING = 0.2
"""Movement of a patch in the last iteration, in cells, above which it has not converged."""

LARGEST_Y_PX = 1.0
"""Vertical parallax above which a match in the right image is not the same point."""

DEFINED_PX = 0.02
"""Interest points define the tie; the only error is the resampling of their image."""

DENSE_AGREES_PX = 1.5
"""Largest difference between measured and dense parallax, plus three times the surface's
roughness."""

ITERATIONS = 6
"""Iterations of least-squares matching."""

LARGEST_SHIFT_PX = 2.5
"""Largest distance of the refined point from the correlation peak."""

LARGEST_STRETCH = 0.35
"""Largest change of the patch's shape by refinement."""


def image_pyramid(image: np.ndarray) -> list[np.ndarray]:
    """An image and its reductions, each the mean of 2 x 2 pixels of the one before."""
    pyramid = [np.ascontiguousarray(image, dtype=np.float32)]
    for _ in range(PYRAMID_LEVELS - 1):
        last = pyramid[-1]
        size = (last.shape[1] // 2, last.shape[0] // 2)
        pyramid.append(
            cv2.resize(
                last[: 2 * size[1], : 2 * size[0]], size, interpolation=cv2.INTER_AREA
            ).astype(np.float32)
        )
    return pyramid


@dataclass(frozen=True, slots=True)
class ConjugateParams:
    """Parameters of finding and refining conjugate points."""

    half_px: HalfWindow = 10
    """Half the patch: 21 x 21 cells of the common grid."""
    threshold: Share = 0.75
    """Least correlation after refinement. The paper's 0.8 is for one stereo pair."""
    ambiguity: Share = 0.92
    """Largest correlation of a second peak, as a fraction of the best."""
    sigma_floor_px: PixelsOrZero = 0.1
    """Lower limit of the standard deviation of least-squares matching."""
    parallax_floor_px: PixelsOrZero = 0.2
    """Lower limit for a measured parallax: 0.1-0.2 px on good texture, 0.32 px in JPL's test (NASA
    Tech Brief NPO-42487)."""

    def __post_init__(self) -> None:
        if not (self.half_px >= 3 and 0 < self.threshold < 1 and 0 < self.ambiguity <= 1):  # noqa: PLR2004
            raise MatchingError(
                "conjugates need a patch of 7 x 7 or more and thresholds in (0, 1), not half_px = "
                f"{self.half_px}, threshold = {self.threshold}, ambiguity = {self.ambiguity}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """An image to be searched for conjugates, with its pyramid."""

    image: GreyImage
    mask: Mask
    pyramid: list[np.ndarray] = field(default_factory=list)

    @classmethod
    def of(cls, image: GreyImage, mask: Mask) -> View:
        """A view with its pyramid made."""
        return cls(image, mask, image_pyramid(image))


@dataclass(frozen=True, slots=True, eq=False)
class Conjugates:
    """Results for n source points; rows not `found` are undefined."""

    found: Flags
    points: ImagePoints
    """Points in the target image."""
    sigma_px: PerPoint
    """Root mean square over both axes of the target."""
    correlation: PerPoint
    spread: Float64[np.ndarray, "n 2 2"]
    """A cell's standard deviation, along each axis of the common grid, in pixels of the target."""


@dataclass(frozen=True, eq=False)
class TieView:
    """A matched pair with precomputed data for finding ties."""

    pair: MatchedPair

    @cached_property
    def left(self) -> View:
        """The left image."""
        return View.of(self.pair.left, self.pair.left_mask)

    @cached_property
    def right(self) -> View:
        """The right image, needed only where a tie was found in the left one."""
        return View.of(*self.pair.read_right())

    @property
    def geometry(self) -> EpipolarPair:
        """The pair's ideal stereo camera."""
        return self.pair.geometry

    @cached_property
    def corner_strength(self) -> GreyImage:
        """Smaller eigenvalue of the structure tensor where the parallax is known, 0 elsewhere."""
        strength = cv2.cornerMinEigenVal(self.left.image.astype(np.float32), CORNER_PX)
        return np.where(np.isfinite(self.pair.parallax) & self.left.mask, strength, np.float32(0))

    def corners(self, cell_px: int) -> ImagePoints:
        """The strongest corner of every whole cell of the left image that has one, pixels."""
        lines, samples = (n // cell_px for n in self.corner_strength.shape)
        part = self.corner_strength[: lines * cell_px, : samples * cell_px]
        cells = part.reshape(lines, cell_px, samples, cell_px).swapaxes(1, 2)
        flat = cells.reshape(lines, samples, -1)
        best, known = flat.argmax(axis=2), flat.max(axis=2) > 0
        row, col = np.nonzero(known)
        down, right = np.divmod(best[known], cell_px)
        return np.column_stack([col * cell_px + right, row * cell_px + down]).astype(np.float64)


def find_conjugates(
    source: View,
    target: View,
    points: ImagePoints,
    target_from_source: Float64[np.ndarray, "n 3 3"],
    reach: int,
    params: ConjugateParams,
) -> Conjugates:
    """Conjugates of source points within `reach` cells of their images on the common grid."""
    grid = common_grids(points, target_from_source)
    usable = np.isfinite(grid).all(axis=(1, 2))
    half, width, n = params.half_px, params.half_px + reach + 3, len(points)
    templates = np.zeros((n, 2 * half + 1, 2 * half + 1), np.float32)
    searches = np.zeros((n, 2 * width + 1, 2 * width + 1), np.float32)
    for k in np.flatnonzero(usable):
        template = _patch(source, grid[k], half)
        search = (
            None if template is None else _patch(target, target_from_source[k] @ grid[k], width)
        )
        usable[k] = search is not None
        if template is not None and search is not None:
            templates[k], searches[k] = template, search
    found, offset, sigma, correlation = match_patches(templates, searches, usable, params)
    conjugate, derivative = map_points(target_from_source @ grid, offset)
    spread = derivative * sigma[:, None, None]
    found &= np.isfinite(conjugate).all(axis=1)
    mean = np.sqrt((spread**2).sum(axis=(1, 2)) / 2)
    return Conjugates(found, conjugate, mean, correlation, spread)


def match_patches(
    templates: Float32[np.ndarray, "n a a"],
    searches: Float32[np.ndarray, "n b b"],
    usable: Flags,
    params: ConjugateParams,
) -> tuple[Flags, Float64[np.ndarray, "n 2"], PerPoint, PerPoint]:
    """(found, offset of column and row, its sigma, correlation) of templates in search patches.

    On every side, search patches are wider than templates by the reach and three more cells.
    """
    reach = (searches.shape[1] - templates.shape[1]) // 2 - 3
    offset, peak, second = _correlation_peaks(templates, searches, usable, reach)
    found = usable & (peak > params.threshold - 0.15) & (second < params.ambiguity * peak)
    offset, sigma, correlation, settled = _least_squares(templates, searches, offset, found, params)
    return found & settled & (correlation >= params.threshold), offset, sigma, correlation


def measure_parallax(
    view: TieView, points: ImagePoints, params: ConjugateParams
) -> tuple[PerPoint, PerPoint]:
    """(parallax, its standard deviation) at left image points; NaN where it cannot be measured."""
    parallax, sigma = np.full(len(points), np.nan), np.full(len(points), np.nan)
    if not len(points):
        return parallax, sigma
    planes = parallax_planes(view.pair.parallax, points, params.half_px)
    ok = planes.found & (planes.parallax_px > 0)
    some = planes.select(ok)
    found = find_conjugates(
        view.left,
        view.right,
        points[ok],
        stereo_homographies(points[ok], some),
        2,
        replace(params, ambiguity=1.0),
    )
    value = points[ok, 0] - found.points[:, 0]
    near = np.abs(value - some.parallax_px) < DENSE_AGREES_PX + 3 * some.residual_px
    level = np.abs(found.points[:, 1] - points[ok, 1]) < LARGEST_Y_PX
    good = found.found & near & level & (value > 0)
    parallax[np.flatnonzero(ok)[good]] = value[good]
    sigma[np.flatnonzero(ok)[good]] = np.maximum(found.sigma_px[good], params.parallax_floor_px)
    return parallax, sigma


def in_view(view: TieView, left: ImagePoints, margin_px: int) -> Flags:
    """Whether image points lie on usable pixels, away from the image border."""
    g = view.geometry
    with np.errstate(invalid="ignore"):
        inside = (
            (left[:, 0] >= margin_px)
            & (left[:, 0] <= g.samples - 1 - margin_px)
            & (left[:, 1] >= margin_px)
            & (left[:, 1] <= g.lines - 1 - margin_px)
        )
    usable = np.zeros(len(left), dtype=bool)
    col, row = np.round(left[inside]).astype(np.int64).T
    usable[inside] = view.left.mask[row, col]
    return usable


def common_grids(
    points: ImagePoints, target_from_source: Float64[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 3 3"]:
    """source_from_grid of every point, origin at the point; NaN where it has no image."""
    _, derivative = map_points(target_from_source, points)
    grids = np.tile(np.eye(3), (len(points), 1, 1))
    grids[:, :2, 2] = points
    good = np.isfinite(derivative).all(axis=(1, 2))
    good[good] = np.abs(np.linalg.det(derivative[good])) > 1e-4  # noqa: PLR2004 - seen edge-on
    footprint, axes = np.linalg.eigh(
        np.linalg.inv(np.swapaxes(derivative[good], 1, 2) @ derivative[good])
    )
    size = np.sqrt(np.maximum(footprint, 1.0))
    grids[good, :2, :2] = (axes * size[:, None, :]) @ np.swapaxes(axes, 1, 2)
    good[good] = size.max(axis=1) < LARGEST_CELL_PX
    grids[~good] = np.nan
    return grids


def _patch(view: View, image_from_grid: Float64[np.ndarray, "3 3"], half: int) -> GreyImage | None:
    """The view on a square grid around the origin, averaged to the grid's resolution.

    None where the middle of the patch is outside the image.
    """
    ring = np.array([[0, 0], [-1, -1], [1, -1], [1, 1], [-1, 1]]) * min(float(half), 8.0)
    on_image, derivative = map_points(np.broadcast_to(image_from_grid, (5, 3, 3)).copy(), ring)
    if not (np.isfinite(on_image).all() and _visible(view.mask, on_image)):
        return None
    steps = np.linalg.norm(derivative[0], axis=0)
    level = int(np.clip(np.floor(np.log2(max(float(steps.min()), 1.0))), 0, 4))
    across, down = (int(np.clip(round(s / 2**level), 1, MOST_SAMPLES)) for s in steps)
    size = 2 * half + 1
    grid_from_samples = np.array(
        [
            [1 / across, 0, -half + (1 / across - 1) / 2],
            [0, 1 / down, -half + (1 / down - 1) / 2],
            [0, 0, 1],
        ]
    )
    level_from_image = np.diag([0.5**level, 0.5**level, 1.0])
    level_from_image[:2, 2] = 0.5 * 0.5**level - 0.5
    drawn = cv2.warpPerspective(
        view.pyramid[level],
        level_from_image @ image_from_grid @ grid_from_samples,
        (size * across, size * down),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    if across > 1 or down > 1:
        drawn = cv2.resize(drawn, (size, size), interpolation=cv2.INTER_AREA)
    return drawn.astype(np.float32)


def _visible(mask: Mask, points: ImagePoints) -> bool:
    """Whether all points lie on usable pixels."""
    col, row = np.round(points).astype(np.int64).T
    lines, samples = mask.shape
    if (row < 0).any() or (col < 0).any() or (row >= lines).any() or (col >= samples).any():
        return False
    return bool(mask[row, col].all())


def _correlation_peaks(
    templates: Float32[np.ndarray, "n a a"],
    searches: Float32[np.ndarray, "n b b"],
    usable: Flags,
    reach: int,
) -> tuple[Float64[np.ndarray, "n 2"], PerPoint, PerPoint]:
    """(offset, coefficient) of the best peak and the coefficient of the second best one.

    The second best lies outside the main peak, which is as wide as a quarter of the patch.
    """
    n = len(templates)
    offset, peak, second = np.zeros((n, 2)), np.zeros(n), np.ones(n)
    lobe = max(templates.shape[1] // 4, 2)
    for k in np.flatnonzero(usable):
        if templates[k].std() < SMALLEST_SPREAD:
            continue
        surface = cv2.matchTemplate(searches[k][3:-3, 3:-3], templates[k], cv2.TM_CCOEFF_NORMED)
        i, j = np.unravel_index(int(np.argmax(surface)), surface.shape)
        peak[k] = surface[i, j]
        offset[k] = j - reach, i - reach
        surface[max(i - lobe, 0) : i + lobe + 1, max(j - lobe, 0) : j + lobe + 1] = -1
        second[k] = surface.max()
        if not (0 < i < surface.shape[0] - 1 and 0 < j < surface.shape[1] - 1):
            second[k] = 1.0  # a maximum on the border of the window is not a peak
    return offset, peak, second


def _least_squares(
    templates: Float32[np.ndarray, "n a a"],
    searches: Float32[np.ndarray, "n b b"],
    start: Float64[np.ndarray, "n 2"],
    chosen: Flags,
    params: ConjugateParams,
) -> tuple[Float64[np.ndarray, "n 2"], PerPoint, PerPoint, Flags]:
    """Least-squares matching of requested templates: (offset, sigma, correlation, converged)."""
    n = len(templates)
    offset, sigma, correlation = start.copy(), np.full(n, np.nan), np.zeros(n)
    settled = np.zeros(n, dtype=bool)
    k = np.flatnonzero(chosen)
    if not len(k):
        return offset, sigma, correlation, settled
    fits = fit_patches(templates[k], searches[k], start[k], ITERATIONS)
    offset[k], correlation[k] = fits.shift, fits.correlation
    sigma[k] = np.maximum(fits.sigma, params.sigma_floor_px)
    settled[k] = (
        (fits.last_step < STILL_MOVING)
        & (np.abs(fits.shift - start[k]).max(axis=1) <= LARGEST_SHIFT_PX)
        & (np.abs(fits.affine - np.eye(2)).max(axis=(1, 2)) <= LARGEST_STRETCH)
    )
    return offset, sigma, correlation, settled
