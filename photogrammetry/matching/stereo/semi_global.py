"""Semi-global matching of locally normalised images about the parallax plane of the ground.

**Normalisation.** Each pixel is replaced by its difference from the mean of its surroundings in
units of their standard deviation, (I - m) / sqrt(s^2 + (k n)^2), with the noise n of the image in
the denominator, so that faint texture of a 12-bit image fills eight bits, but noise, as in the sky,
does not. The noise is estimated from second differences (Immerkær 1996), by their median absolute
value, so that edges do not count.

**Matching in both directions.** OpenCV's StereoSGBM (after Hirschmüller 2008) minimises the
Birchfield-Tomasi difference over small blocks plus a penalty P1 for parallax steps of one pixel and
P2 for larger ones along three paths. Its penalties have the proportion of its authors, 8 and 32
times the area of the block. Slopes are limited, so that an outline, which belongs to the nearer
surface, does not affect the ground beside it.

**Search about the plane of the ground.** Seen from a mast, level or tilted ground has a parallax
that is linear over the image: with the plane n.P = h and P = Z ((x - c_x)/f, (y - c_y)/f, 1) one
finds p = f B / Z = a + b x + c y. After subtraction of that plane, relief remains, whose range is a
fraction of the whole. So the pair is first matched in a reduced image, over the whole range; a
plane is fitted to the result by least absolute deviations; and the full image is matched against
the right image shifted by the plane, over the range of the relief only. Besides saving time, this
makes the ground parallel to the image, which semi-global matching favours. Where relief is most of
the search range, as indoors, there is no such plane, and the images are matched without it.

The plane also gives the angle a at which the ground is seen. With p = p_0 + g_x x + g_y y about the
principal point and the ray r = (x/f, y/f, 1), sin a = p / (|(f g_x, f g_y, p_0)| |r|).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import EightBits, Float32, GreyImage, Mask, ParallaxMap
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.matching.kernels import fixed_point, local_contrast, mutual_parallax
from solmap.photogrammetry.matching.parallax_planes import ParallaxPlane, fit_robust_plane
from solmap.photogrammetry.ranges import CountOrZero, OddPixels, Percent, Pixels, PixelsOrZero

CONTRAST = 75.0
"""Grey levels of eight bits per local standard deviation: the range is 1.7 to either side."""

NOISE_FLOOR = 2.0
"""Standard deviations of noise treated as no contrast."""

FIXED_POINT = 16
"""OpenCV's parallaxes are whole sixteenths of a pixel."""

REDUCED_SEARCH_PX = 128
"""Widest search in the reduced image; the image is halved until the range fits."""

SLOPE_CAP = 31
"""Largest slope that counts, in eight bits and eighths of a level per pixel (Sobel operator)."""

WORTHWHILE = 0.5
"""Fraction of the whole search above which relief makes the plane useless."""

MARGIN_PX = 3
"""Pixels of the reduced image added to either end of the range of relief."""

WHOLLY = 0.99
"""Fraction of a shifted pixel that must come from usable ones."""

FIT_POINTS = 20_000
"""Points to which the plane is fitted; more do not change it."""

GRAZING = 0.25
"""Sine of the angle to the ground below which its rows are far ground: 6 m from a mast."""

LEVEL = (np.float32(0), np.float32(0))
"""Gradient of the parallax of a wall in front of the cameras."""


