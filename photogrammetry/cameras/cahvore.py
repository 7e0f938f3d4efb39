"""CAHVORE: the fisheye model of the Hazcams, with a moving entrance pupil (Gennery 2006).

A ray at the angle theta from the axis O starts at C + s(theta) O,

    s(theta) = (theta / sin theta - 1) (E0 + E1 theta^2 + E2 theta^4).

For an object point with d = P - C, z = d.O, l = d - z O and lambda = |l|, theta solves

    f(theta) = z sin - lambda cos - (theta - sin)(E0 + E1 theta^2 + E2 theta^4) = 0,

and is then compressed by the linearity L of the model type (1 perspective: L = 1, 2 fisheye: L = 0,
3 general: L = P, 0.37 on MER),

    chi = tan(L theta) / L  (L > 0),   theta  (L = 0),   sin(L theta) / L  (L < 0),

distorted, mu = R0 + R1 chi^2 + R2 chi^4, and projected by a CAHV camera from the point

    r = z' O + (1 + mu) l,      z' = lambda / chi.

Derivatives follow from the implicit function: f_theta dtheta = -sin dz + cos dlambda, with
dz = O.dP and dlambda = (l / lambda).dP.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.arrays import Directions, ImagePoints, ObjectPoints, PerPoint, Vector3
from solmap.photogrammetry.cameras.cahv import (
    Cahv,
    Partials,
    averaged_scale,
    check_perspective,
    check_unit,
    freeze_vectors,
    perspective_partials,
    perspective_rays,
)
from solmap.photogrammetry.cameras.cahvor import (
    NEWTON_STEPS,
    NEWTON_STOP,
    check_radial,
    largest_square,
    undistort,
)
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Pose

CHUNK = 16_384
"""Points projected at a time, so that the intermediate arrays stay in the processor's cache."""

ON_AXIS = 1e-8
"""Tangent below which a point counts as on the axis, as in JPL's library."""

LINEARITY = {1: 1.0, 2: 0.0}
"""Linearity of the perspective and the fisheye type; type 3 has a parameter for it."""


