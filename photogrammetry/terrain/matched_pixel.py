"""A matched pair asked about single pixels of its images as stored, and about single places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, ImagePoints, ParallaxMap, PerPoint, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.hand_editing import epipolar_point
from solmap.photogrammetry.terrain.visibility.viewshed import Sight

LEAST_TOLERANCE_PX = 0.5
"""By which a parallax may differ from the expected one before it is of other ground: twice the
standard deviation of a dense parallax (`SightParams.sigma_parallax_px`)."""
SIGMAS = 3.0
WITHIN_PX = 1.0
"""How far the right end of a match may lie from the pixel that it is looked for at."""


@dataclass(frozen=True, slots=True)
class MatchedPixel:
    """A pixel with the parallax that was found at it."""

    left: tuple[float, float]
    """In the left epipolar image."""
    parallax_px: float
    sigma_px: float
    """Of the parallax."""


def matched_pixel(
    point: tuple[float, float],
    eye: Eye,
    camera: CameraModel,
    geometry: EpipolarPair,
    parallax: ParallaxMap,
    sigma: ParallaxMap,
) -> MatchedPixel | None:
    """What was matched at a pixel of the left or right image as stored; None where nothing was.

    `camera` is that of the image, in the rover frame of `geometry`.
    """
    place = epipolar_point(camera, geometry, point)
    if not np.isfinite(place).all():
        return None
    if eye is Eye.RIGHT:
        sample = _left_sample(place, parallax)
        if sample is None:
            return None
        place = np.array([sample, place[1]])
    if not geometry.shows(place[None])[0]:
        return None
    found, spread = (float(_at(place[None], values)[0]) for values in (parallax, sigma))
    if not np.isfinite(found):
        return None
    return MatchedPixel((float(place[0]), float(place[1])), found, spread)


def _left_sample(right: Float64[np.ndarray, " 2"], parallax: ParallaxMap) -> float | None:
    """Sample of the left pixel whose match ends at a right one.

    Of several the nearest ground is meant: it hides the others.
    """
    line = round(float(right[1]))
    if not 0 <= line < parallax.shape[0]:
        return None
    row = parallax[line].astype(np.float64)
    ends = np.arange(len(row)) - row
    near = np.flatnonzero(np.abs(ends - right[0]) <= WITHIN_PX)
    if not len(near):
        return None
    nearest = near[row[near] >= row[near].max() - WITHIN_PX]
    best = int(nearest[np.argmin(np.abs(ends[nearest] - right[0]))])
    return best + float(right[0] - ends[best])


def _at(places: ImagePoints, values: ParallaxMap) -> PerPoint:
    """Values at sub-pixel places: bilinear on continuous ground, else of the nearest pixel."""
    last = np.array(values.shape[::-1]) - 1
    corner = np.clip(np.floor(places), 0, np.maximum(last - 1, 0)).astype(np.int64)
    u, v = (np.clip(places, 0, last) - corner).T
    x, y = corner.T
    four = np.stack([values[y, x], values[y, x + 1], values[y + 1, x], values[y + 1, x + 1]])
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    with np.errstate(invalid="ignore"):
        smooth = np.ptp(four, axis=0) <= 1.0  # NaN is not
    nearest = four[np.argmax(weights, axis=0), np.arange(len(places))]
    return np.where(smooth, (weights * np.where(smooth, four, 0.0)).sum(axis=0), nearest)


def sight_by_parallax(
    point_in_lsl: Vector3,
    covariance: Float64[np.ndarray, "3 3"],
    lsl_from_pair: Pose,
    eye: Eye,
    geometry: EpipolarPair,
    parallax: ParallaxMap,
) -> Sight:
    """Whether one image of a pair sees a place, by the parallax that it was matched with there.

    Where it was matched to nearer ground, that hides the place; UNKNOWN where it was not matched.
    """
    in_pair = lsl_from_pair.inverse.apply(point_in_lsl[None])
    left, expected = geometry.project(in_pair)
    if eye is Eye.RIGHT and np.isfinite(left).all():
        sample = _left_sample(np.array([left[0, 0] - expected[0], left[0, 1]]), parallax)
        left[0, 0] = np.nan if sample is None else sample
    if not geometry.shows(left)[0]:
        return Sight.UNKNOWN
    found = _at(left, parallax)[0]
    if not np.isfinite(found):
        return Sight.UNKNOWN
    depth = float(in_pair[0, 2])
    forward = lsl_from_pair.rotation[:, 2]
    sigma = geometry.focal_px * geometry.base_m / depth**2 * np.sqrt(forward @ covariance @ forward)
    tolerance = max(LEAST_TOLERANCE_PX, SIGMAS * float(sigma))
    return Sight.HIDDEN if found > expected[0] + tolerance else Sight.VISIBLE
