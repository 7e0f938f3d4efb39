"""The normal case of stereo: both images of a pair resampled onto one plane along the base.

With the projection centres C_l, C_r, the base b = C_r - C_l of length B and the unit vector of the
base e = b / B, the common axis is the mean viewing direction made perpendicular to the base,

    z = unit(a - (a.e) e),        x = e,        y = z x e          (right, down, forward)

and one focal length f (pixels) serves both axes and both images, so that rows correspond exactly:

    x_l = c_x + f X/Z        y_l = c_y + f Y/Z        x_r = x_l - p        p = f B / Z

for a point (X, Y, Z) in the pair's frame (origin C_l). This is the "linearised" product of JPL with
square pixels, an axis perpendicular to the base and therefore no vertical parallax at all; the
archived products have neither (Di et al. 2008, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photogrammetry.arrays import Covariances3, ImagePoints, ObjectPoints, PerPoint
from photogrammetry.errors import CameraError
from photogrammetry.frames import Pose


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarPair:
    """The ideal stereo camera that an exposure was resampled to.

    `rover_from_pair` carries (right, down, forward) coordinates with origin at the left camera into
    the rover frame. Image sizes are those of both resampled images.
    """

    rover_from_pair: Pose
    base_m: float
    focal_px: float
    centre_px: tuple[float, float]
    samples: int
    lines: int

    def __post_init__(self) -> None:
        if not (self.base_m > 0 and self.focal_px > 0 and self.samples > 0 and self.lines > 0):
            raise CameraError(
                f"a stereo pair needs a base, a focal length and a size above zero, not "
                f"{self.base_m} m, {self.focal_px} px, {self.samples} x {self.lines}"
            )

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

        Range along the ray goes with the square of the distance: sigma_Z = Z^2 sigma_p / (B f).
        """
        points = self.triangulate(left, parallax_px)
        z = points[:, 2]
        along = points / parallax_px[:, None]  # dP/dp = -P/p
        across = (z * sigma_px / self.focal_px) ** 2
        covariances = sigma_parallax_px**2 * along[:, :, None] * along[:, None, :]
        covariances[:, 0, 0] += across
        covariances[:, 1, 1] += across
        return covariances
