"""CAHVOR: CAHV with radial distortion about an axis O of its own (Gennery 2001, 2006).

With d = P - C, w = d.O and the component of d perpendicular to the axis, l = d - w O, the point is
moved outwards before it is projected by a CAHV camera,

    tau = l.l / w^2        mu = R0 + R1 tau + R2 tau^2        d' = d + mu l = (1 + mu) d - mu w O,

so that only the four products of d with H, V, A, O and its length are needed:

    x = ((1 + mu) d.H - mu w O.H) / ((1 + mu) d.A - mu w O.A),     y with V for H.

Backwards, a CAHV ray r' has the tangent tan' = |l'| / w' and the true one solves tan (1 + R0 + R1
tan^2 + R2 tan^4) = tan'. R0 is not zero in flight models and O may lie degrees from A (7.5 for
Spirit's left Navcam), so the usual principal point with k1, k2 is not sufficient.

    dd'/dP = I + mu (I - O O') + l [ (R1 + 2 R2 tau) ((2 / w^2) l' (I - O O') - (2 tau / w) O') ]

O is used unchanged: with the six digits of a label its length is one within 1e-6, and projecting
and back-projecting agree within 1e-7 px (1e-3 px for CAHVORE). With a true unit vector they agree
within rounding, so readers of labels use O / |O|.

CAHVOR and CAHVORE share the radial polynomial, its inverse and the limit of its use. A point at the
distance chi from the distortion axis (a tangent for CAHVOR, an angle-like quantity for CAHVORE) is
imaged at the distance

    chi' = chi (1 + R0 + R1 chi^2 + R2 chi^4).

Beyond the first zero of d(chi')/d(chi) = 1 + R0 + 3 R1 chi^2 + 5 R2 chi^4 the polynomial is not
monotonic: points far outside the field would reappear in the image. Such points have no image.
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
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Pose

NEWTON_STEPS = 50
NEWTON_STOP = 1e-14
"""Relative change at which the iteration stops; JPL stops at 1e-8, which costs a round trip 7e-8
px."""
CHUNK = 16_384
"""Points projected at a time, so that the intermediate arrays stay in the processor's cache."""


def check_radial(r: Vector3) -> None:
    """Reject a polynomial that mirrors or collapses the image on its axis."""
    if not 1.0 + r[0] > 0:
        raise CameraError(f"R0 = {r[0]:g} of a camera model: the scale 1 + R0 must be above zero")


def largest_square(r: Vector3) -> float:
    """Square of the largest chi that the polynomial maps uniquely; infinity if it is monotonic."""
    linear, quadratic, constant = 3.0 * r[1], 5.0 * r[2], 1.0 + r[0]
    if quadratic == 0.0:
        with np.errstate(over="ignore"):
            return float(-constant / linear) if linear < 0 else np.inf
    discriminant = linear * linear - 4.0 * quadratic * constant
    if discriminant < 0:
        return np.inf
    # Stable for tiny quadratic terms: the roots are q / quadratic and constant / q.
    q = -0.5 * (linear + np.copysign(np.sqrt(discriminant), linear))
    with np.errstate(over="ignore"):
        roots = [root for root in (q / quadratic, constant / q if q else np.inf) if root > 0]
    return float(min(roots, default=np.inf))


