"""Resampling of an original image to the epipolar geometry of its pair.

Each pixel (x, y) of the epipolar image has a known direction; its original pixel is the image of a
point on that ray, (u, v) = project(C + d r(x, y)). For CAHV and CAHVOR the distance d does not
matter; with CAHVORE, whose entrance pupil moves, d is that of the ground.

The map (u, v) is smooth, so it is computed on a coarse grid and interpolated by cubic splines. The
error is checked with the exact map half-way between grid lines, where it is largest; the grid is
halved until it is below `MAP_TOLERANCE_PX`. Grey values come from the cubic B-spline through all
pixels (Unser 1999), which, unlike cubic convolution or Lanczos kernels, does not bias sub-pixel
positions.

Of the spline coefficients c of a row, c * (1, 4, 1)/6 = I, the slope at a pixel is
(c[i+1] - c[i-1]) / 2; the values between pixels are in `kernels`. The coefficients come from the
inverse of (1, 4, 1)/6, sqrt(3) z^|k| with z = sqrt(3) - 2 (Unser 1999), which is truncated below
single precision.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import BSpline, make_interp_spline

from solmap.photogrammetry.arrays import (
    Bool,
    Float32,
    Float64,
    GreyImage,
    ImagePoints,
    Int32,
    Mask,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.kernels import evaluate_bicubic, sample_points
from solmap.photogrammetry.matching.records import EpipolarImages

REACH = 14
"""Pixels beyond which z^|k| is below 1e-8."""
_INVERSE = (np.sqrt(3) * (np.sqrt(3) - 2) ** np.abs(np.arange(-REACH, REACH + 1))).astype(
    np.float32
)


def spline_coefficients(image: GreyImage) -> GreyImage:
    """Spline coefficients of an image, in both directions; mirrored at its borders."""
    return cv2.sepFilter2D(image, cv2.CV_32F, _INVERSE, _INVERSE, borderType=cv2.BORDER_REFLECT_101)


def row_coefficients(image: GreyImage) -> GreyImage:
    """Spline coefficients of every row."""
    return cv2.sepFilter2D(
        image, cv2.CV_32F, _INVERSE, np.ones(1, np.float32), borderType=cv2.BORDER_REFLECT_101
    )


def row_slope(coefficients: GreyImage) -> GreyImage:
    """Derivative of the grey values along the row, at the pixels."""
    return cv2.filter2D(coefficients, -1, np.array([[-0.5, 0.0, 0.5]], np.float32))


def windows_at(
    image: GreyImage, pixels: Int32[np.ndarray, "n 2"], window_px: int
) -> Float32[np.ndarray, "n k"]:
    """Square windows of an image around pixels (sample, line), row by row; all inside it."""
    if not len(pixels):  # as in an image smaller than a window
        return np.empty((0, window_px**2), np.float32)
    windows = sliding_window_view(image, (window_px, window_px))
    sample, line = (pixels - window_px // 2).T
    return windows[line, sample].reshape(len(pixels), window_px**2)


MAP_TOLERANCE_PX = 0.01
"""Largest error of the interpolated map: a tenth of what least-squares matching resolves."""

GROUND_M = 5.0
"""Distance at which CAHVORE models are evaluated: the ground in front of a rover."""

COARSEST_STEP_PX = 32
"""Width of the grid on which the map is first computed."""

REACH_PX = 3
"""Distance in pixels beyond which a bad pixel affects its spline by less than 2 percent."""

ImageMap = Float32[np.ndarray, "rows cols 2"]
"""(sample, line) in the original image of every epipolar pixel."""

Source = tuple[Float32[np.ndarray, "_ _"], Bool[np.ndarray, "_ _"], CameraModel]
"""An original image, its mask and its camera in the rover frame; left and right may differ in
size."""

EpipolarImage = Float32[np.ndarray, "rows cols"]
EpipolarMask = Bool[np.ndarray, "rows cols"]


def resample(
    image: GreyImage, mask: Mask, camera: CameraModel, geometry: EpipolarPair, eye: Eye
) -> tuple[EpipolarImage, EpipolarMask]:
    """One image of a pair in its epipolar geometry, and its mask of usable pixels.

    `camera` is the model of the original image, in the rover frame of `geometry`.
    """
    _check_eye(camera, geometry, eye)
    source = original_points(camera, geometry)
    u, v = (np.ascontiguousarray(source[:, :, k]) for k in (0, 1))
    lines, samples = image.shape
    inside = (u >= 0) & (u <= samples - 1) & (v >= 0) & (v <= lines - 1)  # NaN does not
    if not inside.all():
        u, v = (np.where(inside, w, np.float32(0)) for w in (u, v))
    usable = _warp_mask(mask, u, v) & inside
    grey = sample_points(spline_coefficients(_fill_bad_pixels(image, mask)), u, v)
    grey[~usable] = 0
    return grey, usable


def epipolar_images(
    geometry: EpipolarPair,
    left: Source,
    right: Source,
) -> EpipolarImages:
    """Both images of a pair in its epipolar geometry, from original images with mask and camera."""
    return EpipolarImages(
        geometry, *resample(*left, geometry, Eye.LEFT), *resample(*right, geometry, Eye.RIGHT)
    )


def shift_rows(image: GreyImage, mask: Mask, by: GreyImage) -> tuple[GreyImage, Mask]:
    """An image whose pixel (x, y) is that of (x - by, y), and its mask of usable pixels."""
    grid = np.indices(image.shape, dtype=np.float32)
    place = (grid[1] - by, grid[0])
    grey = cv2.remap(image, *place, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    known = cv2.remap(
        mask.astype(np.float32), *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
    )
    return grey, known > 0.99  # noqa: PLR2004 - wholly from usable pixels


def original_points(camera: CameraModel, geometry: EpipolarPair) -> ImageMap:
    """Positions of epipolar pixels in the original image; NaN behind the camera."""
    step = COARSEST_STEP_PX
    while step > 1:
        x, y = _nodes(geometry.samples, step), _nodes(geometry.lines, step)
        coarse = _project(camera, geometry, x, y)
        if not np.isfinite(coarse).all():
            break
        if _error_px(coarse, x, y, camera, geometry) < MAP_TOLERANCE_PX:
            return _interpolate(
                coarse, x, y, np.arange(float(geometry.samples)), np.arange(float(geometry.lines))
            )
        step //= 2
    return _project(
        camera, geometry, np.arange(float(geometry.samples)), np.arange(float(geometry.lines))
    ).astype(np.float32)


def _nodes(size: int, step: int) -> Float64[np.ndarray, " n"]:
    return np.linspace(0.0, size - 1.0, max(4, int(np.ceil(size / step)) + 1))


def _project(
    camera: CameraModel, geometry: EpipolarPair, x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    grid: ImagePoints = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = camera.centre + GROUND_M * geometry.directions(grid)
    return camera.project(points).reshape(len(y), len(x), 2)


def _interpolate(
    coarse: np.ndarray, x: np.ndarray, y: np.ndarray, to_x: np.ndarray, to_y: np.ndarray
) -> ImageMap:
    """Values of the bicubic spline through `coarse`."""
    by_row = make_interp_spline(y, coarse, k=3)
    by_column = make_interp_spline(x, by_row.c.swapaxes(0, 1), k=3)
    across, down = _splines_at(to_x, by_column.t), _splines_at(to_y, by_row.t)
    coefficients = np.ascontiguousarray(np.moveaxis(by_column.c, -1, 0).swapaxes(1, 2))
    planes = np.empty((2, len(to_y), len(to_x)), np.float32)  # each coordinate is used alone
    for plane, spline in zip(planes, coefficients, strict=True):
        plane[:] = evaluate_bicubic(spline, *across, *down)
    return np.moveaxis(planes, 0, -1)


def _splines_at(
    places: np.ndarray, knots: np.ndarray
) -> tuple[Float64[np.ndarray, "n 4"], np.ndarray]:
    """The four cubic B-splines that are not 0 at each place, and the index of their first."""
    table = BSpline.design_matrix(places, knots, 3)
    first = table.indices.reshape(-1, 4)[:, 0].astype(np.int64)
    return table.data.reshape(-1, 4), first


def _error_px(
    coarse: np.ndarray, x: np.ndarray, y: np.ndarray, camera: CameraModel, geometry: EpipolarPair
) -> float:
    """Largest error of the spline half-way between the nodes; infinite where one is not visible."""
    half_x, half_y = (x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2
    exact = _project(camera, geometry, half_x, half_y)
    error = np.abs(_interpolate(coarse, x, y, half_x, half_y) - exact).max()
    return float(error) if np.isfinite(error) else np.inf


def _warp_mask(mask: Mask, u: np.ndarray, v: np.ndarray) -> EpipolarMask:
    if mask.all():
        return np.ones(u.shape, dtype=bool)
    kernel = np.ones((2 * REACH_PX + 1, 2 * REACH_PX + 1), np.uint8)
    near_bad = cv2.dilate((~mask).astype(np.uint8), kernel)
    nearest = [
        np.rint(w).astype(np.int32).clip(0, n - 1) for w, n in zip((v, u), mask.shape, strict=True)
    ]
    return near_bad[nearest[0], nearest[1]] == 0


def _fill_bad_pixels(image: GreyImage, mask: Mask) -> GreyImage:
    """Bad pixels replaced by the mean of good neighbours, so that splines do not oscillate."""
    if mask.all():
        return image
    if not mask.any():
        raise MatchingError("no pixel of the image is usable: its mask is False everywhere")
    size = (4 * REACH_PX + 1, 4 * REACH_PX + 1)
    good = np.where(mask, image, np.float32(0))
    weight = cv2.blur(mask.astype(np.float32), size)
    mean = cv2.blur(good, size) / np.maximum(weight, np.float32(1e-6))
    fallback = np.float32(np.median(image[mask]))
    return np.where(mask, image, np.where(weight > 1e-3, mean, fallback)).astype(np.float32)  # noqa: PLR2004 - less than one pixel of the window


def _check_eye(camera: CameraModel, geometry: EpipolarPair, eye: Eye) -> None:
    """Check that the camera of an eye is at that eye's position in the geometry."""
    if eye is Eye.MONO:
        raise MatchingError("an epipolar image must be of the left or the right eye, not mono")
    expected = geometry.cameras()[0 if eye is Eye.LEFT else 1].centre
    apart_m = float(np.linalg.norm(camera.centre - expected))
    if apart_m > 1e-3 * geometry.base_m + 1e-6:
        raise MatchingError(
            f"the {eye} camera is {apart_m:.4f} m from its position in the epipolar pair: are the "
            "eyes exchanged, or the models in different frames?"
        )