@dataclass(frozen=True, slots=True, eq=False)
class Cahvore:
    """A fisheye camera with a moving entrance pupil."""

    c: Vector3
    a: Vector3
    h: Vector3
    v: Vector3
    o: Vector3
    r: Vector3
    e: Vector3
    type: int
    parameter: float

    def __post_init__(self) -> None:
        freeze_vectors(self, ("c", "a", "h", "v", "o", "r", "e"))
        check_perspective(self.a, self.h, self.v)
        check_unit(self.o, "O")
        check_radial(self.r)
        if self.type not in (1, 2, 3):
            raise CameraError(f"a CAHVORE model must be of type 1, 2 or 3, not {self.type}")
        if not abs(self.parameter) <= 1:
            raise CameraError(
                f"P of a CAHVORE model must be between -1 and 1, not {self.parameter}"
            )

    @property
    def centre(self) -> Vector3:
        """C, metres: the entrance pupil of the ray along the axis."""
        return self.c

    @property
    def linearity(self) -> float:
        """L: 1 for a perspective camera, 0 for a fisheye."""
        return LINEARITY.get(self.type, self.parameter)

    @property
    def perspective(self) -> Cahv:
        """The CAHV camera that projects the compressed points."""
        return Cahv(self.c, self.a, self.h, self.v)

    def project(self, points: ObjectPoints) -> ImagePoints:
        """Image of object points; NaN behind the camera and beyond the range of the distortion."""
        image_points = np.empty((len(points), 2))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for start in range(0, len(points), CHUNK):
                here = slice(start, start + CHUNK)
                drawn = self._distort(points[here] - self.c).r
                along_h, along_v, along_a = np.stack([self.h, self.v, self.a]) @ drawn.T
                depth = np.where(along_a > 0, along_a, np.nan)
                image_points[here] = np.column_stack([along_h / depth, along_v / depth])
        return image_points

    def partials(self, points: ObjectPoints) -> tuple[ImagePoints, Partials]:
        """Image of object points, and its derivatives by them."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            drawn = self._distort(points - self.c)
            image_points = self.project(points)
            by_r = perspective_partials(self.perspective, drawn.r, image_points)
            return image_points, by_r @ self._r_by_p(drawn)

    def rays(self, image_points: ImagePoints) -> Directions:
        """Unit directions through image points; they start at `ray_origins`."""
        theta, sideways = self._angles(image_points)
        return np.sin(theta)[:, None] * sideways + np.cos(theta)[:, None] * self.o

    def ray_origins(self, image_points: ImagePoints) -> ObjectPoints:
        """Origins of the rays, metres: the pupil C + s(theta) O."""
        theta, _ = self._angles(image_points)
        square = theta * theta
        pupil = self.e[0] + square * (self.e[1] + square * self.e[2])
        ratio = np.where(theta < ON_AXIS, 0.0, theta / np.where(theta == 0, 1, np.sin(theta)) - 1)
        return self.c + (ratio * pupil)[:, None] * self.o

    def transform(self, target_from_model: Pose) -> Cahvore:
        """The same camera, expressed in the target frame of a pose."""
        turn = target_from_model.rotation
        c = target_from_model.apply(self.c[None])[0]
        return replace(
            self, c=c, a=turn @ self.a, h=turn @ self.h, v=turn @ self.v, o=turn @ self.o
        )

    def subframe(self, first_sample: int | float, first_line: int | float) -> Cahvore:
        """The model of a sub-frame whose first pixel was (first_sample, first_line), 0-based."""
        return replace(self, h=self.h - first_sample * self.a, v=self.v - first_line * self.a)

    def average(self, width: int, height: int, *, correct_half_pixel: bool = True) -> Cahvore:
        """The model of an image averaged over blocks of width x height pixels."""
        half = 0.5 * self.a if correct_half_pixel else 0.0 * self.a
        return replace(
            self, h=averaged_scale(self.h, width, half), v=averaged_scale(self.v, height, half)
        )

    def _distort(self, d: ObjectPoints) -> _Drawn:
        """Angles of points relative to C, and the points that the CAHV camera projects."""
        z = d @ self.o
        l = d - z[:, None] * self.o
        lam = np.sqrt(np.einsum("ij,ij->i", l, l))
        theta, theta_slope = self._theta(z, lam)
        chi = self._chi(theta)
        inside = (np.abs(self.linearity) * theta < np.pi / 2) & (chi**2 < largest_square(self.r))
        chi = np.where(inside, chi, np.nan)
        on_axis = chi < ON_AXIS
        drawn_z = np.where(on_axis, z, lam / np.where(on_axis, 1.0, chi))
        mu = self.r[0] + chi**2 * (self.r[1] + chi**2 * self.r[2])
        r = drawn_z[:, None] * self.o + (1.0 + mu)[:, None] * l
        return _Drawn(r=r, l=l, lam=lam, theta=theta, theta_slope=theta_slope, chi=chi, mu=mu)

    def _theta(self, z: PerPoint, lam: PerPoint) -> tuple[PerPoint, PerPoint]:
        """Solve f(theta) = 0 by Newton's method; returns the angle and the slope of f there."""
        e0, e1, e2 = self.e
        theta = np.arctan2(lam, z)
        for _ in range(NEWTON_STEPS):
            square = theta * theta
            sine, cosine = np.sin(theta), np.cos(theta)
            pupil = e0 + square * (e1 + square * e2)
            f = z * sine - lam * cosine - (theta - sine) * pupil
            slope = z * cosine + lam * sine - (1.0 - cosine) * pupil
            slope -= (theta - sine) * theta * (2.0 * e1 + 4.0 * e2 * square)
            step = f / slope
            theta = theta - step
            if not np.any(np.abs(step) > NEWTON_STOP):
                break
        sound = (np.abs(step) < 1e-10) & (slope > 0) & (theta >= -NEWTON_STOP)  # noqa: PLR2004 - slack
        return np.where(sound, np.maximum(theta, 0.0), np.nan), slope

    def _chi(self, theta: PerPoint) -> PerPoint:
        """Compress the angle by the linearity of the model."""
        linearity = self.linearity
        if linearity > 0:
            return np.tan(linearity * theta) / linearity
        if linearity < 0:
            return np.sin(linearity * theta) / linearity
        return theta

    def _chi_slope(self, theta: PerPoint) -> PerPoint:
        """d(chi)/d(theta)."""
        linearity = self.linearity
        if linearity > 0:
            return 1.0 / np.cos(linearity * theta) ** 2
        if linearity < 0:
            return np.cos(linearity * theta)
        return np.ones_like(theta)

    def _angles(self, image_points: ImagePoints) -> tuple[PerPoint, Directions]:
        """Angle from the axis of the rays through image points, and their direction about it."""
        seen = perspective_rays(self.a, self.h, self.v, image_points)
        z = seen @ self.o
        l = seen - z[:, None] * self.o
        lam = np.sqrt(np.einsum("ij,ij->i", l, l))
        chi = undistort(lam / np.where(z > 0, z, np.nan), self.r)
        linearity = self.linearity
        with np.errstate(invalid="ignore"):
            if linearity > 0:
                theta = np.arctan(linearity * chi) / linearity
            elif linearity < 0:
                theta = np.arcsin(linearity * chi) / linearity
            else:
                theta = chi
        return theta, l / np.where(lam > 0, lam, 1.0)[:, None]

    def _r_by_p(self, drawn: _Drawn) -> np.ndarray:
        """d(r)/dP, one 3 x 3 matrix per point."""
        on_axis = drawn.chi < ON_AXIS
        chi = np.where(on_axis, 1.0, drawn.chi)
        toward = drawn.l / np.where(drawn.lam > 0, drawn.lam, 1.0)[:, None]
        theta_by_p = (
            np.cos(drawn.theta)[:, None] * toward - np.sin(drawn.theta)[:, None] * self.o
        ) / drawn.theta_slope[:, None]
        chi_by_p = self._chi_slope(drawn.theta)[:, None] * theta_by_p
        z_by_p = toward / chi[:, None] - (drawn.lam / chi**2)[:, None] * chi_by_p
        z_by_p = np.where(on_axis[:, None], self.o, z_by_p)
        mu_by_chi = drawn.chi * (2.0 * self.r[1] + 4.0 * self.r[2] * drawn.chi**2)
        across = np.eye(3) - np.outer(self.o, self.o)
        return (
            self.o[:, None] * z_by_p[:, None, :]
            + (1.0 + drawn.mu)[:, None, None] * across
            + drawn.l[:, :, None] * (mu_by_chi[:, None] * chi_by_p)[:, None, :]
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """Intermediate results of projecting points; letters as in the module's formulas."""

    r: ObjectPoints
    l: ObjectPoints
    lam: PerPoint
    theta: PerPoint
    theta_slope: PerPoint
    chi: PerPoint
    mu: PerPoint
