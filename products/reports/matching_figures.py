"""Figures of matching (OpenCV; bands in the order blue, green, red).

- of a pair: accepted candidates, the parallax curve, dense parallax and residuals from it;
- of ties: two images side by side with a line for every point that both show, coloured by the
  length of the tie's residual in standard deviations (Mahalanobis), from green (0) over yellow to
  red (the limit of acceptance);
- of hypotheses: two stops from above, overlaid.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    EightBits,
    Flags,
    Float64,
    GreyImage,
    ImagePoints,
    Mask,
    ParallaxMap,
    PerPoint,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StereoMatches
from solmap.photogrammetry.matching.alignment import AlignmentParams, align
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    CLIP,
    RELIEF,
    BirdsEyeView,
    PlaneFit,
    band_pass,
    place_on,
)
from solmap.photogrammetry.matching.records import DenseMatches, EpipolarImages, MatchedPair, Ties
from solmap.photogrammetry.matching.stereo.sparse import Candidates
from solmap.photogrammetry.matching.stereo.verification import (
    VerificationParams,
    parallax_curve,
)
from solmap.photogrammetry.stretching import SAMPLE, stretch

WHITE = (255, 255, 255)
BLACK = (0, 0, 0)
GREEN = (80, 200, 80)
ORANGE = (0, 140, 255)
RED = (60, 20, 220)
DOT_PX = 2
GREY_STEP = 8
"""Step of grey levels: the noise of soil is most of an image's bytes."""
AGREES_PX = 0.3
"""Residual of a good match: what published stereo reaches on board (NPO-42487: 0.32 px)."""


