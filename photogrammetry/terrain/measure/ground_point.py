"""The ground at a point of an image, with its covariance.

Where the pixel was matched, the position follows from its parallax in the pair. Elsewhere the ray

    X = C + t r

is followed over the terrain until it first passes below it; with the plane n of the ground there,
an error e of the ray at X and an error dh of the elevation move the point by

    dX = T e + r (n_up / (r.n)) dh,        T = I - r n' / (r.n).

In both cases the point has a covariance relative to the stop it was measured from: the pair's own,
or that of the intersected terrain model. The covariance of that stop is added where the point is
needed relative to the held stop (see `oriented_image`).

Parallax maps are sampled at pixels of the images as stored, and at the images of single points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import (
    Covariance3,
    Float64,
    ImagePoints,
    ParallaxMap,
    PerPoint,
    Vector3,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.manual.editing import epipolar_point
from solmap.photogrammetry.planes import least_squares_plane
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.resampling import Elevations
from solmap.photogrammetry.terrain.measure.oriented_image import (
    OrientedImage,
    StopPose,
    relative_covariance,
)
from solmap.photogrammetry.terrain.visibility.viewshed import Sight

UP = np.array([0.0, 0.0, -1.0])
"""Upward unit vector in the LSL."""
GRAZING = 0.02
"""Cosine to the normal below which a ray is parallel to the ground: one degree."""
WIDEST_GAP_M = 0.5
"""Longest stretch of unknown ground that a ray may pass before it intersects: see
`SightParams.max_gap_m`."""
HALVINGS = 20

LEAST_TOLERANCE_PX = 0.5
"""Difference from the expected parallax beyond which it is of other ground: twice the standard
deviation of a dense parallax (`SightParams.sigma_parallax_px`)."""
SIGMAS = 3.0
WITHIN_PX = 1.0
"""Largest distance of the right end of a match from the requested pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundPoint:
    """A point on the ground, in the LSL, metres."""

    point: Vector3
    covariance: Covariance3
    """Covariance relative to `frame`."""
    frame: StopPose
    """The stop from which it was measured."""
    normal: Vector3 | None = None
    """Normal of the ground, pointing up, where known."""

    @property
    def on_map(self) -> Vector3:
        """(east, north, up)."""
        return MAP_FROM_LSL @ self.point

    @property
    def total_covariance(self) -> Covariance3:
        """Relative to the held stop, in (east, north, up)."""
        total = self.covariance + self.frame.covariance_at(self.point)
        return MAP_FROM_LSL @ total @ MAP_FROM_LSL.T


def triangulate_pixel(
    image: OrientedImage,
    geometry: EpipolarPair,
    lsl_from_pair: Pose,
    left: Float64[np.ndarray, " 2"],
    parallax_px: float,
    sigmas_px: tuple[float, float],
) -> GroundPoint:
    """The position of a matched pixel.

    Args:
        image: The picked image, for its stop and pointing.
        geometry: Of its pair.
        lsl_from_pair: Pose of the pair, pointing corrected.
        left: The point in the left epipolar image.
        parallax_px: Its parallax.
        sigmas_px: Standard deviations of the point and of the parallax.
    """
    one, parallax = left[None], np.array([parallax_px])
    point = lsl_from_pair.apply(geometry.triangulate(one, parallax))[0]
    turn = lsl_from_pair.rotation
    own = turn @ geometry.covariances(one, parallax, *sigmas_px)[0] @ turn.T
    return GroundPoint(point, own + image.pointing_covariance_at(point), image.pose)


