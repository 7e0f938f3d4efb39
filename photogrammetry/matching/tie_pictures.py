"""Pictures of ties: two images side by side with a line for every point that both show."""

from __future__ import annotations

import cv2
import numpy as np

from photogrammetry.arrays import Picture
from photogrammetry.errors import MatchingError
from photogrammetry.matching.pictures import in_three_bands
from photogrammetry.matching.records import MatchedPair
from photogrammetry.matching.ties import Ties

GAP_PX = 8
GOLDEN = 0.618
"""Hues advance by this share of the circle, so that neighbours differ."""


def draw_ties(first: MatchedPair, second: MatchedPair, ties: Ties) -> Picture:
    """The left images of two pairs, and a coloured line from each point to its conjugate."""
    for pair in (first, second):
        if pair.pair_id not in ties.pair_ids:
            raise MatchingError(f"{pair.pair_id} is not among the pairs of these ties")
    grey = [in_three_bands(p.images.left, p.images.left_mask) for p in (first, second)]
    height = max(g.shape[0] for g in grey)
    offset = grey[0].shape[1] + GAP_PX
    picture = np.zeros((height, offset + grey[1].shape[1], 3), np.uint8)
    for image, left in zip(grey, (0, offset), strict=True):
        picture[: image.shape[0], left : left + image.shape[1]] = image.reshape(
            *image.shape[:2], -1
        )
    for k, (start, end) in enumerate(_lines(first.pair_id, second.pair_id, ties)):
        colour = _colour(k)
        a, b = (int(start[0]), int(start[1])), (int(end[0]) + offset, int(end[1]))
        cv2.line(picture, a, b, colour, 1, cv2.LINE_AA)
        for place in (a, b):
            cv2.circle(picture, place, 4, colour, 1, cv2.LINE_AA)
    return picture


def _lines(first: str, second: str, ties: Ties) -> list[tuple[np.ndarray, np.ndarray]]:
    """(point in the first pair, point in the second) of their ties, whichever way they run."""
    one, other = ties.pair_ids.index(first), ties.pair_ids.index(second)
    forth = (ties.first == one) & (ties.second == other)
    back = (ties.first == other) & (ties.second == one)
    return [
        *zip(ties.first_left[forth], ties.second_left[forth], strict=True),
        *zip(ties.second_left[back], ties.first_left[back], strict=True),
    ]


def _colour(k: int) -> tuple[int, int, int]:
    """A bright colour, (red, green, blue)."""
    hue = np.array([[[round(180 * ((k * GOLDEN) % 1.0)) % 180, 220, 255]]], np.uint8)
    red, green, blue = cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return red, green, blue
