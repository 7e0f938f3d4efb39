"""Intra-stereo matches of interest points (Di et al. 2008, sections 3.1 and 5).

Interest points of both epipolar images are compared along the epipolar line by the normalised
cross-correlation of their windows; two points that are each other's best match and correlate above
a threshold are a candidate. Candidates are verified by the parallax curve, refined by least-squares
matching, and thinned by a grid, so that they are spread over the image.

Least squares finds the parallax of the plane that fits the window best. The ground at its middle
deviates from that plane, by far more than the noise of the plane where the texture is good. The
deviation is estimated by matching the same points again with windows of half the width: beyond
noise,

    e^2 = (p_half - p)^2 - (sigma_half^2 - sigma^2)

is the relief that the whole window averages out and the half one does not (the difference of an
estimate from part of the data and one from all of it has the difference of their variances). Ground
is rough at every scale, its height differences growing with distance like d^H; relief below the
half window is e^2 times 2^-2H, and so on, in total e^2 / (1 - 2^-2H) = 2 e^2 with H = 1/2 (between
rubble and rolling plains). A single difference is a poor estimate of its expectation, so those of
neighbours are included.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import KDTree

from solmap.photogrammetry.arrays import (
    Flags,
    Float32,
    GreyImage,
    ImagePoints,
    Int32,
    PerPoint,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.imagery import StereoMatches
from solmap.photogrammetry.matching.kernels import correlate
from solmap.photogrammetry.matching.least_squares import (
    LeastSquaresMatcher,
    LeastSquaresParams,
    RefinedParallax,
)
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.resampling import windows_at
from solmap.photogrammetry.matching.stereo.interest_points import (
    FoerstnerParams,
    InterestPoints,
    interest_points,
    strongest_by_cell,
)
from solmap.photogrammetry.matching.stereo.verification import (
    VerificationParams,
    agrees_with_terrain,
)
from solmap.photogrammetry.ranges import (
    Few,
    FewOrZero,
    NearestMetres,
    OddPixels,
    Parallax,
    Pixels,
    Share,
    WholePixels,
)
from solmap.photogrammetry.robust import MAD_TO_SIGMA

BELOW_HALF = 2.0
"""Ratio of the relief below the whole window to that between the half and the whole one, H =
1/2."""

LARGEST_PX = 1.0
"""Limit of the difference: more is a blunder of the half window."""


RELIEF_NEIGHBOURS = 25
"""Neighbouring matches whose median difference gives the relief: accurate to a fifth."""


OWN_WEIGHT = 0.15
"""Weight of a match's own difference against that median: one sample against about six, because the
relief of neighbours differs by half."""


@dataclass(frozen=True, slots=True)
class SparseParams:
    """How interest points of a pair are matched; defaults by Di et al. 2008, section 5."""

    interest: FoerstnerParams = field(default_factory=FoerstnerParams)
    window_px: OddPixels = 15
    """Side of the correlation window, odd."""
    least_correlation: Share = 0.8
    """Threshold of the normalised cross-correlation."""
    line_tolerance_px: FewOrZero = 1
    """Rows above and below the epipolar line: maxima of the operator are whole pixels."""
    nearest_range_m: NearestMetres = 1.2
    """Nearest ground: below a 1.5 m mast, just clear of the deck and wheels. Limits the search."""
    least_parallax_px: Parallax = -2.0
    """Parallax of infinity minus the effect of a rig error of 0.1 degrees."""
    verification: VerificationParams = field(default_factory=VerificationParams)
    refinement: LeastSquaresParams = field(default_factory=LeastSquaresParams)
    largest_sigma_px: Pixels = 0.3
    """Largest standard deviation that is kept: at 10 m it is 0.12 m of Navcam range."""
    cell_px: WholePixels = 32
    """Cell of the grid in which the best matches are chosen."""
    per_cell: Few = 4
    """Matches per cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Interest points that are each other's best match, before and after verification."""

    left: Int32[np.ndarray, "n 2"]
    right: Int32[np.ndarray, "n 2"]
    correlation: PerPoint
    accepted: Flags

    def __len__(self) -> int:
        return len(self.left)


def largest_parallax_px(geometry: EpipolarPair, nearest_range_m: float) -> float:
    """Parallax at the nearest range, but not more than the image is wide."""
    return min(geometry.focal_px * geometry.base_m / nearest_range_m, geometry.samples - 1.0)


def match_sparsely(
    pair_id: str, images: EpipolarImages, params: SparseParams | None = None
) -> StereoMatches:
    """Verified, refined and evenly spread matches of a pair."""
    params = params or SparseParams()
    candidates = match_interest_points(images, params)
    return refine_candidates(pair_id, images, candidates, params)


def points_of_pair(
    images: EpipolarImages, params: SparseParams
) -> tuple[InterestPoints, InterestPoints]:
    """Interest points of both images, with correlation windows inside them."""
    margin = params.window_px // 2 + 1
    left = interest_points(images.left, images.left_mask, params.interest, margin)
    return left, interest_points(images.right, images.right_mask, params.interest, margin)


def match_interest_points(
    images: EpipolarImages,
    params: SparseParams,
    points: tuple[InterestPoints, InterestPoints] | None = None,
) -> Candidates:
    """Mutually best pairs of interest points, each tested by the parallax curve.

    Args:
        images: The pair.
        params: Parameters of matching.
        points: Those of `points_of_pair`, if they are known.
    """
    left, right = points or points_of_pair(images, params)
    a, b = _pairs_on_a_line(left, right, images.geometry, params)
    correlation = correlate(
        _windows(images.left, left.pixels, params.window_px),
        _windows(images.right, right.pixels, params.window_px),
        a,
        b,
    )
    best = _mutual_best(a, b, correlation, params.least_correlation)
    from_left, from_right = left.pixels[a[best]], right.pixels[b[best]]
    parallax = (from_left[:, 0] - from_right[:, 0]).astype(np.float64)
    accepted = agrees_with_terrain(from_left.astype(np.float64), parallax, params.verification)
    return Candidates(from_left, from_right, correlation[best].astype(np.float64), accepted)


