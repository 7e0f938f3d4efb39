"""The normal case of stereo: both images of a pair resampled to one plane along the baseline.

With the projection centres C_l, C_r, the baseline b = C_r - C_l of length B and its unit vector e =
b / B, the common axis is the mean viewing direction made perpendicular to the baseline,

    z = unit(a - (a.e) e),        x = e,        y = z x e          (right, down, forward)

and one focal length f (pixels) is used for both axes and both images, so that rows correspond
exactly:

    x_l = c_x + f X/Z        y_l = c_y + f Y/Z        x_r = x_l - p        p = f B / Z

for a point (X, Y, Z) in the pair's frame (origin C_l). It corresponds to JPL's "linearised"
product, but with square pixels and an axis perpendicular to the baseline, so that there is no
vertical parallax; the archived products have neither (Di et al. 2008, section 2).

Size and centre follow from the projected borders of both images. A point in front of the cameras
has p > 0, so of the left image only x_l >= min x_r can have a partner and of the right one only x_r
<= max x_l: rows cover what both images show, samples the left image and as far to the left as the
right image reaches. The focal length is the mean scale of both cameras at the middle of their
images, so that resolution is preserved. A wide or strongly rotated field is cut at `LARGEST_FIELD`
times the longer side of the originals.

The ideal camera of a single image: square pixels, no distortion, rows level with the camera's.

An image without a stereo partner is used in matching and adjustment as the left image of a pair
whose right image is never measured: axis A of the camera (right, down, forward = H', A x H', A),
focal length and size those of the original. `NO_BASE_M` takes the place of the baseline; it is the
unit of a parallax that is never observed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.arrays import (
    Covariances3,
    Directions,
    Flags,
    Float64,
    ImagePoints,
    ObjectPoints,
    PerPoint,
    Rotation,
    Vector3,
)
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Frame, Pose

LARGEST_FIELD = 2.0
"""Longest side of epipolar images, relative to the longer side of the originals."""

STEEPEST_VIEW = np.sin(np.radians(10.0))
"""Sine of the smallest angle between baseline and view: below it, parallax hardly determines
distance."""

WIDEST_RAY = np.radians(80.0)
"""Angle from the common axis beyond which a ray is not projected to the image plane."""
CameraOfSize = tuple[CameraModel, tuple[int, int]]
NO_BASE_M = 1.0
"""Arbitrary; any length gives the same result."""
STEP_PX = 4.0
"""Step of the differences of directions in the middle of the image."""


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarPair:
    """The ideal stereo camera to which an exposure was resampled.

    `rover_from_pair` transforms (right, down, forward) coordinates with origin at the left camera
    to the rover frame. Image sizes are those of both resampled images.
    """

    rover_from_pair: Pose
    base_m: float
    focal_px: float
    centre_px: tuple[float, float]
    samples: int
    lines: int
    mast_in_rover: tuple[float, float, float] | None = None
    """The mast head, about which pointing errors rotate the cameras, metres; None: about the left
    camera."""

    def __post_init__(self) -> None:
        if not (self.base_m > 0 and self.focal_px > 0 and self.samples > 0 and self.lines > 0):
            raise CameraError(
                "a stereo pair needs a baseline, a focal length and a size above zero, not "
                f"{self.base_m} m, {self.focal_px} px, {self.samples} x {self.lines}"
            )

    @property
    def pivot_in_rover(self) -> Vector3:
        """Centre of rotation of pointing errors, in the rover frame, metres."""
        if self.mast_in_rover is None:
            return self.rover_from_pair.translation_m
        return np.array(self.mast_in_rover)

    @property
    def arm(self) -> Vector3:
        """From the pivot to the left camera, in the pair's axes, metres."""
        pose = self.rover_from_pair
        return (pose.translation_m - self.pivot_in_rover) @ pose.rotation

    def move(self, rover_from_other: Pose) -> EpipolarPair:
        """In the frame of another rover position, with the mast head moved too."""
        mast = self.mast_in_rover and tuple(rover_from_other.apply(self.pivot_in_rover).tolist())
        pose = rover_from_other @ self.rover_from_pair
        return replace(self, rover_from_pair=pose, mast_in_rover=mast)

    def turn(self, rotation: Float64[np.ndarray, "3 3"]) -> EpipolarPair:
        """Rotated about the pivot, by a rotation in the pair's axes."""
        pose, turned = self.rover_from_pair, self.rover_from_pair.rotation @ rotation
        centre = self.pivot_in_rover + turned @ self.arm
        return replace(self, rover_from_pair=Pose(pose.target, pose.source, turned, centre))

    def project(self, points_in_pair: ObjectPoints) -> tuple[ImagePoints, PerPoint]:
        """Left image points and parallaxes of points in the pair's frame; NaN behind the camera."""
        x, y, z = points_in_pair.T
        z = np.where(z > 0, z, np.nan)
        left = np.column_stack(
            [
                self.centre_px[0] + self.focal_px * x / z,
                self.centre_px[1] + self.focal_px * y / z,
            ]
        )
        return left, self.focal_px * self.base_m / z

    def triangulate(self, left: ImagePoints, parallax_px: PerPoint) -> ObjectPoints:
        """Points in the pair's frame, metres; NaN where the parallax is not positive."""
        z = self.focal_px * self.base_m / np.where(parallax_px > 0, parallax_px, np.nan)
        return np.column_stack(
            [
                (left[:, 0] - self.centre_px[0]) * z / self.focal_px,
                (left[:, 1] - self.centre_px[1]) * z / self.focal_px,
                z,
            ]
        )

    def covariances(
        self, left: ImagePoints, parallax_px: PerPoint, sigma_px: float, sigma_parallax_px: float
    ) -> Covariances3:
        """Covariance of triangulated points in the pair's frame, square metres.

        The error of the range grows with the square of the distance: sigma_Z = Z^2 sigma_p / (B f).
        """
        points = self.triangulate(left, parallax_px)
        z = points[:, 2]
        along = points / parallax_px[:, None]  # dP/dp = -P/p
        across = (z * sigma_px / self.focal_px) ** 2
        covariances = sigma_parallax_px**2 * along[:, :, None] * along[:, None, :]
        covariances[:, 0, 0] += across
        covariances[:, 1, 1] += across
        return covariances

    def shows(self, image_points: ImagePoints) -> Flags:
        """Whether points lie on the resampled images; false for NaN."""
        last = np.array([self.samples, self.lines]) - 1
        with np.errstate(invalid="ignore"):
            within = (image_points >= 0) & (image_points <= last)
        return within[:, 0] & within[:, 1]

    def rays(self, image_points: ImagePoints) -> ObjectPoints:
        """(x, y, 1) in the pair's frame through points of either image, at unit distance ahead."""
        plane = (image_points - np.asarray(self.centre_px)) / self.focal_px
        return np.column_stack([plane, np.ones(len(image_points))])

    def directions(self, image_points: ImagePoints) -> Directions:
        """Unit directions in the rover frame through points of either image."""
        rays = self.rays(image_points)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return self.rover_from_pair.turn(rays)

    def cameras(self) -> tuple[Cahv, Cahv]:
        """The left and right camera of the resampled images, in the rover frame."""
        right, down, forward = self.rover_from_pair.rotation.T
        h = self.focal_px * right + self.centre_px[0] * forward
        v = self.focal_px * down + self.centre_px[1] * forward
        left_centre = self.rover_from_pair.translation_m
        return (
            Cahv(left_centre, forward, h, v),
            Cahv(left_centre + self.base_m * right, forward, h, v),
        )