@dataclass(frozen=True, slots=True)
class SemiGlobalParams:
    """How parallaxes are found before refinement."""

    block_px: OddPixels = 5
    """Side of the block, odd: small, so that depth edges stay sharp; 3 to 11 by OpenCV."""
    uniqueness_percent: Percent = 40
    """Margin by which the best cost must win, in both directions. Of the additional parallaxes kept
    at 25, a sixth is wrong by more than 1 px on rendered ground and a third in Middlebury's
    motorcycle: ten times as many as of the rest."""
    agreement_px: PixelsOrZero = 1.0
    """Largest difference between the parallax from left to right and from right to left."""
    smallest_surface_px: CountOrZero = 100
    """Patches of fewer pixels are speckle: 50 to 200 by OpenCV."""
    surface_step_px: Pixels = 1.5
    """Step of parallax between neighbours of one surface: steep rock faces reach about one."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedImage:
    """Grey values in units of their local contrast; 0 where not usable."""

    grey: GreyImage
    mask: Mask


def rough_parallax(
    left: NormalisedImage,
    right: NormalisedImage,
    search: tuple[int, int],
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Semi-global parallax of locally normalised images."""
    halvings = max(1, int(np.ceil(np.log2((search[1] - search[0]) / REDUCED_SEARCH_PX))))
    scale = 2**halvings
    reduced = _reduced_parallax(left, right, search, scale, params)
    if not np.isfinite(reduced).any():
        return np.full(left.grey.shape, np.nan, np.float32)
    plane, relief = _plane_and_relief(reduced, scale)
    if relief[1] - relief[0] < WORTHWHILE * (search[1] - search[0]):
        parallax = _match_about(plane, relief, left, right, params)
    else:
        images = to_eight_bit(left.grey), to_eight_bit(right.grey)
        parallax = match_both_ways(*images, (left.mask, right.mask), search, params)
    within = (parallax >= search[0]) & (parallax <= search[1])
    return np.where(within, parallax, np.float32(np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class GroundView:
    """How the ground of a left image is seen, by the plane of its parallax."""

    gradient: tuple[np.float32, np.float32]
    """Change of its parallax along a row, and from a row to the next one."""
    sine: Float32[np.ndarray, " lines"]
    """Of the angle to it, for every row; 1 where there is no ground."""

    @property
    def far_lines(self) -> int:
        """Rows from the top of the image in which the ground is seen at a grazing angle."""
        return int((self.sine < GRAZING).sum())


def view_of_ground(parallax: ParallaxMap, geometry: EpipolarPair) -> GroundView:
    """How the ground is seen; as a wall in front of the cameras where there is none."""
    wall = GroundView(LEVEL, np.ones(parallax.shape[0], np.float32))
    line, sample = np.nonzero(np.isfinite(parallax))
    if not len(line):
        return wall
    some = slice(None, None, max(1, len(line) // FIT_POINTS))
    points = np.column_stack([sample[some], line[some]]).astype(np.float64)
    plane = fit_robust_plane(points, parallax[line[some], sample[some]].astype(np.float64))
    f, (x, y) = geometry.focal_px, geometry.centre_px
    lines = np.arange(geometry.lines)
    at_lines = plane.parallax_px(np.full(len(lines), x), lines)
    at_centre = plane.at + plane.per_sample * x + plane.per_line * y
    normal = np.linalg.norm([f * plane.per_sample, f * plane.per_line, at_centre])
    sine = at_lines / normal / np.hypot(1, (lines - y) / f)
    if plane.per_line <= 0:
        return wall
    gradient = np.float32(plane.per_sample), np.float32(plane.per_line)
    return GroundView(gradient, np.clip(sine, 0, 1).astype(np.float32))


def noise_level(image: GreyImage, mask: Mask) -> float:
    """Standard deviation of the noise of a grey value, where texture does not hide it.

    The twentieth of all blocks with the least texture is used, because ground is textured nearly
    everywhere. Where even these are textured, the noise is overestimated.
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    rough = cv2.filter2D(image, -1, kernel)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if not inner.any():
        return 0.0
    np.abs(rough, out=rough)
    rough[~inner] = 0
    blocks, share = (cv2.blur(one, (17, 17)) for one in (rough, inner.astype(np.float32)))
    np.divide(blocks, np.maximum(share, 1e-6, out=share), out=blocks)
    return float(np.sqrt(np.pi / 2) * np.percentile(blocks[inner][::7], 5))


def normalise_locally(image: GreyImage, mask: Mask, window_px: int) -> NormalisedImage:
    """Distance of each pixel from its local mean, in local standard deviations."""
    size = (window_px, window_px)
    noise = noise_level(image, mask)
    share = np.maximum(cv2.blur(mask.astype(np.float32), size), np.float32(1e-6))
    centre = float(image[mask].mean()) if mask.any() else 0.0
    grey = np.where(mask, image - np.float32(centre), np.float32(0))
    floor = np.float32((NOISE_FLOOR * noise) ** 2 + 1e-12)
    means = (cv2.blur(grey, size), cv2.blur(grey * grey, size))
    return NormalisedImage(local_contrast(grey, *means, share, mask, floor), mask)


def to_eight_bit(normalised: GreyImage) -> EightBits:
    """Normalised grey values about 128."""
    return cv2.convertScaleAbs(np.clip(normalised * CONTRAST + 128, 0, 255))


def match_both_ways(
    left: EightBits,
    right: EightBits,
    masks: tuple[Mask, Mask],
    search: tuple[int, int],
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Parallax on the left grid where both directions agree; `search` is its range."""
    forth = _match(left, right, search, params)
    back = _match(left=right[:, ::-1], right=left[:, ::-1], search=search, params=params)[:, ::-1]
    forth = np.where(masks[0], forth, np.float32(np.nan))
    back = np.where(masks[1], back, np.float32(np.nan))
    agreeing = mutual_parallax(forth, back, np.float32(params.agreement_px))
    return remove_speckle(agreeing, params)


def remove_speckle(parallax: ParallaxMap, params: SemiGlobalParams) -> ParallaxMap:
    """The parallaxes that belong to surfaces of some size."""
    gap = -32_000
    fixed = fixed_point(parallax, np.float32(FIXED_POINT), gap)
    cv2.filterSpeckles(
        fixed, gap, params.smallest_surface_px, round(params.surface_step_px * FIXED_POINT)
    )
    return np.where(fixed == gap, np.float32(np.nan), parallax)


def _match(
    left: EightBits, right: EightBits, search: tuple[int, int], params: SemiGlobalParams
) -> ParallaxMap:
    """OpenCV's parallax from left to right; NaN where it found none.

    OpenCV omits the columns whose search would leave the image; hence the borders.
    """
    least, largest = search
    count = max(16, 16 * int(np.ceil((largest - least + 1) / 16)))
    before, after = max(0, least + count), max(0, -least)
    padded = [
        cv2.copyMakeBorder(np.ascontiguousarray(image), 0, 0, before, after, cv2.BORDER_REPLICATE)
        for image in (left, right)
    ]
    area = params.block_px**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=count,
        blockSize=params.block_px,
        P1=8 * area,
        P2=32 * area,
        preFilterCap=SLOPE_CAP,
        uniquenessRatio=params.uniqueness_percent,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed = matcher.compute(*padded)[:, before : before + left.shape[1]]
    found = fixed >= least * FIXED_POINT
    return np.where(found, fixed.astype(np.float32) / FIXED_POINT, np.float32(np.nan))


def _reduced_parallax(
    left: NormalisedImage,
    right: NormalisedImage,
    search: tuple[int, int],
    scale: int,
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Parallax of the reduced pair, in pixels of the full one."""
    images: list[EightBits] = []
    masks: list[Mask] = []
    for image, mask in ((left.grey, left.mask), (right.grey, right.mask)):
        size = (-(-image.shape[1] // scale) * scale, -(-image.shape[0] // scale) * scale)
        border = (0, size[1] - image.shape[0], 0, size[0] - image.shape[1])
        whole = cv2.copyMakeBorder(image, *border, cv2.BORDER_REPLICATE)
        known = cv2.copyMakeBorder(mask.astype(np.float32), *border, cv2.BORDER_CONSTANT, value=0)
        small = (size[0] // scale, size[1] // scale)
        images.append(to_eight_bit(cv2.resize(whole, small, interpolation=cv2.INTER_AREA)))
        masks.append(cv2.resize(known, small, interpolation=cv2.INTER_AREA) > 0.5)  # noqa: PLR2004
    reduced_search = (int(np.floor(search[0] / scale)), int(np.ceil(search[1] / scale)))
    found = match_both_ways(images[0], images[1], (masks[0], masks[1]), reduced_search, params)
    return found * np.float32(scale)


def _plane_and_relief(reduced: ParallaxMap, scale: int) -> tuple[ParallaxPlane, tuple[int, int]]:
    """The plane through the parallaxes, and the range of their deviations from it."""
    line, sample = np.nonzero(np.isfinite(reduced))
    parallax = reduced[line, sample].astype(np.float64)
    x, y = (sample + 0.5) * scale - 0.5, (line + 0.5) * scale - 0.5
    some = slice(None, None, max(1, len(x) // FIT_POINTS))
    plane = fit_robust_plane(np.column_stack([x[some], y[some]]), parallax[some])
    relief = parallax - plane.parallax_px(x, y)
    margin = MARGIN_PX * scale
    return plane, (
        int(np.floor(relief.min())) - margin,
        int(np.ceil(relief.max())) + margin,
    )


def _match_about(
    plane: ParallaxPlane,
    relief: tuple[int, int],
    left: NormalisedImage,
    right: NormalisedImage,
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Parallax of the full images, searched within the relief above and below the plane.

    With R'(x) = R(x - t(x)) the shifted right image and d the parallax between L and R', the
    partner of x is x - d - t(x - d).
    """
    grid = np.indices(left.grey.shape, dtype=np.float32)
    lines, samples = grid[0], grid[1]
    shifted = (samples - plane.parallax_px(samples, lines)).astype(np.float32)
    image = cv2.remap(right.grey, shifted, lines, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    known = cv2.remap(
        right.mask.astype(np.float32),
        shifted,
        lines,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
    )
    d = match_both_ways(
        to_eight_bit(left.grey),
        to_eight_bit(image),
        (left.mask, known > WHOLLY),
        relief,
        params,
    )
    return (d + plane.parallax_px(samples - d, lines)).astype(np.float32)
