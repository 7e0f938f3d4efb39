"""Finds the conjugate of an image point in another view, by a patch carried over the local surface.

Between stops a Navcam patch is seen turned by up to 180 degrees, at another range and at another
grazing angle. The patch is therefore carried through the homography H of its local surface
(`local_surface`), and both images are drawn on a common grid whose cells are as large as the pixel
of either image in every direction, because detail can be averaged but not made up: with J the
derivative of H, a pixel of the target covers the ellipse (J'J)^-1 of the source, and the grid is

    source = point + G grid,      G = V diag(sqrt(max(1, l_i))) V',      (J'J)^-1 = V diag(l_i) V'.

At 10 m a Navcam pixel measures 1 x 5 cm on the ground; two stops that look at right angles to each
other see square cells of 5 cm in common and nothing finer. On the grid the patch is found by
normalised cross-correlation inside a window, which a second, nearly as good place makes ambiguous
(Di et al. 2008, section 5, ask for uniqueness), and refined by least-squares matching (Gruen 1985):
with grey values a of the template and b of the search image,

    a(x, y) + v = r_0 + r_1 b(A (x, y) + d),

solved for the shift d, the affine matrix A and the radiometry r_0, r_1. The standard deviation of
d is that of the adjustment, sigma0 sqrt(Q_dd), with as many observations as are independent.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from photogrammetry.arrays import Flags, Float32, Float64, GreyImage, ImagePoints, Mask, PerPoint
from photogrammetry.errors import MatchingError
from photogrammetry.matching.local_surface import image_pyramid, mapped

MOST_SAMPLES = 8
"""A cell of the grid is the mean of at most 8 x 8 samples of a finer image."""
LARGEST_CELL_PX = 24.0
"""A cell that covers more pixels of the source is too coarse to be of use there."""
SMALLEST_SPREAD = 0.5
"""Grey values (DN) by which a patch must vary: below it there is only noise of rounding."""


@dataclass(frozen=True, slots=True)
class ConjugateParams:
    """How conjugate points are found and refined."""

    half_px: int = 10
    """Half the patch: 21 x 21 cells of the common grid."""
    threshold: float = 0.75
    """Least correlation after refinement. The paper's 0.8 is for one stereo pair."""
    ambiguity: float = 0.92
    """A second place may correlate at most this well, as a share of the best."""
    iterations: int = 6
    largest_shift_px: float = 2.5
    """Refinement may not walk further from the correlation peak."""
    largest_stretch: float = 0.35
    """Refinement may not change the patch's shape more than this."""
    sigma_floor_px: float = 0.1
    """Least-squares matching is not better than this, whatever it says of itself."""
    parallax_floor_px: float = 0.2
    """Nor a measured parallax than this: 0.1-0.2 px on good texture, 0.32 px in JPL's test
    (NASA Tech Brief NPO-42487)."""

    def __post_init__(self) -> None:
        if not (self.half_px >= 3 and 0 < self.threshold < 1 and 0 < self.ambiguity <= 1):  # noqa: PLR2004
            raise MatchingError(
                "conjugates need a patch of 7 x 7 or more and thresholds in (0, 1), not half_px = "
                f"{self.half_px}, threshold = {self.threshold}, ambiguity = {self.ambiguity}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """An image to look for conjugates in, with its pyramid."""

    image: GreyImage
    mask: Mask
    pyramid: list[np.ndarray] = field(default_factory=list)

    @classmethod
    def of(cls, image: GreyImage, mask: Mask) -> View:
        """A view with its pyramid made."""
        return cls(image, mask, image_pyramid(image))


@dataclass(frozen=True, slots=True, eq=False)
class Conjugates:
    """What was found for n source points; rows not `found` hold no meaning."""

    found: Flags
    points: ImagePoints
    """In the target image."""
    sigma_px: PerPoint
    """Root mean square over both axes of the target."""
    correlation: PerPoint


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
    conjugate, derivative = mapped(target_from_source @ grid, offset)
    scale = np.sqrt((derivative**2).sum(axis=(1, 2)) / 2)
    found &= np.isfinite(conjugate).all(axis=1)
    return Conjugates(found, conjugate, sigma * scale, correlation)


def match_patches(
    templates: Float32[np.ndarray, "n a a"],
    searches: Float32[np.ndarray, "n b b"],
    usable: Flags,
    params: ConjugateParams,
) -> tuple[Flags, Float64[np.ndarray, "n 2"], PerPoint, PerPoint]:
    """(found, offset of column and row, its sigma, correlation) of templates in search patches.

    Search patches are wider than templates by the reach and three more cells on every side.
    """
    reach = (searches.shape[1] - templates.shape[1]) // 2 - 3
    offset, peak, second = _correlation_peaks(templates, searches, usable, reach)
    found = usable & (peak > params.threshold - 0.15) & (second < params.ambiguity * peak)
    offset, sigma, correlation, settled = _least_squares(templates, searches, offset, found, params)
    return found & settled & (correlation >= params.threshold), offset, sigma, correlation


def common_grids(
    points: ImagePoints, target_from_source: Float64[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 3 3"]:
    """source_from_grid of every point, origin at the point; NaN where it has no image."""
    _, derivative = mapped(target_from_source, points)
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

    None where the middle of the patch is not in the image.
    """
    ring = np.array([[0, 0], [-1, -1], [1, -1], [1, 1], [-1, 1]]) * min(float(half), 8.0)
    on_image, derivative = mapped(np.broadcast_to(image_from_grid, (5, 3, 3)).copy(), ring)
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
    """Whether all points fall on usable pixels."""
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
    """(offset, coefficient) of the best place and the coefficient of the second best one.

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
            second[k] = 1.0  # a peak on the rim of the window is no peak
    return offset, peak, second


def _least_squares(
    templates: Float32[np.ndarray, "n a a"],
    searches: Float32[np.ndarray, "n b b"],
    start: Float64[np.ndarray, "n 2"],
    wanted: Flags,
    params: ConjugateParams,
) -> tuple[Float64[np.ndarray, "n 2"], PerPoint, PerPoint, Flags]:
    """Least-squares matching of every wanted template: (offset, sigma, correlation, settled)."""
    n = len(templates)
    offset, sigma, correlation = start.copy(), np.full(n, np.nan), np.zeros(n)
    settled = np.zeros(n, dtype=bool)
    k = np.flatnonzero(wanted)
    if not len(k):
        return offset, sigma, correlation, settled
    half = templates.shape[1] // 2
    y, x = (g.ravel().astype(np.float64) for g in np.mgrid[-half : half + 1, -half : half + 1])
    a = templates[k].reshape(len(k), -1).astype(np.float64)
    affine = np.tile(np.array([1.0, 0.0, 0.0, 1.0]), (len(k), 1))
    shift = start[k].copy()
    for _ in range(params.iterations):
        b, bx, by = _sampled(searches[k], shift, affine, x, y)
        design = np.stack([bx, by, bx * x, bx * y, by * x, by * y, b, np.ones_like(b)], axis=-1)
        gain = (a.std(axis=1) / np.maximum(b.std(axis=1), 1e-6))[:, None]
        design[:, :, :6] *= gain[:, :, None]
        scale = np.maximum(np.sqrt((design**2).mean(axis=1, keepdims=True)), 1e-9)
        scaled = design / scale
        normal = np.swapaxes(scaled, 1, 2) @ scaled + 1e-6 * len(x) * np.eye(8)
        solution = np.linalg.solve(normal, np.swapaxes(scaled, 1, 2) @ a[:, :, None])
        step = solution[:, :, 0] / scale[:, 0]
        shift += np.clip(step[:, :2], -1, 1)
        affine += np.clip(step[:, 2:6], -0.2, 0.2)
    residual = a - (design @ step[:, :, None])[:, :, 0]
    sigma0 = np.sqrt((residual**2).sum(axis=1) / (len(x) - 8))
    q = np.linalg.inv(normal)
    variance = np.maximum(q[:, 0, 0] / scale[:, 0, 0] ** 2, q[:, 1, 1] / scale[:, 0, 1] ** 2)
    offset[k] = shift
    kinship = _correlated(residual.reshape(len(k), 2 * half + 1, 2 * half + 1))
    sigma[k] = np.maximum(sigma0 * np.sqrt(variance * kinship), params.sigma_floor_px)
    b, _, _ = _sampled(searches[k], shift, affine, x, y)
    centred_a, centred_b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    norm = np.sqrt((centred_a**2).sum(axis=1) * (centred_b**2).sum(axis=1))
    correlation[k] = (centred_a * centred_b).sum(axis=1) / np.maximum(norm, 1e-9)
    settled[k] = (
        (np.abs(step[:, :2]).max(axis=1) < 0.2)  # noqa: PLR2004 - still moving: not converged
        & (np.abs(shift - start[k]).max(axis=1) <= params.largest_shift_px)
        & (np.abs(affine - (1, 0, 0, 1)).max(axis=1) <= params.largest_stretch)
    )
    return offset, sigma, correlation, settled


def _correlated(residuals: Float64[np.ndarray, "n a a"]) -> PerPoint:
    """How many neighbouring residuals count as one, by their correlation at a distance of one.

    Smeared and interpolated patches leave residuals that go up and down together; for residuals of
    first order (1 + r) / (1 - r) of them, along each axis, say what one says.
    """
    power = np.maximum((residuals**2).mean(axis=(1, 2)), 1e-12)
    along = (residuals[:, :, 1:] * residuals[:, :, :-1]).mean(axis=(1, 2)) / power
    down = (residuals[:, 1:] * residuals[:, :-1]).mean(axis=(1, 2)) / power
    along, down = (np.clip(r, 0.0, 0.9) for r in (along, down))
    return (1 + along) / (1 - along) * (1 + down) / (1 - down)


def _sampled(
    searches: Float32[np.ndarray, "n b b"],
    shift: Float64[np.ndarray, "n 2"],
    affine: Float64[np.ndarray, "n 4"],
    x: Float64[np.ndarray, " m"],
    y: Float64[np.ndarray, " m"],
) -> tuple[Float64[np.ndarray, "n m"], Float64[np.ndarray, "n m"], Float64[np.ndarray, "n m"]]:
    """Grey values of the search images on the moved grid, and their derivatives."""
    n, size, _ = searches.shape
    middle = (size - 1) / 2
    at_x = shift[:, :1] + affine[:, :1] * x + affine[:, 1:2] * y + middle
    at_y = shift[:, 1:] + affine[:, 2:3] * x + affine[:, 3:4] * y + middle
    at_x, at_y = (np.clip(v, 1.0, size - 2.001) for v in (at_x, at_y))
    left, top = np.floor(at_x).astype(np.int64), np.floor(at_y).astype(np.int64)
    u, v = at_x - left, at_y - top
    flat = searches.reshape(-1)
    base = np.arange(n)[:, None] * size * size + top * size + left
    b00, b01, b10, b11 = (flat[base + o].astype(np.float64) for o in (0, 1, size, size + 1))
    value = (b00 * (1 - u) + b01 * u) * (1 - v) + (b10 * (1 - u) + b11 * u) * v
    along = (b01 - b00) * (1 - v) + (b11 - b10) * v
    down = (b10 - b00) * (1 - u) + (b11 - b01) * u
    return value, along, down