def epipolar_pair(
    left: CameraModel,
    right: CameraModel,
    left_size: tuple[int, int],
    right_size: tuple[int, int],
    rover: Frame,
    pair: Frame,
) -> EpipolarPair:
    """The epipolar geometry of two cameras given in the rover frame; sizes are (samples, lines)."""
    base = right.centre - left.centre
    base_m = float(np.linalg.norm(base))
    if not base_m > 0:
        raise CameraError(
            f"two cameras at one position, {left.centre}, have no baseline: not a stereo pair"
        )
    eyes = ((left, left_size), (right, right_size))
    rotation = _rover_from_pair(base / base_m, eyes)
    focal_px = float(np.mean([_scale_at_middle(camera, size) for camera, size in eyes]))
    outlines = [
        focal_px * _on_plane(camera.rays(border_points(size)) @ rotation) for camera, size in eyes
    ]
    longest = LARGEST_FIELD * max(*left_size, *right_size)
    (first_sample, samples), (first_line, lines) = _extent(outlines[0], outlines[1], longest)
    return EpipolarPair(
        rover_from_pair=Pose(rover, pair, rotation, left.centre),
        base_m=base_m,
        focal_px=focal_px,
        centre_px=(-first_sample, -first_line),
        samples=samples,
        lines=lines,
    )


def projection_partials(
    points_in_pair: ObjectPoints, focal_px: PerPoint | float, base_m: PerPoint | float
) -> Float64[np.ndarray, "n 3 3"]:
    """Derivatives of (left sample, left line, parallax) by points in the pair's frame, px/m.

    Focal length and baseline are common or given for each point; NaN behind the camera.
    """
    x, y, z = points_in_pair.T
    z = np.where(z > 0, z, np.nan)
    partials = np.zeros((len(points_in_pair), 3, 3))
    partials[:, 0, 0] = partials[:, 1, 1] = focal_px / z
    partials[:, 0, 2], partials[:, 1, 2] = -focal_px * x / z**2, -focal_px * y / z**2
    partials[:, 2, 2] = -focal_px * base_m / z**2
    return partials


def _middle(size: tuple[int, int]) -> ImagePoints:
    return np.array([[(size[0] - 1) / 2, (size[1] - 1) / 2]])


