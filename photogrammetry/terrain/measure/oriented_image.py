"""Images with poses in the LSL, and the accuracy of ground points projected into them.

The pose of an image's stop in the LSL has the covariance C_s of a rotation vector d about the
stop's centre c and a shift dc; the pointing error m of the mast, with covariance C_m, rotates the
camera about the mast head v. A point X rigidly attached to the stop moves by dc + d x (X - c). Its
covariances by the pose and by the pointing are

    C_s(X) = J C_s J',    J = | -[X - c]   I |,       C_m(X) = [X - v] C_m [X - v]'.

A ground point X has the covariance C_X. With the partial derivatives P of its image point with
respect to X, the covariance of the image point is

    C_u = P (C_X + C_rel(X) + C_m(X)) P'.

C_rel is the covariance of one stop relative to another. Only the covariance of each stop relative
to the held stop is stored. As in the stepwise adjustment, the error of the less accurate stop is
assumed to include that of the other one as a rigid motion, so C_rel is the positive semidefinite
part of the difference of both covariances at X; within a stop it is zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Covariance3, Flags, Float64, ImagePoints, Vector3
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.photogrammetry.terrain.dtm.records import PoseCovariance

ImagePlace = Float64[np.ndarray, " 2"]
"""(sample, line)."""
Covariance2 = Float64[np.ndarray, "2 2"]
STEP_M = 1e-4
"""Step of numerical derivatives as a fraction of the distance from camera to point."""


@dataclass(frozen=True, slots=True, eq=False)
class StopPose:
    """Pose of a stop in the LSL, with covariance."""

    stop: StopId
    lsl_from_rover: Pose
    covariance: PoseCovariance

    def covariance_at(self, point_in_lsl: Vector3) -> Covariance3:
        """Covariance of a point that is rigidly attached to the stop."""
        J = np.hstack([-cross_matrix(point_in_lsl - self.lsl_from_rover.translation_m), np.eye(3)])
        return J @ self.covariance @ J.T


@dataclass(frozen=True, slots=True, eq=False)
class Pointing:
    """Correction of the pointing of a label, as a rotation vector in the rover frame, radians."""

    turn: Vector3
    covariance: Covariance3

    @classmethod
    def of_label(cls, sigma: float) -> Pointing:
        """No correction, with the standard deviation `sigma` in radians per axis."""
        return cls(np.zeros(3), sigma**2 * np.eye(3))


@dataclass(frozen=True, slots=True, eq=False)
class OrientedImage:
    """An image with its camera in the LSL."""

    id: str
    pose: StopPose
    camera: CameraModel
    """Camera model in the LSL, with corrected pointing."""
    size: tuple[int, int]
    """(samples, lines)."""
    pivot_in_lsl: Vector3
    """The mast head, about which pointing errors rotate the camera."""
    pointing_covariance: Covariance3
    """Pointing covariance of a rotation vector in the LSL."""

    @classmethod
    def of(cls, image: RoverImage, pose: StopPose, pointing: Pointing) -> OrientedImage:
        """An image with its pointing and the pose of its stop."""
        if pose.stop != image.stop or pose.lsl_from_rover.target != LSL:
            raise TerrainError(f"{image.id} was taken at {image.stop}, not at {pose.stop}")
        pivot = pointing_pivot(image)
        camera = apply_pointing(image, pointing.turn).camera.transform(pose.lsl_from_rover)
        turn = pose.lsl_from_rover.rotation
        return cls(
            image.id,
            pose,
            camera,
            (image.samples, image.lines),
            pose.lsl_from_rover.apply(pivot[None])[0],
            turn @ pointing.covariance @ turn.T,
        )

    def pointing_covariance_at(self, point_in_lsl: Vector3) -> Covariance3:
        """Covariance of a point by the error of the camera's pointing only."""
        lever = cross_matrix(point_in_lsl - self.pivot_in_lsl)
        return lever @ self.pointing_covariance @ lever.T

    def ray(self, image_point: ImagePlace) -> tuple[Vector3, Vector3]:
        """Origin and direction, in the LSL, of the ray through an image point."""
        pixel = image_point[None]
        return self.camera.ray_origins(pixel)[0].copy(), self.camera.rays(pixel)[0]

    def shows(self, image_point: ImagePlace) -> bool:
        """Whether a point is inside the image, including the outer halves of border pixels."""
        return bool(inside_image(image_point[None], self.size)[0])


