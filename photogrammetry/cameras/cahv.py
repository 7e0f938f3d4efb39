"""CAHV: the perspective camera of JPL's rovers (Yakimovsky & Cunningham 1978).

Its four vectors are the projection centre C (metres), the unit axis A normal to the image, and H
and V (pixels), which combine the scales, the directions of rows and columns and the image of the
axis:

    d = P - C        x = d.H / d.A        y = d.V / d.A        (d.A > 0 in front)
    dx/dP = (H - x A) / d.A               dy/dP = (V - y A) / d.A
    ray(x, y) ~ (V - y A) x (H - x A) = V x H - x (V x A) - y (A x H),   reversed if (V x H).A < 0

Their interior orientation is h_c = A.H, v_c = A.V (image of the axis), h_s = |A x H|, v_s = |A x V|
(focal lengths in pixels). A label's A is rounded to six digits; it is used unchanged, as in JPL's
own library, and only treated as a unit vector where stated.

A sub-frame that starts at pixel (i, j), and averaging of blocks of n x m pixels, change

    H -> H - i A,   V -> V - j A,        H -> (H + A/2) / n - A/2,   V -> (V + A/2) / m - A/2,

because integer coordinates are pixel centres. MER labels omit the halves, as an archived
sub-frame shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.arrays import Directions, Float64, ImagePoints, ObjectPoints, Vector3
from solmap.photogrammetry.errors import CameraError, FrameError
from solmap.photogrammetry.frames import Pose, read_only

Partials = Float64[np.ndarray, "n 2 3"]
"""d(sample, line)/dP in pixels per metre: one 2 x 3 matrix per point."""

UNIT_TOLERANCE = 1e-3
"""Limit for the length of a unit vector: with the six digits of a label it is within 1e-6."""


@dataclass(frozen=True, slots=True, eq=False)
class Cahv:
    """A perspective camera; its image is a plane, all its rays pass through C."""

    c: Vector3
    a: Vector3
    h: Vector3
    v: Vector3

    def __post_init__(self) -> None:
        freeze_vectors(self, ("c", "a", "h", "v"))
        check_perspective(self.a, self.h, self.v)

    @property
    def centre(self) -> Vector3:
        """The projection centre C, metres."""
        return self.c

    def project(self, points: ObjectPoints) -> ImagePoints:
        """Image of object points; rows of points behind the camera are NaN."""
        along_h, along_v, along_a = np.stack([self.h, self.v, self.a]) @ (points - self.c).T
        depth = np.where(along_a > 0, along_a, np.nan)
        return np.column_stack([along_h / depth, along_v / depth])

    def partials(self, points: ObjectPoints) -> tuple[ImagePoints, Partials]:
        """Image of object points, and its derivatives by them."""
        image_points = self.project(points)
        return image_points, perspective_partials(self, points - self.c, image_points)

    def rays(self, image_points: ImagePoints) -> Directions:
        """Unit directions from C through image points."""
        return perspective_rays(self.a, self.h, self.v, image_points)

    def ray_origins(self, image_points: ImagePoints) -> ObjectPoints:
        """Origins of the rays, metres: C for every image point."""
        return np.broadcast_to(self.c, (len(image_points), 3))

    def transform(self, target_from_model: Pose) -> Cahv:
        """The same camera, expressed in the target frame of a pose."""
        turn = target_from_model.rotation
        c = target_from_model.apply(self.c[None])[0]
        return replace(self, c=c, a=turn @ self.a, h=turn @ self.h, v=turn @ self.v)

    def subframe(self, first_sample: int | float, first_line: int | float) -> Cahv:
        """The model of a sub-frame whose first pixel was (first_sample, first_line), 0-based."""
        return replace(self, h=self.h - first_sample * self.a, v=self.v - first_line * self.a)

    def average(self, width: int, height: int, *, correct_half_pixel: bool = True) -> Cahv:
        """The model of an image averaged over blocks of width x height pixels."""
        half = 0.5 * self.a if correct_half_pixel else 0.0 * self.a
        return replace(
            self, h=averaged_scale(self.h, width, half), v=averaged_scale(self.v, height, half)
        )


@dataclass(frozen=True, slots=True)
class InteriorOrientation:
    """Focal lengths and image of the axis, pixels; `theta` is the angle from H' to V', radians."""

    hs: float
    vs: float
    hc: float
    vc: float
    theta: float


def interior_orientation(a: Vector3, h: Vector3, v: Vector3) -> InteriorOrientation:
    """Interior orientation from H and V; theta is about -90 degrees for x right and y down."""
    a_x_h, a_x_v = np.cross(a, h), np.cross(a, v)
    theta = np.arctan2(np.cross(v, h) @ a, a_x_v @ a_x_h)
    return InteriorOrientation(
        hs=float(np.linalg.norm(a_x_h)),
        vs=float(np.linalg.norm(a_x_v)),
        hc=float(a @ h),
        vc=float(a @ v),
        theta=float(theta),
    )


def freeze_vectors(model: object, names: tuple[str, ...]) -> None:
    """Replace the vectors of a new record by checked, read-only copies."""
    for name in names:
        try:
            vector = read_only(getattr(model, name), (3,), f"{name.upper()} of a camera model")
        except (FrameError, TypeError, ValueError) as error:
            raise CameraError(str(error)) from None
        object.__setattr__(model, name, vector)


def check_unit(vector: Vector3, name: str) -> None:
    """Reject a direction whose length differs from one by more than the rounding of a label."""
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise CameraError(
            f"{name} of a camera model should be a unit vector, but has length {length:.6g}"
        )


def check_perspective(a: Vector3, h: Vector3, v: Vector3) -> None:
    """Reject axes that span no image plane."""
    check_unit(a, "A")
    volume = abs(float(np.cross(v, h) @ a))
    if not volume > 1e-9 * float(np.linalg.norm(h) * np.linalg.norm(v)):
        raise CameraError("A, H and V of a camera model lie in one plane: they span no image")


def perspective_rays(a: Vector3, h: Vector3, v: Vector3, image_points: ImagePoints) -> Directions:
    """Unit directions of a perspective camera through image points."""
    v_x_h = np.cross(v, h)
    linear = np.stack([-np.cross(v, a), -np.cross(a, h)]) * (1.0 if v_x_h @ a >= 0 else -1.0)
    rays = image_points @ linear + (v_x_h if v_x_h @ a >= 0 else -v_x_h)
    return rays / np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]


def perspective_partials(
    model: Cahv, from_centre: ObjectPoints, image_points: ImagePoints
) -> Partials:
    """(H - x A) / d.A and (V - y A) / d.A for points relative to the centre."""
    depth = from_centre @ model.a
    scales = np.stack([model.h, model.v])
    return (scales - image_points[:, :, None] * model.a) / depth[:, None, None]


def averaged_scale(scale: Vector3, pixels: int, half_axis: Vector3) -> Vector3:
    """H or V of an image averaged over `pixels` columns or lines; `half_axis` is A/2 or 0."""
    if pixels < 1:
        raise CameraError(f"pixels must be averaged over at least one, not {pixels}")
    return (scale + half_axis) / pixels - half_axis