def undistort(distorted: PerPoint, r: Vector3) -> PerPoint:
    """Solve chi (1 + R0 + R1 chi^2 + R2 chi^4) = chi' by Newton's method; NaN where it fails.

    Where the polynomial is far from linear, Newton's method may leave the branch; such rows are
    NaN, too.
    """
    limit = np.sqrt(largest_square(r))
    chi = np.minimum(distorted / (1.0 + r[0]), 0.999 * limit)
    step = np.zeros_like(chi)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(NEWTON_STEPS):
            square = chi * chi
            slope = 1.0 + r[0] + square * (3.0 * r[1] + square * 5.0 * r[2])
            value = chi * (1.0 + r[0] + square * (r[1] + square * r[2]))
            step = (value - distorted) / slope
            chi = np.clip(chi - step, 0.5 * chi, np.minimum(2.0 * chi, limit))
            if not np.any(np.abs(step) > NEWTON_STOP * chi):
                break
    settled = np.abs(step) <= 1e-10 * np.maximum(chi, NEWTON_STOP)
    return np.where(settled, chi, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Cahvor:
    """A perspective camera with radial distortion about O."""

    c: Vector3
    a: Vector3
    h: Vector3
    v: Vector3
    o: Vector3
    r: Vector3

    def __post_init__(self) -> None:
        freeze_vectors(self, ("c", "a", "h", "v", "o", "r"))
        check_perspective(self.a, self.h, self.v)
        check_unit(self.o, "O")
        check_radial(self.r)

    @property
    def centre(self) -> Vector3:
        """The projection centre C, metres."""
        return self.c

    @property
    def perspective(self) -> Cahv:
        """The perspective camera without the distortion."""
        return Cahv(self.c, self.a, self.h, self.v)

    def project(self, points: ObjectPoints) -> ImagePoints:
        """Image of object points; NaN behind the camera and beyond the range of the distortion."""
        image_points = np.empty((len(points), 2))
        axes = np.stack([self.h, self.v, self.a, self.o])
        limit = largest_square(self.r)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for start in range(0, len(points), CHUNK):
                here = slice(start, start + CHUNK)
                self._project_chunk(points[here], axes, limit, image_points[here])
        return image_points

    def _project_chunk(
        self, points: np.ndarray, axes: np.ndarray, limit: float, out: np.ndarray
    ) -> None:
        d = points.T - self.c[:, None]
        along_h, along_v, along_a, w = axes @ d
        oh, ov, oa, oo = axes @ self.o
        across = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - w * w * (2.0 - oo)
        tau = across / (w * w)
        mu = self.r[0] + tau * (self.r[1] + tau * self.r[2])
        stretch, pull = 1.0 + mu, mu * w
        depth = stretch * along_a - pull * oa
        depth[~((w > 0) & (depth > 0) & (tau < limit))] = np.nan
        inverse = 1.0 / depth
        out[:, 0] = (stretch * along_h - pull * oh) * inverse
        out[:, 1] = (stretch * along_v - pull * ov) * inverse

    def partials(self, points: ObjectPoints) -> tuple[ImagePoints, Partials]:
        """Image of object points, and its derivatives by them; NaN where there is no image."""
        image_points = self.project(points)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            moved, moved_by_p = self._moved_outwards(points - self.c)
            by_moved = perspective_partials(self.perspective, moved, image_points)
            return image_points, by_moved @ moved_by_p

    def _moved_outwards(self, d: ObjectPoints) -> tuple[ObjectPoints, np.ndarray]:
        """Points d' for points relative to C, and d(d')/dP, one 3 x 3 matrix per point."""
        w = d @ self.o
        l = d - w[:, None] * self.o
        tau = np.einsum("ij,ij->i", l, l) / w**2
        mu = self.r[0] + tau * (self.r[1] + tau * self.r[2])
        slope = self.r[1] + 2.0 * self.r[2] * tau
        across = np.eye(3) - np.outer(self.o, self.o)
        mu_by_p = slope[:, None] * (
            (2.0 / w**2)[:, None] * (l @ across) - (2.0 * tau / w)[:, None] * self.o
        )
        by_p = np.eye(3) + mu[:, None, None] * across + l[:, :, None] * mu_by_p[:, None, :]
        return d + mu[:, None] * l, by_p

    def rays(self, image_points: ImagePoints) -> Directions:
        """Unit directions from C through image points; NaN where the distortion has no inverse."""
        rays = np.empty((len(image_points), 3))
        for start in range(0, len(image_points), CHUNK):
            here = slice(start, start + CHUNK)
            rays[here] = self._rays_chunk(image_points[here])
        return rays

    def _rays_chunk(self, image_points: ImagePoints) -> Directions:
        seen = perspective_rays(self.a, self.h, self.v, image_points)
        w = seen @ self.o
        l = seen - w[:, None] * self.o
        tangent = np.sqrt(np.einsum("ij,ij->i", l, l)) / np.where(w > 0, w, np.nan)
        on_axis = tangent == 0.0  # on the axis: no perpendicular component to scale
        ratio = undistort(tangent, self.r) / np.where(on_axis, 1.0, tangent)
        ratio = np.where(on_axis, 1.0 / (1.0 + self.r[0]), ratio)
        rays = w[:, None] * self.o + ratio[:, None] * l
        return rays / np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]

    def ray_origins(self, image_points: ImagePoints) -> ObjectPoints:
        """Origins of the rays, metres: C for every image point."""
        return np.broadcast_to(self.c, (len(image_points), 3))

    def transform(self, target_from_model: Pose) -> Cahvor:
        """The same camera, expressed in the target frame of a pose."""
        turn = target_from_model.rotation
        c = target_from_model.apply(self.c[None])[0]
        return replace(
            self, c=c, a=turn @ self.a, h=turn @ self.h, v=turn @ self.v, o=turn @ self.o
        )

    def subframe(self, first_sample: int | float, first_line: int | float) -> Cahvor:
        """The model of a sub-frame whose first pixel was (first_sample, first_line), 0-based."""
        return replace(self, h=self.h - first_sample * self.a, v=self.v - first_line * self.a)

    def average(self, width: int, height: int, *, correct_half_pixel: bool = True) -> Cahvor:
        """The model of an image averaged over blocks of width x height pixels."""
        half = 0.5 * self.a if correct_half_pixel else 0.0 * self.a
        return replace(
            self, h=averaged_scale(self.h, width, half), v=averaged_scale(self.v, height, half)
        )
