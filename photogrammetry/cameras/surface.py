"""Linearising a camera whose rays do not meet: exactly right on one surface.

The entrance pupil of a CAHVORE camera moves with the angle, so no perspective image of it is right
at every distance. It is right for points on a surface that is chosen beforehand: of every pixel of
the perspective image the ray from its centre C' is cut with the surface, and the point seen by the
fisheye,

    sphere about C' of radius rho:         p = C' + rho r
    plane n.p = h (n of unit length):      p = C' + r (h - n.C') / (n.r),      in front only,

as JPL does with a sphere of 1 m; for maps the plane of the ground is the better choice. Elsewhere
the error is the shift s(theta) of the pupil seen from the point: for the Hazcams of MER, whose
pupil moves by some millimetres, a fraction of a pixel that falls with the distance.

The perspective camera may be anything; `perspective_along` makes one that looks along O with square
pixels and the scale that the fisheye has on its axis, which is where it resolves least: no detail
is lost, and the field asked for decides on the size of the image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from solmap.photogrammetry.arrays import Directions, ImagePoints, ObjectPoints, Vector3
from solmap.photogrammetry.cameras.cahv import Cahv, interior_orientation
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import read_only

WIDEST = math.radians(85.0)
"""Half fields beyond this need a perspective image of more than a dozen times the fisheye's."""


@dataclass(frozen=True, slots=True)
class Sphere:
    """All points at one distance from the perspective centre."""

    radius_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.radius_m) and self.radius_m > 0):
            raise CameraError(f"the radius of a sphere is above zero, not {self.radius_m} m")


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """All points p with normal.p = offset_m, in the frame of the camera."""

    normal: Vector3
    offset_m: float

    def __post_init__(self) -> None:
        normal = read_only(self.normal, (3,), "the normal of a plane")
        length = float(np.linalg.norm(normal))
        if not (length > 0 and math.isfinite(self.offset_m)):
            raise CameraError(f"{normal} and {self.offset_m} m make no plane")
        object.__setattr__(
            self, "normal", read_only(normal / length, (3,), "the normal of a plane")
        )
        object.__setattr__(self, "offset_m", self.offset_m / length)


Surface: TypeAlias = Sphere | Plane


def perspective_along(
    camera: Cahvore, samples: int, lines: int, half_field: float
) -> tuple[Cahv, int, int]:
    """A perspective camera along O with the pixels of the fisheye's middle, and its image size.

    Args:
        camera: the fisheye.
        samples: of its image.
        lines: of its image.
        half_field: angle from O to the middle of the nearer edges, radians.

    Raises:
        CameraError: the field is not between 0 and `WIDEST`.
    """
    if not 0 < half_field <= WIDEST:
        raise CameraError(
            f"no perspective image reaches {math.degrees(half_field):.3g} degrees to either side; "
            f"expected above 0 and up to {math.degrees(WIDEST):.0f}"
        )
    inner = interior_orientation(camera.a, camera.h, camera.v)
    focal = (1.0 + camera.r[0]) * max(inner.hs, inner.vs)
    nearer = 2 * math.ceil(focal * math.tan(half_field))
    shape = max(samples, lines) / min(samples, lines)
    across, down = (nearer * (shape if n == max(samples, lines) else 1) for n in (samples, lines))
    new_samples, new_lines = round(across), round(down)
    right = camera.h - (camera.h @ camera.o) * camera.o
    right = right / np.linalg.norm(right)
    h = focal * right + (new_samples - 1) / 2 * camera.o
    v = focal * np.cross(camera.o, right) + (new_lines - 1) / 2 * camera.o
    return Cahv(camera.c, camera.o, h, v), new_samples, new_lines


def linearised_on(
    camera: Cahvore, perspective: Cahv, surface: Surface
) -> Callable[[ImagePoints], ImagePoints]:
    """Where the fisheye sees what pixels of the perspective image see on the surface.

    Rows of pixels that do not see the surface, or whose point the fisheye does not image, are NaN.
    """

    def fisheye_from_perspective(image_points: ImagePoints) -> ImagePoints:
        rays = perspective.rays(image_points)
        return camera.project(points_on(surface, perspective.centre, rays))

    return fisheye_from_perspective


def points_on(surface: Surface, centre: Vector3, rays: Directions) -> ObjectPoints:
    """Where rays from a centre meet a surface in front of it; NaN where they do not."""
    if isinstance(surface, Sphere):
        return centre + surface.radius_m * rays
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance = (surface.offset_m - surface.normal @ centre) / (rays @ surface.normal)
        distance = np.where((distance > 0) & np.isfinite(distance), distance, np.nan)
        return centre + distance[:, None] * rays
