"""Planes of parallax at points, all over an image or for its whole ground, and their homographies.

In the normal case of stereo the parallax of a plane is a linear function of the image coordinates,

    p = p_0 + g_x (x - x_0) + g_y (y - y_0),                 p = f B / Z,

so a plane fitted to the dense parallax around a point gives the local surface in the pair's frame

    n . X = 1,        n = (g_x f, g_y f, p_0 - g_x (x_0 - c_x) - g_y (y_0 - c_y)) / (f B).

A second camera at X' = R X + t sees that plane through the homography

    H = K' (R + t n') K^-1,                                  K = [f 0 c_x; 0 f c_y; 0 0 1].

For a pure rotation (t = 0, another pair of the same panorama) H does not depend on the plane.

`parallax_planes` fits windows around image points, without outliers; `whole_window_planes` fits
those without gaps all over the image at once, by running sums; `fit_robust_plane` fits one plane of
least absolute deviations to the ground of a whole image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    Flags,
    Float32,
    Float64,
    ImagePoints,
    ParallaxMap,
    PerPoint,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.planes import least_deviations_plane

LEAST_SHARE = 0.5
"""Fraction of the pixels around the point that must have parallax."""


@dataclass(frozen=True, slots=True, eq=False)
class ParallaxPlanes:
    """A plane of parallax around each of n image points; NaN rows where there is none."""

    parallax_px: PerPoint
    gradient: Float64[np.ndarray, "n 2"]
    """Change of parallax along sample and line."""
    residual_px: PerPoint
    """Standard deviation of the parallax about the plane: relief and noise."""

    @property
    def found(self) -> Flags:
        """Where a plane was fitted."""
        return np.isfinite(self.parallax_px)

    def select(self, rows: Flags) -> ParallaxPlanes:
        """The planes of some points."""
        return ParallaxPlanes(self.parallax_px[rows], self.gradient[rows], self.residual_px[rows])

    def normals(self, points: ImagePoints, geometry: EpipolarPair) -> Float64[np.ndarray, "n 3"]:
        """The planes n . X = 1 in the pair's frame, 1/metres, at their image points.

        They point away from the camera.
        """
        from_centre = points - np.asarray(geometry.centre_px)
        at_centre = self.parallax_px - (self.gradient * from_centre).sum(axis=1)
        across = geometry.focal_px * self.gradient
        return np.column_stack([across, at_centre]) / (geometry.focal_px * geometry.base_m)


@dataclass(frozen=True, slots=True, eq=False)
class ParallaxPlane:
    """Parallax of a plane, at + per_sample x + per_line y, in pixels."""

    at: float
    per_sample: float
    per_line: float

    def parallax_px(self, samples: np.ndarray, lines: np.ndarray) -> np.ndarray:
        """Parallax of left image points."""
        return self.at + self.per_sample * samples + self.per_line * lines


def parallax_planes(parallax: ParallaxMap, points: ImagePoints, half_px: int) -> ParallaxPlanes:
    """Fit planes to the dense parallax in a square window around image points.

    Two rounds: pixels more than 2.5 standard deviations off the first plane are excluded from the
    second, so that a rock's edge does not tilt the plane of the ground behind it.
    """
    steps = np.arange(-half_px, half_px + 1, max(1, half_px // 5))
    dy, dx = (o.ravel() for o in np.meshgrid(steps, steps, indexing="ij"))
    x = np.round(points[:, 0]).astype(np.int64)[:, None] + dx
    y = np.round(points[:, 1]).astype(np.int64)[:, None] + dy
    lines, samples = parallax.shape
    inside = (x >= 0) & (x < samples) & (y >= 0) & (y < lines)
    value = parallax[np.clip(y, 0, lines - 1), np.clip(x, 0, samples - 1)].astype(np.float64)
    weight = (inside & np.isfinite(value)).astype(np.float64)
    value = np.nan_to_num(value)
    design = np.stack([np.ones_like(value), x - points[:, :1], y - points[:, 1:]], axis=-1)
    enough = weight.mean(axis=1) >= LEAST_SHARE
    median = (
        np.nanmedian(np.where(weight > 0, value, np.nan)[enough], axis=1) if enough.any() else 0
    )
    near = np.zeros_like(weight)
    near[enough] = np.abs(value[enough] - np.reshape(median, (-1, 1))) < 0.3 * np.reshape(
        np.abs(median) + 1.0, (-1, 1)
    )
    weight *= near  # a third of the range away is another surface
    for _ in range(2):
        coefficients, residual = _fit_windows(design, value, weight)
        sigma = np.sqrt((weight * residual**2).sum(axis=1) / np.maximum(weight.sum(axis=1) - 3, 1))
        keep = np.abs(residual) <= 2.5 * np.maximum(sigma, 0.1)[:, None]
        enough &= weight.mean(axis=1) >= LEAST_SHARE / 2
        weight = weight * keep
    coefficients[~enough] = np.nan
    sigma[~enough] = np.nan
    return ParallaxPlanes(coefficients[:, 0], coefficients[:, 1:], sigma)


def _fit_windows(
    design: Float64[np.ndarray, "n m 3"],
    value: Float64[np.ndarray, "n m"],
    weight: Float64[np.ndarray, "n m"],
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n m"]]:
    """Weighted plane through every window and the residuals from it."""
    weighted = design * weight[:, :, None]
    normal = np.swapaxes(weighted, 1, 2) @ design + 1e-9 * np.eye(3)
    right = np.swapaxes(weighted, 1, 2) @ value[:, :, None]
    coefficients = np.linalg.solve(normal, right)[:, :, 0]
    return coefficients, value - (design @ coefficients[:, :, None])[:, :, 0]


def fit_robust_plane(
    points: Float64[np.ndarray, "n 2"], parallax_px: Float64[np.ndarray, " n"]
) -> ParallaxPlane:
    """The plane of least absolute deviations, by iterative reweighting."""
    x, y = (points / 1000.0).T
    solution = least_deviations_plane(x, y, parallax_px, 0.1)
    # the right image is shifted by the plane: it may be stretched, but not folded
    per_sample = float(np.clip(solution[1] / 1000.0, -0.5, 0.5))
    at = float(
        np.median(parallax_px - per_sample * points[:, 0] - solution[2] / 1e3 * points[:, 1])
    )
    return ParallaxPlane(at, per_sample, float(solution[2] / 1000.0))


def calibration_matrix(geometry: EpipolarPair) -> Float64[np.ndarray, "3 3"]:
    """K of an epipolar pair."""
    f, (cx, cy) = geometry.focal_px, geometry.centre_px
    return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])


def plane_homographies(
    source: EpipolarPair,
    target: EpipolarPair,
    target_from_source: Pose,
    points: ImagePoints,
    planes: ParallaxPlanes,
) -> Float64[np.ndarray, "n 3 3"]:
    """Maps of the left image of `source` to that of `target` over each point's local surface."""
    normal = planes.normals(points, source)
    between = target_from_source.rotation + (
        target_from_source.translation_m[None, :, None] * normal[:, None, :]
    )
    return calibration_matrix(target) @ between @ np.linalg.inv(calibration_matrix(source))


