"""Quick looks of what was matched, in OpenCV's order of bands: blue, green, red."""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import GreyImage, ImagePoints, Mask, ParallaxMap, Picture
from solmap.photogrammetry.imagery import StereoMatches
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo.dense import DenseMatches
from solmap.photogrammetry.matching.stereo.sparse import Candidates
from solmap.photogrammetry.matching.stereo.verification import (
    VerificationParams,
    parallax_curve,
)
from solmap.photogrammetry.stretching import stretch

WHITE = (255, 255, 255)
BLACK = (0, 0, 0)
GREEN = (80, 200, 80)
ORANGE = (0, 140, 255)
RED = (60, 20, 220)
AGREES_PX = 0.3
"""Residual of a good match: what published stereo reaches on board (NPO-42487: 0.32 px)."""


def in_three_bands(image: GreyImage, mask: Mask) -> Picture:
    """The stretched image, to be drawn upon in colours; black where not usable."""
    grey = np.where(mask, stretch(image, mask), 0).astype(np.uint8)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


def draw_candidates(images: EpipolarImages, candidates: Candidates) -> Picture:
    """Both images side by side: accepted candidates white, those off the parallax curve black."""
    pictures = []
    for image, mask, points in (
        (images.left, images.left_mask, candidates.left),
        (images.right, images.right_mask, candidates.right),
    ):
        picture = in_three_bands(image, mask)
        _dots(picture, points[candidates.accepted].astype(np.float64), WHITE, BLACK)
        _dots(picture, points[~candidates.accepted].astype(np.float64), BLACK, WHITE)
        pictures.append(picture)
    return np.hstack(pictures)


def draw_residuals(
    images: EpipolarImages, matches: StereoMatches, parallax: ParallaxMap
) -> Picture:
    """The left image with the matches, coloured by how far dense matching is from them.

    Least squares and semi-global matching come to a parallax each in its own way: green agrees to
    0.3 px, orange to one, red does not; white has no dense parallax.
    """
    picture = in_three_bands(images.left, images.left_mask)
    sample, line = np.rint(matches.left).astype(int).T
    apart = np.abs(matches.parallax_px - parallax[line, sample])
    for colour, chosen in (
        (WHITE, ~np.isfinite(apart)),
        (GREEN, apart <= AGREES_PX),
        (ORANGE, (apart > AGREES_PX) & (apart <= 1)),
        (RED, apart > 1),
    ):
        _dots(picture, matches.left[chosen], colour, BLACK)
    return picture


def draw_parallax(parallax: ParallaxMap) -> Picture:
    """Parallax in colours over its own range, logarithmic as ranges are; black where unmatched."""
    return _colours(parallax)


def draw_pair(
    images: EpipolarImages,
    candidates: Candidates,
    matches: StereoMatches,
    dense: DenseMatches,
    params: VerificationParams,
) -> Picture:
    """All that was matched in a pair, on one sheet.

    Top: candidates in both images. Middle: matches coloured by residual, and the dense parallax.
    Foot: the standard deviation of the dense parallax, and the parallax curve.
    """
    lines, samples = images.left.shape
    middle = (draw_residuals(images, matches, dense.parallax_px), draw_parallax(dense.parallax_px))
    curve = draw_parallax_curve(candidates, params, samples, lines)
    foot = (_colours(dense.sigma_px), curve)
    rows = (draw_candidates(images, candidates), np.hstack(middle), np.hstack(foot))
    return np.vstack(rows)


def draw_parallax_curve(
    candidates: Candidates, params: VerificationParams, width: int = 1200, height: int = 500
) -> Picture:
    """Parallaxes in row-first order with the parallax curve (orange), blunders in black."""
    picture = np.full((height, width, 3), 255, np.uint8)
    if not len(candidates):
        return picture
    points = candidates.left.astype(np.float64)
    parallax = points[:, 0] - candidates.right[:, 0]
    curve = parallax_curve(points, parallax, params)
    order = np.lexsort((points[:, 0], points[:, 1]))
    x = np.linspace(10, width - 10, len(order))
    highest = max(float(parallax.max()), 1.0) * 1.05

    def place(values: np.ndarray) -> ImagePoints:
        return np.column_stack([x, height - 10 - values[order] / highest * (height - 20)])

    accepted = candidates.accepted[order]
    _dots(picture, place(parallax)[accepted], GREEN, None)
    _dots(picture, place(curve), ORANGE, None)
    _dots(picture, place(parallax)[~accepted], BLACK, None)
    return picture


def _colours(values: ParallaxMap) -> Picture:
    known = np.isfinite(values) & (values > 0)
    if not known.any():
        return np.zeros((*values.shape, 3), np.uint8)
    logarithm = np.log(np.where(known, values, 1.0))
    low, high = np.percentile(logarithm[known], [0.5, 99.5])
    scaled = np.clip((logarithm - low) / max(high - low, 1e-6), 0, 1) * 255
    picture = cv2.applyColorMap(scaled.astype(np.uint8), cv2.COLORMAP_TURBO)
    picture[~known] = 0
    return picture


def _dots(
    picture: Picture,
    points: ImagePoints,
    colour: tuple[int, int, int],
    rim: tuple[int, int, int] | None,
) -> None:
    """Small discs, drawn into the picture."""
    for x, y in np.rint(points).astype(int).tolist():
        if rim is not None:
            cv2.circle(picture, (x, y), 3, rim, -1)
        cv2.circle(picture, (x, y), 2, colour, -1)
