"""Registration of neighbouring images of a panorama: the shift between them where they overlap.

Small patches visible in two images are rendered from each separately, on the panorama's pixels. The
middle of one is searched in the other by normalised cross-correlation; a parabola through the peak
gives fractions of a pixel. The shift is the error of pointing, camera models and ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from solmap.photogrammetry.terrain.orthophoto.panorama import (
    Panorama,
    PanoramaImage,
    interpolate_nodes,
)
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import NODE

PATCHES_ACROSS = 16
"""Width of an image in patches: neighbours in a panorama overlap by a fifth of it."""
LEAST_PATCH, LARGEST_PATCH = 32, 64
"""Smallest and largest side of a patch, pixels."""
MOST_PATCHES = 12
"""Most patches in which two images are compared."""
INSIDE = 0.1
"""Least fade weight of a patch in both images, reached a twentieth of an image from its border."""
LEAST_CORRELATION = 0.8
"""Least correlation: bare sand and sky do not correlate."""


@dataclass(frozen=True, slots=True)
class Seam:
    """Two images and the shift between them."""

    first: str
    second: str
    patches: int
    shift_px: float
    """Median length of the shifts, pixels of the panorama."""


@dataclass(frozen=True, slots=True)
class Registration:
    """The seams of a panorama."""

    seams: tuple[Seam, ...]
    median_px: float
    """Median shift over all patches; NaN where no two images overlap."""
    p90_px: float


def registration(made: Panorama) -> Registration:
    """Compare every two images of a panorama where they overlap."""
    side = min(image.size[0] // PATCHES_ACROSS for image in made.images)
    side = int(np.clip(side - side % (2 * NODE), LEAST_PATCH, LARGEST_PATCH))
    ground, ranges = made.nodes(0, 0, made.grid.rows, made.grid.cols)
    places = ground.reshape(*ranges.range_m.shape, 3)
    half = side // NODE // 2
    rows, cols = (np.arange(half, count - half, half) for count in places.shape[:2])
    middles = places[np.ix_(rows, cols)]
    inside = np.stack([_fades(image, middles) > INSIDE for image in made.images])
    seams: list[Seam] = []
    lengths: list[float] = []
    for first, second in combinations(range(len(made.images)), 2):
        shared = np.flatnonzero(inside[first] & inside[second])
        chosen = shared[:: max(1, len(shared) // MOST_PATCHES)][:MOST_PATCHES].tolist()
        shifts = []
        for row, col in ((rows[n // len(cols)], cols[n % len(cols)]) for n in chosen):
            patch = places[row - half : row + half + 1, col - half : col + half + 1]
            shift = _shift(made, (first, second), patch, side)
            shifts += [] if shift is None else [shift]
        if shifts:
            names = made.images[first].id, made.images[second].id
            seams.append(Seam(*names, len(shifts), float(np.median(shifts))))
            lengths += shifts
    if not lengths:
        return Registration((), float("nan"), float("nan"))
    middle, high = np.percentile(lengths, (50, 90)).tolist()
    return Registration(tuple(seams), middle, high)


def _fades(image: PanoramaImage, places: np.ndarray) -> np.ndarray:
    fade: np.ndarray = image.sample(*image.project_lattice(places), image.pixel_deg)[1].ravel()
    return fade


def _shift(made: Panorama, numbers: tuple[int, int], places: np.ndarray, side: int) -> float | None:
    """Length of the shift between two images in a patch; None where there is no texture."""
    drawn = []
    for image in (made.images[number] for number in numbers):
        seen = interpolate_nodes(image, places, (side, side))
        if seen is None:
            return None
        grey, fade = image.sample(*seen, made.grid.cell_deg)
        if not (fade > 0).all():
            return None
        drawn.append(grey)
    border = side // 4
    middle = drawn[0][border:-border, border:-border]
    return _peak(cv2.matchTemplate(drawn[1], middle, cv2.TM_CCOEFF_NORMED), border)


def _peak(correlation: np.ndarray, border: int) -> float | None:
    """Distance of the peak from the middle; None where it is weak or at the border."""
    row, col = np.unravel_index(np.argmax(correlation), correlation.shape)
    last = len(correlation) - 1
    if not (0 < row < last and 0 < col < last) or correlation[row, col] < LEAST_CORRELATION:
        return None
    down = _vertex(correlation[row - 1 : row + 2, col])
    across = _vertex(correlation[row, col - 1 : col + 2])
    return float(np.hypot(row + down - border, col + across - border))


def _vertex(values: np.ndarray) -> float:
    """Position of the maximum of a parabola through three values."""
    before, here, after = values.tolist()
    curvature = before - 2 * here + after
    return 0.0 if curvature >= 0 else 0.5 * (before - after) / curvature