def in_three_bands(image: GreyImage, mask: Mask, scale: float = 1.0) -> EightBits:
    """The image shrunk and stretched, to be drawn upon in colours; black where not usable."""
    if scale < 1:
        size = _size(mask.shape, scale)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(mask.view(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    grey = np.where(mask, stretch(image, mask), 0).astype(np.uint8) // GREY_STEP * GREY_STEP
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


def draw_candidates(
    images: EpipolarImages, candidates: Candidates, scale: float = 1.0
) -> EightBits:
    """Both images side by side: accepted candidates white, those off the parallax curve black."""
    figures = []
    for image, mask, points in (
        (images.left, images.left_mask, candidates.left),
        (images.right, images.right_mask, candidates.right),
    ):
        figure = in_three_bands(image, mask, scale)
        _dots(figure, points[candidates.accepted] * scale, WHITE, BLACK, scale)
        _dots(figure, points[~candidates.accepted] * scale, BLACK, WHITE, scale)
        figures.append(figure)
    return np.hstack(figures)


def draw_residuals(
    images: EpipolarImages, matches: StereoMatches, parallax: ParallaxMap, scale: float = 1.0
) -> EightBits:
    """The left image with the matches, coloured by their difference from dense matching.

    Least squares and semi-global matching are independent: green agrees to 0.3 px, orange to one,
    red does not; white has no dense parallax.
    """
    figure = in_three_bands(images.left, images.left_mask, scale)
    sample, line = np.rint(matches.left).astype(int).T
    apart = np.abs(matches.parallax_px - parallax[line, sample])
    for colour, chosen in (
        (WHITE, ~np.isfinite(apart)),
        (GREEN, apart <= AGREES_PX),
        (ORANGE, (apart > AGREES_PX) & (apart <= 1)),
        (RED, apart > 1),
    ):
        _dots(figure, matches.left[chosen] * scale, colour, BLACK, scale)
    return figure


def draw_parallax(parallax: ParallaxMap, scale: float = 1.0) -> EightBits:
    """Parallax in colours over its own range, on a logarithmic scale; black where unmatched."""
    if scale < 1:
        size = _size(parallax.shape, scale)
        parallax = cv2.resize(parallax, size, interpolation=cv2.INTER_NEAREST)
    return _colours(parallax)


def draw_pair(
    images: EpipolarImages,
    candidates: Candidates,
    matches: StereoMatches,
    dense: DenseMatches,
    params: VerificationParams,
    scale: float = 1.0,
) -> EightBits:
    """All matches of a pair, on one sheet, `scale` times as large as its images.

    Top: candidates in both images. Middle: matches coloured by residual, and the dense parallax.
    Foot: the standard deviation of the dense parallax, and the parallax curve.
    """
    residuals = draw_residuals(images, matches, dense.parallax_px, scale)
    curve = draw_parallax_curve(candidates, params, *residuals.shape[1::-1])
    middle = residuals, draw_parallax(dense.parallax_px, scale)
    foot = draw_parallax(dense.sigma_px, scale), curve
    top = draw_candidates(images, candidates, scale)
    return np.vstack([top, np.hstack(middle), np.hstack(foot)])


def draw_parallax_curve(
    candidates: Candidates, params: VerificationParams, width: int = 1200, height: int = 500
) -> EightBits:
    """Parallaxes in row-first order with the parallax curve (orange), blunders in black."""
    figure = np.full((height, width, 3), 255, np.uint8)
    if not len(candidates):
        return figure
    points = candidates.left.astype(np.float64)
    parallax = points[:, 0] - candidates.right[:, 0]
    curve = parallax_curve(points, parallax, params)
    order = np.lexsort((points[:, 0], points[:, 1]))
    x = np.linspace(10, width - 10, len(order))
    highest = max(float(parallax.max()), 1.0) * 1.05

    def place(values: np.ndarray) -> ImagePoints:
        return np.column_stack([x, height - 10 - values[order] / highest * (height - 20)])

    accepted = candidates.accepted[order]
    _dots(figure, place(parallax)[accepted], GREEN, None)
    _dots(figure, place(curve), ORANGE, None)
    _dots(figure, place(parallax)[~accepted], BLACK, None)
    return figure


def _colours(values: ParallaxMap) -> EightBits:
    known = np.isfinite(values) & (values > 0)
    if not known.any():
        return np.zeros((*values.shape, 3), np.uint8)
    logarithm = np.log(np.where(known, values, 1.0))
    some = logarithm[known]
    low, high = np.percentile(some[:: max(1, some.size // SAMPLE)], [0.5, 99.5])
    scaled = np.clip((logarithm - low) / max(high - low, 1e-6), 0, 1) * 255
    figure = cv2.applyColorMap(scaled.astype(np.uint8), cv2.COLORMAP_TURBO)
    figure[~known] = 0
    return figure


def _dots(
    figure: EightBits,
    points: ImagePoints,
    colour: tuple[int, int, int],
    rim: tuple[int, int, int] | None,
    scale: float = 1.0,
) -> None:
    """Small discs, drawn into the image."""
    radius = max(1, round(DOT_PX * scale))
    lines, samples = figure.shape[:2]
    for size, ink in ((radius + 1, rim), (radius, colour)):
        if ink is None:
            continue
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * size + 1, 2 * size + 1))
        around = np.argwhere(disc)[:, None, ::-1] - size
        x, y = (np.rint(points).astype(np.int64) + around).reshape(-1, 2).T
        inside = (x >= 0) & (x < samples) & (y >= 0) & (y < lines)
        figure[y[inside], x[inside]] = ink


GAP_PX = 8
COLUMNS = 2
"""Most couples of images on a sheet."""
SHEET_PX = 1536
TITLE_PX = 22
LEGEND = "a tie's line: green where it agrees with all others, yellow, red at the limit of the test"
LEAST_SHEET_PX = 64
GREEN_DEG = 120.0
"""Hue of a tie without misfit; 0 is red."""


def misfits(
    ties: Ties,
    geometries: Mapping[str, EpipolarPair],
    first_from_second: Pose,
    covariance: Float64[np.ndarray, "6 6"] | None,
    params: AlignmentParams,
) -> PerPoint:
    """Residuals of ties after alignment, as fractions of the test's limit."""
    if not len(ties):
        return np.zeros(0)
    aligned = align(ties, geometries, first_from_second, covariance, params)
    return np.sqrt(aligned.mahalanobis2 / params.chi_square)


@dataclass(frozen=True, slots=True, eq=False)
class FigureImage:
    """An image on which ties are drawn."""

    name: str
    image: GreyImage
    mask: Mask

    @classmethod
    def of(cls, pair: MatchedPair) -> FigureImage:
        """The left image of a pair."""
        return cls(pair.pair_id, pair.left, pair.left_mask)


def draw_ties(
    first: FigureImage,
    second: FigureImage,
    ties: Ties,
    misfit: PerPoint,
    scale: float = 1.0,
) -> EightBits:
    """Two images, and a coloured line from each point to its conjugate."""
    for shown in (first, second):
        if shown.name not in ties.pair_ids:
            raise MatchingError(f"{shown.name} is not among the images of these ties")
    grey = [in_three_bands(s.image, s.mask, scale) for s in (first, second)]
    height = max(g.shape[0] for g in grey)
    offset = grey[0].shape[1] + GAP_PX
    figure = np.zeros((height, offset + grey[1].shape[1], 3), np.uint8)
    for image, left in zip(grey, (0, offset), strict=True):
        figure[: image.shape[0], left : left + image.shape[1]] = image
    for start, end, share in _lines(first.name, second.name, ties, misfit):
        a, b = ((int(x * scale), int(y * scale)) for x, y in (start, end))
        b, colour = (b[0] + offset, b[1]), _misfit_colour(share)
        cv2.line(figure, a, b, colour, 1, cv2.LINE_AA)
        for place in (a, b):
            cv2.circle(figure, place, 3, colour, 1, cv2.LINE_AA)
    return figure


def draw_sheet(
    images: Iterable[FigureImage], ties: Ties, misfit: PerPoint, *, first_left: bool = False
) -> EightBits:
    """All couples of images joined by ties, two per row, those with most ties first.

    With `first_left` the image where ties start, the earlier stop's, is always left; otherwise the
    couple is ordered so that the overlap is in the middle.
    """
    shown = {image.name: image for image in images}
    counts = sorted(ties.counts().items(), key=lambda item: -item[1])
    cells = [
        _cell(*_side_by_side(shown[one], shown[other], ties, first_left=first_left), ties, misfit)
        for (one, other), _ in counts
        if one in shown and other in shown
    ]
    if not cells:
        return np.zeros((LEAST_SHEET_PX, SHEET_PX, 3), np.uint8)
    width = SHEET_PX // COLUMNS
    rows = [caption(LEGEND, SHEET_PX)]
    for k in range(0, len(cells), COLUMNS):
        row = cells[k : k + COLUMNS]
        height = max(cell.shape[0] for cell in row)
        filled = [np.zeros((height, width, 3), np.uint8) for _ in range(COLUMNS)]
        for cell, place in zip(row, filled, strict=False):
            place[: cell.shape[0], : cell.shape[1]] = cell
        rows.append(np.hstack(filled))
    return np.vstack(rows)


def caption(text: str, width: int) -> EightBits:
    """A line of white text on black."""
    line = np.zeros((TITLE_PX, width, 3), np.uint8)
    place, white = (2, 15), (255, 255, 255)
    return cv2.putText(line, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, white, 1, cv2.LINE_AA)


def _side_by_side(
    first: FigureImage, second: FigureImage, ties: Ties, *, first_left: bool
) -> tuple[FigureImage, FigureImage, Flags]:
    """A couple in its order, and the ties between them."""
    rows = _between(ties, first.name, second.name)
    if first_left:
        return first, second, rows
    shares = [
        float(np.mean(left[rows, 0])) / shown.image.shape[1]
        for left, shown in ((ties.first_left, first), (ties.second_left, second))
    ]
    return (first, second, rows) if shares[0] >= shares[1] else (second, first, rows)


def _cell(
    first: FigureImage, second: FigureImage, rows: Flags, ties: Ties, misfit: PerPoint
) -> EightBits:
    """One couple of a sheet, with its names and number of ties above."""
    wide = first.image.shape[1] + second.image.shape[1]
    scale = (SHEET_PX // COLUMNS - 2 * GAP_PX) / wide
    drawn = draw_ties(first, second, ties.select(rows), misfit[rows], scale)
    count = int(rows.sum())
    text = f"{first.name} - {second.name}: {count} {'tie' if count == 1 else 'ties'}"
    return np.vstack([caption(text, drawn.shape[1]), drawn])


def _size(shape: tuple[int, ...], scale: float) -> tuple[int, int]:
    """Width and height of a shrunk image."""
    return max(1, round(shape[1] * scale)), max(1, round(shape[0] * scale))


def _between(ties: Ties, one: str, other: str) -> Flags:
    """The ties that run from one pair to the other."""
    first, second = ties.pair_ids.index(one), ties.pair_ids.index(other)
    return (ties.first == first) & (ties.second == second)


def _lines(
    first: str, second: str, ties: Ties, misfit: PerPoint
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """(point in the first pair, point in the second, misfit), for either direction of the ties."""
    forth, back = _between(ties, first, second), _between(ties, second, first)
    return [
        *zip(ties.first_left[forth], ties.second_left[forth], misfit[forth].tolist(), strict=True),
        *zip(ties.second_left[back], ties.first_left[back], misfit[back].tolist(), strict=True),
    ]


def _misfit_colour(share: float) -> tuple[int, int, int]:
    """Colour (blue, green, red) of a misfit, from green (0) to red (1 and more)."""
    hue = round(GREEN_DEG / 2 * (1.0 - min(max(share, 0.0), 1.0)))  # OpenCV halves degrees
    blue, green, red = cv2.cvtColor(np.array([[[hue, 230, 255]]], np.uint8), cv2.COLOR_HSV2BGR)[
        0, 0
    ]
    return int(blue), int(green), int(red)


def draw_overlay(earlier: BirdsEyeView, later: BirdsEyeView, fit: PlaneFit) -> EightBits:
    """Relief, then grey of both views, the earlier in red, the later in green and blue.

    Where they agree the figure is grey; ground seen by only one has that one's colour.
    """
    figures = []
    for red, cyan in ((earlier.elevation, later.elevation), (earlier.grey, later.grey)):
        over = place_on(cyan, later.cell_m, fit.azimuth, fit.north_m, fit.east_m)
        one, other = (band_pass(raster, *RELIEF) for raster in (red, over))
        stretched = [
            np.where(c.weight > 0, 40 + 215 * (c.value + CLIP) / (2 * CLIP), 0).astype(np.uint8)
            for c in (one, other, other)
        ]
        figures.append(np.dstack(stretched))
    return np.hstack(figures)