def stereo_homographies(
    points: ImagePoints, planes: ParallaxPlanes
) -> Float64[np.ndarray, "n 3 3"]:
    """Maps of the left image of a pair to its right one over each point's local surface."""
    gx, gy = planes.gradient.T
    maps = np.tile(np.eye(3), (len(points), 1, 1))
    maps[:, 0, 0] -= gx
    maps[:, 0, 1] -= gy
    maps[:, 0, 2] -= planes.parallax_px - gx * points[:, 0] - gy * points[:, 1]
    return maps


def map_points(
    homographies: Float64[np.ndarray, "n 3 3"], points: ImagePoints
) -> tuple[ImagePoints, Float64[np.ndarray, "n 2 2"]]:
    """Each point transformed by its own homography, and the derivative of the map there."""
    h = (homographies @ np.column_stack([points, np.ones(len(points))])[:, :, None])[:, :, 0]
    w = np.where(h[:, 2] > 0, h[:, 2], np.nan)
    image = h[:, :2] / w[:, None]
    derivative = (homographies[:, :2, :2] - image[:, :, None] * homographies[:, 2:, :2]) / w[
        :, None, None
    ]
    return image, derivative


def whole_window_planes(
    parallax: ParallaxMap, window_px: int
) -> tuple[Float32[np.ndarray, "3 lines samples"], ParallaxMap]:
    """Plane of parallax around every pixel, and the root mean square distance from it.

    The plane is (a, b, c) of a + b x + c y, x and y counted from the pixel itself. NaN unless the
    whole window was matched: a plane over part of it would be biased by the edge.
    """
    half = window_px // 2
    steps = np.arange(-half, half + 1, dtype=np.float32)
    ones = np.ones_like(steps)
    known = np.isfinite(parallax)
    level = float(np.median(parallax[known])) if known.any() else 0.0
    p = np.where(known, parallax - np.float32(level), np.float32(0))
    full = cv2.erode(known.astype(np.uint8), np.ones((window_px, window_px), np.uint8)) > 0
    full[:half], full[-half:], full[:, :half], full[:, -half:] = (False,) * 4
    count, square = window_px**2, window_px * float(np.sum(steps**2))
    a = cv2.sepFilter2D(p, cv2.CV_32F, ones, ones) / count
    b = cv2.sepFilter2D(p, cv2.CV_32F, steps, ones) / square
    c = cv2.sepFilter2D(p, cv2.CV_32F, ones, steps) / square
    squares = cv2.sepFilter2D(p.astype(np.float64) ** 2, cv2.CV_64F, ones, ones) / count
    spread = squares - a.astype(np.float64) ** 2 - (b**2 + c**2) * (square / count)
    planes = np.stack([a + np.float32(level), b, c])
    planes[:, ~full] = np.nan
    rms = np.sqrt(np.maximum(spread, 0)).astype(np.float32)
    return planes, np.where(full, rms, np.float32(np.nan))
