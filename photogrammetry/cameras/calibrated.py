"""Cameras of calibration tools: Brown-Conrady and fisheye (Kannala-Brandt).

A point P has, for a camera at C with the unit vectors right, down and forward the coordinates (X,
Y, Z) = ((P - C).right, (P - C).down, (P - C).forward). The lens maps it to (u, v) in the plane at
unit distance, and focal lengths f and principal point c (pixels) convert that to a pixel:

    sample = f_x u + c_x        line = f_y v + c_y

**Brown-Conrady** (Brown 1971; OpenCV `calibrateCamera`, Kalibr `radtan`, ASP `TSAI`), coefficients
k1 k2 p1 p2 [k3 [k4 k5 k6]], with x = X/Z, y = Y/Z and r² = x² + y²:

    u = x q + 2 p1 x y + p2 (r² + 2 x²)         q = (1 + k1 r² + k2 r⁴ + k3 r⁶)
    v = y q + p1 (r² + 2 y²) + 2 p2 x y           / (1 + k4 r² + k5 r⁴ + k6 r⁶)

**Fisheye** (Kannala & Brandt 2006; OpenCV `fisheye`, Kalibr `equidistant`), coefficients k1 ... k4,
with theta the angle from the forward axis and rho = sqrt(X² + Y²):

    (u, v) = theta (1 + k1 theta² + k2 theta⁴ + k3 theta⁶ + k4 theta⁸) (X, Y) / rho

Beyond the first extremum of the polynomial, points far outside the field would reappear in the
image; such points have no image (NaN). A camera without distortion is a `Cahv`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.polynomial import polynomial

from solmap.photogrammetry.arrays import (
    Directions,
    Float64,
    ImagePoints,
    ObjectPoints,
    PerPoint,
    Rotation,
    Vector3,
)
from solmap.photogrammetry.cameras.cahv import Partials
from solmap.photogrammetry.errors import CameraError, FrameError
from solmap.photogrammetry.frames import Pose, read_only

NEWTON_STEPS = 50
SETTLED = 1e-12
"""Largest last step of an inverse, in units of the focal length."""
NEAR_LIMIT = 0.999
"""Fraction of the largest distance from the axis below which iterations start."""
ORTHONORMAL = 1e-9

PlanePoints = Float64[np.ndarray, "n 2"]
"""(u, v) in the plane at unit distance, distorted or not."""
PlanePartials = Float64[np.ndarray, "n 2 3"]
"""d(u, v) / d(X, Y, Z)."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCamera:
    """Common part of both models: position, directions, focal lengths and principal point."""

    centre: Vector3
    """Projection centre C, metres."""
    axes: Rotation
    """Rows right, down, forward, in the model's frame."""
    focal_px: tuple[float, float]
    """Across and down."""
    principal_px: tuple[float, float]
    """(sample, line); (0, 0) is the centre of the first pixel."""
    distortion: tuple[float, ...]

    coefficient_counts: ClassVar[tuple[int, ...]] = ()
    """Possible numbers of coefficients of a model."""

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "centre", read_only(self.centre, (3,), "the centre"))
            object.__setattr__(self, "axes", read_only(self.axes, (3, 3), "the axes"))
        except (FrameError, TypeError, ValueError) as error:
            raise CameraError(str(error)) from None
        off = np.abs(self.axes @ self.axes.T - np.eye(3)).max()
        if not (off <= ORTHONORMAL and np.linalg.det(self.axes) > 0):
            raise CameraError(
                "the axes of a camera must be right, down and forward, at right angles"
            )
        numbers = (*self.focal_px, *self.principal_px, *self.distortion)
        if not (np.isfinite(numbers).all() and min(self.focal_px) > 0):
            raise CameraError(
                f"focal lengths must be above zero and all numbers finite, not {numbers}"
            )
        if len(self.distortion) not in self.coefficient_counts:
            counts = " or ".join(map(str, self.coefficient_counts))
            raise CameraError(
                f"{type(self).__name__} has {counts} coefficients, not {len(self.distortion)}"
            )

    def project(self, points: ObjectPoints) -> ImagePoints:
        """Image of object points; NaN behind the camera and beyond the range of the distortion."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            plane, _ = self._distort((points - self.centre) @ self.axes.T)
        return plane * self.focal_px + self.principal_px

    def partials(self, points: ObjectPoints) -> tuple[ImagePoints, Partials]:
        """Image of object points, and its derivatives by them; NaN where there is no image."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            plane, by_camera = self._distort((points - self.centre) @ self.axes.T)
        by_points = by_camera @ self.axes * np.array(self.focal_px)[:, None]
        return plane * self.focal_px + self.principal_px, by_points

    def rays(self, image_points: ImagePoints) -> Directions:
        """Unit directions from C through image points; NaN where the distortion has no inverse."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            rays = self._undistort((image_points - self.principal_px) / self.focal_px)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True) @ self.axes

    def ray_origins(self, image_points: ImagePoints) -> ObjectPoints:
        """Origins of the rays, metres: C for every image point."""
        return np.broadcast_to(self.centre, (len(image_points), 3))

    def transform(self, target_from_model: Pose) -> CalibratedCamera:
        """The same camera, expressed in the target frame of a pose."""
        centre = target_from_model.apply(self.centre[None])[0]
        return replace(self, centre=centre, axes=self.axes @ target_from_model.rotation.T)

    def subframe(self, first_sample: int | float, first_line: int | float) -> CalibratedCamera:
        """The model of a sub-frame whose first pixel was (first_sample, first_line), 0-based."""
        x, y = self.principal_px
        return replace(self, principal_px=(x - first_sample, y - first_line))

    def average(self, width: int, height: int) -> CalibratedCamera:
        """The model of an image averaged over blocks of width x height pixels."""
        (fx, fy), (x, y) = self.focal_px, self.principal_px
        principal = (x + 0.5) / width - 0.5, (y + 0.5) / height - 0.5
        return replace(self, focal_px=(fx / width, fy / height), principal_px=principal)

    def _distort(self, d: ObjectPoints) -> tuple[PlanePoints, PlanePartials]:
        """Plane points of (right, down, forward) relative to C, and their derivatives."""
        raise NotImplementedError

    def _undistort(self, plane: PlanePoints) -> ObjectPoints:
        """Directions (right, down, forward), of any length, of plane points."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class BrownConrady(CalibratedCamera):
    """A perspective camera with radial and tangential distortion: k1 k2 p1 p2 [k3 [k4 k5 k6]]."""

    coefficient_counts: ClassVar[tuple[int, ...]] = (4, 5, 8)

    def _distort(self, d: ObjectPoints) -> tuple[PlanePoints, PlanePartials]:
        depth = np.where(d[:, 2] > 0, d[:, 2], np.nan)
        ideal = d[:, :2] / depth[:, None]
        ideal[(ideal**2).sum(axis=1) >= self._largest_square()] = np.nan
        plane, slopes = self._bend(ideal)
        ideal_by_d = np.zeros((len(d), 2, 3))
        ideal_by_d[:, 0, 0] = ideal_by_d[:, 1, 1] = 1.0 / depth
        ideal_by_d[:, :, 2] = -ideal / depth[:, None]
        return plane, slopes @ ideal_by_d

    def _undistort(self, plane: PlanePoints) -> ObjectPoints:
        """Undistort by Newton's method, starting from the plane points."""
        longest = NEAR_LIMIT * np.sqrt(self._largest_square())
        ideal, step = _shortened(plane, longest), np.full_like(plane, np.inf)
        for _ in range(NEWTON_STEPS):
            bent, slopes = self._bend(ideal)
            determinant = slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]
            off = (bent - plane) / determinant[:, None]
            step = np.column_stack(
                [
                    slopes[:, 1, 1] * off[:, 0] - slopes[:, 0, 1] * off[:, 1],
                    slopes[:, 0, 0] * off[:, 1] - slopes[:, 1, 0] * off[:, 0],
                ]
            )
            ideal = _shortened(ideal - step, longest)
            if not np.any(np.abs(step) > SETTLED):
                break
        lost = ~(np.abs(step) <= SETTLED * (1.0 + np.abs(ideal))).all(axis=1)
        ideal[lost] = np.nan
        return np.column_stack([ideal, np.ones(len(ideal))])

    def _bend(self, ideal: PlanePoints) -> tuple[PlanePoints, Float64[np.ndarray, "n 2 2"]]:
        """Distorted points of the plane, and the derivatives."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, 0.0, 0.0, 0.0, 0.0)[:8]
        x, y = ideal.T
        s = x * x + y * y
        above, below = 1 + s * (k1 + s * (k2 + s * k3)), 1 + s * (k4 + s * (k5 + s * k6))
        q = above / below
        q_by_s = k1 + s * (2 * k2 + s * 3 * k3) - q * (k4 + s * (2 * k5 + s * 3 * k6))
        q_by_s = q_by_s / below
        plane = np.column_stack(
            [
                x * q + 2 * p1 * x * y + p2 * (s + 2 * x * x),
                y * q + p1 * (s + 2 * y * y) + 2 * p2 * x * y,
            ]
        )
        slopes = np.empty((len(ideal), 2, 2))
        slopes[:, 0, 0] = q + 2 * x * x * q_by_s + 2 * p1 * y + 6 * p2 * x
        slopes[:, 1, 1] = q + 2 * y * y * q_by_s + 6 * p1 * y + 2 * p2 * x
        slopes[:, 0, 1] = slopes[:, 1, 0] = 2 * x * y * q_by_s + 2 * p1 * x + 2 * p2 * y
        return plane, slopes

    def _largest_square(self) -> float:
        """Square of the largest r up to which r q(r) increases."""
        k1, k2, _, _, k3, k4, k5, k6 = (*self.distortion, 0.0, 0.0, 0.0, 0.0)[:8]
        above, below = np.array([1.0, k1, k2, k3]), np.array([1.0, k4, k5, k6])
        twice = np.array([0.0, 2.0])  # 2 s
        grown = polynomial.polyadd(above, polynomial.polymul(twice, polynomial.polyder(above)))
        slope = polynomial.polysub(
            polynomial.polymul(grown, below),
            polynomial.polymul(twice, polynomial.polymul(above, polynomial.polyder(below))),
        )
        return min(_first_root(slope), _first_root(below))


@dataclass(frozen=True, slots=True, eq=False)
class Fisheye(CalibratedCamera):
    """A camera whose image radius increases with the angle from its axis: k1 k2 k3 k4."""

    coefficient_counts: ClassVar[tuple[int, ...]] = (4,)

    def _distort(self, d: ObjectPoints) -> tuple[PlanePoints, PlanePartials]:
        rho, z = np.linalg.norm(d[:, :2], axis=1), d[:, 2]
        on_axis = rho == 0.0
        theta = np.arctan2(rho, z)
        theta[theta >= self._largest_angle()] = np.nan
        radius, slope = self._radius(theta)
        u = d[:, :2] / np.where(on_axis, 1.0, rho)[:, None]
        per_metre = np.where(on_axis, 1.0 / np.where(z > 0, z, np.nan), radius / rho)
        square = rho * rho + z * z
        partials = np.empty((len(d), 2, 3))
        outer = u[:, :, None] * u[:, None, :]
        partials[:, :, :2] = (slope * z / square)[:, None, None] * outer
        partials[:, :, :2] += per_metre[:, None, None] * (np.eye(2) - outer)
        partials[:, :, 2] = -(slope * rho / square)[:, None] * u
        return per_metre[:, None] * d[:, :2], partials

    def _undistort(self, plane: PlanePoints) -> ObjectPoints:
        """Undistort by Newton's method for the angle."""
        radius, largest = np.linalg.norm(plane, axis=1), self._largest_angle()
        theta, step = np.minimum(radius, NEAR_LIMIT * largest), np.full_like(radius, np.inf)
        for _ in range(NEWTON_STEPS):
            reached, slope = self._radius(theta)
            step = (reached - radius) / slope
            theta = np.clip(theta - step, 0.5 * theta, NEAR_LIMIT * largest + 0.001 * theta)
            if not np.any(np.abs(step) > SETTLED):
                break
        theta = np.where(np.abs(step) <= SETTLED * (1.0 + theta), theta, np.nan)
        across = np.sin(theta) / np.where(radius > 0, radius, 1.0)
        return np.column_stack([across[:, None] * plane, np.cos(theta)])

    def _radius(self, theta: PerPoint) -> tuple[PerPoint, PerPoint]:
        """Distance from the principal point of points at angles from the axis, and its slope."""
        k1, k2, k3, k4 = self.distortion
        s = theta * theta
        radius = theta * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        return radius, 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))

    def _largest_angle(self) -> float:
        """Angle up to which the image radius increases, radians; 180 degrees at most."""
        k1, k2, k3, k4 = self.distortion
        square = _first_root(np.array([1.0, 3 * k1, 5 * k2, 7 * k3, 9 * k4]))
        return float(min(np.sqrt(square), np.pi))


def _first_root(coefficients: Float64[np.ndarray, " _"]) -> float:
    """The smallest root above zero of a polynomial, lowest power first; infinity if it has none."""
    trimmed = polynomial.polytrim(coefficients)
    roots = polynomial.polyroots(trimmed) if len(trimmed) > 1 else np.zeros(0)
    real = roots[np.abs(roots.imag) <= 1e-12 * np.abs(roots)].real
    return float(min(real[real > 0], default=np.inf))


def _shortened(plane: PlanePoints, longest: float) -> PlanePoints:
    """Points moved towards the axis where they are farther from it than `longest`."""
    length = np.linalg.norm(plane, axis=1, keepdims=True)
    return plane * np.minimum(1.0, longest / np.where(length > 0, length, 1.0))