def range_to_ground(
    start: Vector3, ray: Vector3, elevations: Elevations, reach_m: float, step_m: float
) -> float | None:
    """Distance along a ray in the LSL at which it first passes below the ground; None if never.

    None also where the ground below the ray is unknown over a longer stretch than `WIDEST_GAP_M`
    before it.
    """
    start, ray = MAP_FROM_LSL @ start, MAP_FROM_LSL @ ray
    flat = max(float(np.hypot(*ray[:2])), 1e-6)
    along = np.arange(0.0, reach_m, step_m) / flat

    def height(t: PerPoint) -> PerPoint:
        points = start + t[:, None] * ray
        return points[:, 2] - elevations(points[:, :2])

    over = height(along)
    known = np.flatnonzero(np.isfinite(over))
    under = known[over[known] <= 0]
    if not len(under) or under[0] == known[0]:
        return None
    after = int(under[0])
    before = int(known[np.searchsorted(known, after) - 1])
    if (along[after] - along[before]) * flat > WIDEST_GAP_M + step_m:
        return None
    low, high = float(along[before]), float(along[after])
    for _ in range(HALVINGS if after - before == 1 else 0):
        middle = (low + high) / 2
        above = height(np.array([middle]))[0]
        if not np.isfinite(above):
            break
        low, high = (middle, high) if above > 0 else (low, middle)
    return (low + high) / 2


def intersect_terrain(
    image: OrientedImage,
    point: Vector3,
    ray: Vector3,
    ground: tuple[Vector3, float, StopPose],
    sigma_px: float,
    pixel: float,
) -> GroundPoint:
    """The intersection of a ray with a terrain model.

    Args:
        image: The image the ray belongs to.
        point: The intersection, in the LSL.
        ray: Its direction.
        ground: Normal of the ground in the LSL, standard deviation of its elevation relative to its
            stop, and that stop.
        sigma_px: Standard deviation of the image point.
        pixel: Angle of a pixel, radians.
    """
    normal, sigma_m, frame = ground
    cosine = float(ray @ normal)
    cosine = np.copysign(max(abs(cosine), GRAZING), cosine)
    distance = float(np.linalg.norm(point - image.camera.centre))
    across = (sigma_px * pixel * distance) ** 2 * (np.eye(3) - np.outer(ray, ray))
    error = (
        across + image.pointing_covariance_at(point) + relative_covariance(frame, image.pose, point)
    )
    T = np.eye(3) - np.outer(ray, normal) / cosine
    lift = float(normal @ UP) / cosine * sigma_m
    covariance = T @ error @ T.T + lift**2 * np.outer(ray, ray)
    return GroundPoint(point, covariance, frame, normal)


def ground_normal(
    place: Float64[np.ndarray, " 2"], elevations: Elevations, half_m: float
) -> Vector3:
    """Unit normal, in the LSL and pointing up, of the ground around a point on the map.

    Of the best plane through a square of samples; vertical where too few are known.
    """
    steps = np.linspace(-half_m, half_m, 5)
    east, north = (axis.ravel() for axis in np.meshgrid(steps, steps))
    heights = elevations(place + np.column_stack([east, north]))
    known = np.isfinite(heights)
    if known.sum() < 6:  # noqa: PLR2004 - twice the unknowns of a plane
        return UP.copy()
    _, to_east, to_north = least_squares_plane(east[known], north[known], heights[known])
    normal = np.array([-to_north, -to_east, -1.0])
    return normal / np.linalg.norm(normal)


@dataclass(frozen=True, slots=True)
class MatchedPixel:
    """A pixel with its parallax."""

    left: tuple[float, float]
    """Point in the left epipolar image."""
    parallax_px: float
    sigma_px: float
    """Standard deviation of the parallax."""


def matched_pixel(
    point: tuple[float, float],
    eye: Eye,
    camera: CameraModel,
    geometry: EpipolarPair,
    parallax: ParallaxMap,
    sigma: ParallaxMap,
) -> MatchedPixel | None:
    """Match at a pixel of the left or right image as stored; None where there is none.

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

    Of several the nearest ground is used: it hides the others.
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
    """Values at sub-pixel positions: bilinear on continuous ground, else of the nearest pixel."""
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
    """Whether one image of a pair sees a point, by the parallax matched there.

    Matched nearer ground hides the point; UNKNOWN where it was not matched.
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