def refine_candidates(
    pair_id: str, images: EpipolarImages, candidates: Candidates, params: SparseParams
) -> StereoMatches:
    """Accepted candidates with sub-pixel parallax, the precise ones, spread over a grid."""
    pixels = candidates.left[candidates.accepted]
    start = (pixels[:, 0] - candidates.right[candidates.accepted, 0]).astype(np.float64)
    matcher = LeastSquaresMatcher(images.left, images.right, params.refinement)
    refined = matcher.refine(pixels, start)
    sigma_px = sigma_with_relief(matcher, pixels.astype(np.float64), refined)
    good = refined.settled & (sigma_px <= params.largest_sigma_px)
    good &= (refined.correlation >= params.least_correlation) & (
        refined.parallax_px > max(params.least_parallax_px, 0.0)
    )
    points, parallax, sigma = (
        values[good] for values in (pixels.astype(float), refined.parallax_px, sigma_px)
    )
    good = agrees_with_terrain(points, parallax, params.verification)
    points, parallax, sigma = points[good], parallax[good], sigma[good]
    cells = int(np.prod(np.ceil(np.array(images.left.shape) / params.cell_px)))
    kept = np.sort(strongest_by_cell(points, -sigma, params.cell_px, cells * params.per_cell))
    kept = kept[_rank_within_cell(points[kept], -sigma[kept], params.cell_px) < params.per_cell]
    return StereoMatches(pair_id, points[kept], parallax[kept], sigma[kept])


def _rank_within_cell(points: ImagePoints, strength: np.ndarray, cell_px: int) -> np.ndarray:
    cell = np.floor(points / cell_px).astype(np.int64)
    order = np.lexsort((-strength, cell[:, 0], cell[:, 1]))
    ordered = cell[order]
    starts = np.ones(len(order), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    position = np.arange(len(order))
    rank = np.empty(len(order), np.int64)
    rank[order] = position - np.maximum.accumulate(np.where(starts, position, 0))
    return rank


def _pairs_on_a_line(
    left: InterestPoints, right: InterestPoints, geometry: EpipolarPair, params: SparseParams
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of left and right points whose rows agree and whose parallax is in range."""
    width = 4.0 * geometry.samples  # separates rows in one sorted key
    key = right.pixels[:, 1] * width + right.pixels[:, 0]
    order = np.argsort(key)
    furthest = largest_parallax_px(geometry, params.nearest_range_m)
    firsts, seconds = [], []
    for shift in range(-params.line_tolerance_px, params.line_tolerance_px + 1):
        row = (left.pixels[:, 1] + shift) * width + left.pixels[:, 0]
        low = np.searchsorted(key[order], row - furthest, side="left")
        high = np.searchsorted(key[order], row - params.least_parallax_px, side="right")
        count = high - low
        first = np.repeat(np.arange(len(left)), count)
        within = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
        firsts.append(first)
        seconds.append(order[np.repeat(low, count) + within])
    return np.concatenate(firsts), np.concatenate(seconds)


def _windows(
    image: GreyImage, pixels: Int32[np.ndarray, "n 2"], window_px: int
) -> Float32[np.ndarray, "n k"]:
    """Windows around pixels, of mean 0 and length 1."""
    windows = windows_at(image, pixels, window_px)
    windows -= windows.mean(axis=1, keepdims=True)
    length = np.sqrt(np.einsum("nk,nk->n", windows, windows))[:, None]
    windows /= np.maximum(length, np.float32(1e-6))
    return windows


def _mutual_best(a: np.ndarray, b: np.ndarray, correlation: np.ndarray, least: float) -> np.ndarray:
    """Indices of pairs above the threshold in which each is the other's best."""
    index = np.nonzero(correlation > least)[0]
    if not len(index):
        return index
    a, b, value = a[index], b[index], correlation[index]
    best_of_a = np.full(a.max() + 1, -1.0, np.float32)
    best_of_b = np.full(b.max() + 1, -1.0, np.float32)
    np.maximum.at(best_of_a, a, value)
    np.maximum.at(best_of_b, b, value)
    return index[(value == best_of_a[a]) & (value == best_of_b[b])]


def sigma_with_relief(
    matcher: LeastSquaresMatcher,
    points: ImagePoints,
    refined: RefinedParallax,
) -> PerPoint:
    """Standard deviation, pixels, of refined parallaxes against the ground at the points."""
    if not len(points):
        return refined.sigma_px
    half = matcher.params.window_px // 2 | 1
    narrow = matcher.with_params(replace(matcher.params, window_px=half)).refine(
        points.astype(np.int32), refined.parallax_px
    )
    difference = np.where(narrow.settled, narrow.parallax_px - refined.parallax_px, LARGEST_PX)
    squared = np.minimum(difference**2, LARGEST_PX**2)
    noise = narrow.sigma_px**2 - refined.sigma_px**2
    nearest = KDTree(points).query(points, k=min(RELIEF_NEIGHBOURS, len(points)))[1]
    nearest = nearest.reshape(len(points), -1)
    around = MAD_TO_SIGMA**2 * np.median(squared[nearest], axis=1) - np.median(
        noise[nearest], axis=1
    )
    relief = (1 - OWN_WEIGHT) * around + OWN_WEIGHT * (squared - noise)
    return np.sqrt(refined.sigma_px**2 + BELOW_HALF * np.maximum(relief, 0))