def _rover_from_pair(e: Vector3, eyes: tuple[CameraOfSize, CameraOfSize]) -> Rotation:
    """Columns right, down, forward of the pair in the rover frame."""
    a = np.sum([camera.rays(_middle(size))[0] for camera, size in eyes], axis=0)
    a /= np.linalg.norm(a)
    z = a - (a @ e) * e
    if not np.linalg.norm(z) > STEEPEST_VIEW:
        raise CameraError(
            f"the viewing direction is along the baseline (view {a.round(3)}, baseline "
            f"{e.round(3)}): there is no common image plane; use a pair that looks across its "
            "baseline"
        )
    z /= np.linalg.norm(z)
    return np.column_stack([e, np.cross(z, e), z])


def _scale_at_middle(camera: CameraModel, size: tuple[int, int], step_px: float = 4.0) -> float:
    """Pixels per radian at the middle of an image, mean of both axes."""
    steps = step_px * np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    rays = camera.rays(_middle(size) + steps)
    turns = np.linalg.norm(rays[1::2] - rays[::2], axis=1)
    return float(np.mean(2.0 * step_px / turns))


def border_points(size: tuple[int, int], points: int = 33) -> ImagePoints:
    """Points along the outer edges of an image; `size` is (samples, lines)."""
    x = np.linspace(-0.5, size[0] - 0.5, points)
    y = np.linspace(-0.5, size[1] - 0.5, points)
    along_x = [np.column_stack([x, np.full(points, edge)]) for edge in (y[0], y[-1])]
    along_y = [np.column_stack([np.full(points, edge), y]) for edge in (x[0], x[-1])]
    return np.concatenate(along_x + along_y)


def _on_plane(rays_in_pair: Directions) -> ImagePoints:
    """Intersections of rays with the plane at distance one; rays far off the axis are limited."""
    across = np.linalg.norm(rays_in_pair[:, :2], axis=1)
    angle = np.minimum(np.arctan2(across, rays_in_pair[:, 2]), WIDEST_RAY)
    return rays_in_pair[:, :2] * (np.tan(angle) / np.maximum(across, 1e-300))[:, None]


def _extent(
    left: ImagePoints, right: ImagePoints, longest: float
) -> tuple[tuple[float, int], tuple[float, int]]:
    """First pixel and size along samples and lines, relative to the common axis."""
    left_low, left_high = np.nanmin(left, axis=0), np.nanmax(left, axis=0)
    right_low, right_high = np.nanmin(right, axis=0), np.nanmax(right, axis=0)
    samples = _interval(min(left_low[0], right_low[0]), left_high[0], longest)
    lines = _interval(max(left_low[1], right_low[1]), min(left_high[1], right_high[1]), longest)
    if right_low[0] >= left_high[0] or lines[1] < 1:
        raise CameraError(
            f"the images have no common field of view: left spans {left_low.round()} to "
            f"{left_high.round()} px about the common axis, right {right_low.round()} to "
            f"{right_high.round()}; are they of one exposure?"
        )
    return samples, lines


def _interval(low: float, high: float, longest: float) -> tuple[float, int]:
    """Centre of the first pixel and number of pixels that cover an interval, at most `longest`."""
    surplus = max(0.0, (high - low) - longest) / 2
    low, high = low + surplus, high - surplus
    return float(low) + 0.5, round(float(high - low))


def single_image(
    camera: CameraModel, size: tuple[int, int], rover: Frame, frame: Frame
) -> EpipolarPair:
    """The geometry for resampling an image without partner; `size` is (samples, lines).

    `camera` is in the rover frame; the result covers the whole image.

    Raises:
        CameraError: the image spans 180 degrees or more.
    """
    middle = (np.array([size], dtype=np.float64) - 1.0) / 2.0
    steps = np.array([[0.0, 0.0], [-STEP_PX, 0.0], [STEP_PX, 0.0], [0.0, -STEP_PX], [0.0, STEP_PX]])
    ahead, left, right, above, below = camera.rays(middle + steps)
    across = right - left - ((right - left) @ ahead) * ahead
    x = across / np.linalg.norm(across)
    rotation = np.column_stack([x, np.cross(ahead, x), ahead])
    slopes = [
        np.linalg.norm(b / (b @ ahead) - a / (a @ ahead))
        for a, b in ((left, right), (above, below))
    ]
    focal_px = float(np.mean([2.0 * STEP_PX / slope for slope in slopes]))
    edge = _on_unit_plane(camera.rays(border_points(size)) @ rotation, camera) * focal_px
    low, high = edge.min(axis=0), edge.max(axis=0)
    samples, lines = np.round(high - low).astype(int).tolist()
    return EpipolarPair(
        rover_from_pair=Pose(rover, frame, rotation, camera.centre),
        base_m=NO_BASE_M,
        focal_px=focal_px,
        centre_px=(float(-low[0]) - 0.5, float(-low[1]) - 0.5),
        samples=samples,
        lines=lines,
    )


def _on_unit_plane(rays: Directions, camera: CameraModel) -> ImagePoints:
    """Intersections of rays with the plane at distance one."""
    if (rays[:, 2] <= 0).any():
        raise CameraError(
            f"the camera at {camera.centre} has a field of more than 180 degrees, which no image "
            "plane can hold"
        )
    return rays[:, :2] / rays[:, 2:]