def inside_image(image_points: ImagePoints, size: tuple[int, int]) -> Flags:
    """Which points are inside an image, including the outer halves of border pixels."""
    first, last = np.array([-0.5, -0.5]), np.array(size) - 0.5
    inside: Flags = np.logical_and.reduce(
        (image_points >= first) & (image_points <= last),
        axis=1,  # False for NaN
    )
    return inside


def pointing_pivot(image: RoverImage) -> Vector3:
    """Point about which pointing errors rotate an image's camera, in the rover frame."""
    return image.camera.centre if image.mast_in_rover is None else np.array(image.mast_in_rover)


def apply_pointing(image: RoverImage, pointing: Vector3) -> RoverImage:
    """The image with its camera rotated by a pointing correction.

    `pointing` is a rotation vector in the rover frame; the camera rotates about the mast head.
    """
    rover, pivot = image.stop.frame, pointing_pivot(image)
    turn = ScipyRotation.from_rotvec(pointing).as_matrix()
    return replace(
        image, camera=image.camera.transform(Pose(rover, rover, turn, pivot - turn @ pivot))
    )


def cross_matrix(vector: Vector3) -> Covariance3:
    """[v] with [v] w = v x w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def relative_covariance(one: StopPose, other: StopPose, point_in_lsl: Vector3) -> Covariance3:
    """Covariance of a point by the relative pose of two stops."""
    if one.stop == other.stop:
        return np.zeros((3, 3))
    first, second = one.covariance_at(point_in_lsl), other.covariance_at(point_in_lsl)
    difference = second - first if np.trace(second) > np.trace(first) else first - second
    variances, axes = np.linalg.eigh((difference + difference.T) / 2)
    return (axes * np.maximum(variances, 0.0)) @ axes.T


def partials(camera: CameraModel, point: Vector3) -> Float64[np.ndarray, "2 3"]:
    """Derivatives of an image point with respect to its object point, pixels per metre."""
    step = STEP_M * max(float(np.linalg.norm(point - camera.centre)), 1e-3)
    steps = step * np.eye(3)
    return (camera.project(point + steps) - camera.project(point - steps)).T / (2 * step)


def image_covariance(image: OrientedImage, point: Vector3, covariance: Covariance3) -> Covariance2:
    """Covariance of an image point, pixels squared.

    `covariance` is that of the object point relative to the stop of the image.
    """
    P = partials(image.camera, point)
    return P @ (covariance + image.pointing_covariance_at(point)) @ P.T


def image_covariance_from(
    image: OrientedImage, point: Vector3, own: Covariance3, frame: StopPose
) -> Covariance2:
    """Covariance in the image if `own`, of the object point, is relative to the stop `frame`."""
    return image_covariance(image, point, own + relative_covariance(frame, image.pose, point))


@dataclass(frozen=True, slots=True)
class Ellipse:
    """A standard error ellipse; 2.15 times its size contains 90 percent."""

    semi_major: float
    semi_minor: float
    angle: float
    """Radians of the major axis, from the first axis towards the second."""

    @classmethod
    def of(cls, covariance: Covariance2) -> Ellipse:
        """The ellipse of a covariance."""
        variances, axes = np.linalg.eigh(covariance)
        minor, major = np.sqrt(np.maximum(variances, 0.0)).tolist()
        first, second = axes[:, 1]
        return cls(major, minor, float(np.arctan2(second, first) % np.pi))


def epipolar_curve(
    from_image: OrientedImage,
    image_point: ImagePlace,
    into: OrientedImage,
    ranges_m: Float64[np.ndarray, " n"],
) -> tuple[Float64[np.ndarray, "k 2"], Float64[np.ndarray, " k"]]:
    """Projection of an image ray into another image, and the ranges of its points inside it."""
    start, ray = from_image.ray(image_point)
    seen = into.camera.project(start + ranges_m[:, None] * ray)
    on_it = inside_image(seen, into.size)
    return seen[on_it], ranges_m[on_it]
