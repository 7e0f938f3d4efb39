"""From the camera model of the labels to photogrammetric parameters and back (Di & Li 2004).

With A of unit length, H' = (H - h_c A) / h_s, V' = (V - v_c A) / v_s and the pixel size ps,

    f = ps h_s      x_0 = ps (h_c - cols/2)      y_0 = -ps (v_c - rows/2)      M = [H'; -V'; -A]

where M transforms object space to a photo frame with x right, y up, z back, and

    phi = asin m_31      omega = atan2(-m_32, m_33)      kappa = atan2(-m_21, m_11).

The published conversion is not exact: H' and V' of real models are not quite at right angles (0.3
px at the edge of Spirit's left Navcam). Here the shear is kept, in

    [H; V; A] = K R,    K = [[h_s, 0, h_c], [v_s V'.H', v_s V'.(A x H'), v_c], [0, 0, 1]],

R the rotation into a camera frame right, down, forward (rows H', A x H', A): exact both ways.
x_0, y_0 refer to the corner-based centre cols/2, as published; pixel centres lie half a pixel off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, Rotation, Vector3
from solmap.photogrammetry.cameras.cahv import Cahv, check_unit, interior_orientation
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import read_only

Calibration = Float64[np.ndarray, "3 3"]
"""K: pixels from camera coordinates right, down, forward."""


@dataclass(frozen=True, slots=True, eq=False)
class Photogrammetric:
    """Interior (pixels, with shear) and exterior orientation of a perspective camera."""

    centre: Vector3
    calibration: Calibration
    camera_from_frame: Rotation
    """Rows right, down, forward in the model's frame."""

    def __post_init__(self) -> None:
        for name, shape in (
            ("centre", (3,)),
            ("calibration", (3, 3)),
            ("camera_from_frame", (3, 3)),
        ):
            object.__setattr__(self, name, read_only(getattr(self, name), shape, name))
        if not (self.calibration[0, 0] > 0 and self.calibration[1, 1] > 0):
            raise CameraError("the focal lengths of a camera must be above zero")

    @property
    def shear(self) -> float:
        """Cosine of the angle between rows and columns: pixels sideways a pixel down."""
        k = self.calibration
        return float(k[1, 0] / np.hypot(k[1, 0], k[1, 1]))

    @property
    def focal_px(self) -> tuple[float, float]:
        """h_s and v_s."""
        k = self.calibration
        return float(k[0, 0]), float(np.hypot(k[1, 0], k[1, 1]))

    @property
    def photo_from_frame(self) -> Rotation:
        """M of the published form: rows H' (right), -V' (up), -A (back); not quite orthogonal."""
        right, down, forward = self.camera_from_frame
        k = self.calibration
        v_unit = (k[1, 0] * right + k[1, 1] * down) / self.focal_px[1]
        return np.stack([right, -v_unit, -forward])

    @property
    def omega_phi_kappa(self) -> tuple[float, float, float]:
        """Angles of M, radians; singular where phi is +-90 degrees, so only for output."""
        m = self.photo_from_frame
        return (
            float(np.arctan2(-m[2, 1], m[2, 2])),
            float(np.arcsin(np.clip(m[2, 0], -1.0, 1.0))),
            float(np.arctan2(-m[1, 0], m[0, 0])),
        )

    def principal_point_mm(self, pixel_mm: float, samples: int, lines: int) -> tuple[float, float]:
        """(x_0, y_0) from the corner-based middle of the image, y up."""
        k = self.calibration
        return pixel_mm * float(k[0, 2] - samples / 2), -pixel_mm * float(k[1, 2] - lines / 2)

    def cahv(self) -> Cahv:
        """The camera model, exactly."""
        h, v, a = self.calibration @ self.camera_from_frame
        return Cahv(self.centre, a, h, v)


def photogrammetric(camera: Cahv | Cahvor) -> Photogrammetric:
    """Photogrammetric parameters of the perspective part of a camera model.

    Raises:
        CameraError: the image is mirrored, which cannot be expressed by a rotation.
    """
    check_unit(camera.a, "A")
    length = float(np.linalg.norm(camera.a))
    a, h, v = camera.a / length, camera.h / length, camera.v / length
    inner = interior_orientation(a, h, v)
    h_unit, v_unit = (h - inner.hc * a) / inner.hs, (v - inner.vc * a) / inner.vs
    down = np.cross(a, h_unit)
    calibration = np.array(
        [
            [inner.hs, 0.0, inner.hc],
            [inner.vs * (v_unit @ h_unit), inner.vs * (v_unit @ down), inner.vc],
            [0.0, 0.0, 1.0],
        ]
    )
    return Photogrammetric(camera.c, calibration, np.stack([h_unit, down, a]))
