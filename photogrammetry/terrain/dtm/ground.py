"""The ground of one view: trusted parallaxes, their points, and the mesh between them.

Neighbouring pixels of the left epipolar image form a mesh. With p = f B / Z, a plane that passes h
below the camera (measured along the image's y axis) changes by B / h pixels of parallax per line at
any distance, so continuous ground has small steps everywhere and an occlusion edge does not: the
step distinguishes them. The relative standard deviation along the view is

    sigma_Z / Z = sigma_p / p

which limits the range of a view. Coordinates are (east, north, up) in metres from the camera, in
single precision: a hundredth of a millimetre at a hundred metres.

Four neighbouring pixels form a square. A square is measured ground when none of its sides has a
larger step of parallax than continuous ground or is longer than a set gap. Farther away the squares
grow larger than the cells of the map; samples inside them, bilinear between the corners, give the
cells that they cover and their heights.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, Mask, ParallaxMap, Vector3
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.ranges import Metres, Pixels, ShareAboveZero
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.kernels import continuous_squares, points_of_pixels

PixelPoints = Float32[np.ndarray, "3 lines samples"]
"""East, north and up of every pixel, metres from the camera; NaN where not trusted."""

MAP_FROM_LSL = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Rotates (north, east, down) to (east, north, up)."""
SUBPIXEL = 16
"""Steps per pixel in which parallax is compared when regions are grown."""


MIN_REGION_PX = 100
"""Smallest connected patch of parallax: two matching windows of 7 x 7 side by side."""


@dataclass(frozen=True, slots=True)
class SightParams:
    """Which parallaxes to trust and what counts as one continuous surface."""

    sigma_parallax_px: Pixels = 0.25
    """Standard deviation of a dense parallax: published stereo has 0.32 px on board and 0.1-0.2 px
    with a good sub-pixel matcher on texture (NPO-42487; Di et al. 2008)."""
    max_relative_sigma: ShareAboveZero = 0.03
    """Largest standard deviation along the view over the distance. Three percent is reached at 29 m
    by Navcam and 129 m by Pancam: the extents of the paper's maps (section 5)."""
    radius_m: Metres = 60.0
    """Farthest ground from the camera: half of the 120 m mapped in the paper from Pancam."""
    max_spike_px: Pixels = 0.75
    """Largest distance from the median of the neighbourhood: three standard deviations."""
    min_height_m: Metres = 0.4
    """Least height of the camera above the plane of continuous ground, which may then step by B /
    height a pixel: 0.5 px with Navcam, 0.75 px with Pancam. Flat ground lies 1.5 m below a mast and
    0.5 m below a hazard camera; only sides and backs of rocks lie on nearer planes."""
    max_gap_m: Metres = 0.5
    """Widest gap bridged between neighbouring pixels: the line spacing of Navcam on flat ground at
    the end of its range, Z^2 / (f h) = 29^2 / (1222 x 1.5) = 0.46 m."""


def map_from_pair_rotation(lsl_from_pair: Pose) -> Float64[np.ndarray, "3 3"]:
    """Rotation from (right, down, forward) of a pair to (east, north, up)."""
    return MAP_FROM_LSL @ lsl_from_pair.rotation


def camera_on_map(lsl_from_pair: Pose) -> Vector3:
    """East, north and elevation of the left camera, metres."""
    return MAP_FROM_LSL @ lsl_from_pair.translation_m


def reach_m(view: TerrainView, params: SightParams) -> float:
    """Farthest ground from the camera that is used from a view, metres on the map.

    The corners of the image are off the axis by up to half its diagonal, at the same depth.
    """
    geometry = view.geometry
    depth = geometry.focal_px * geometry.base_m * params.max_relative_sigma
    aside = np.hypot(geometry.samples, geometry.lines) / 2 / geometry.focal_px
    return float(min(params.radius_m, depth / params.sigma_parallax_px * np.hypot(1, aside)))


def trusted_parallax(view: TerrainView, params: SightParams) -> ParallaxMap:
    """The parallax without pixels that are too far, isolated, or between two surfaces.

    A pixel is kept when it agrees with the median of its 5 x 5 neighbourhood, unmatched neighbours
    counting as infinitely far: pixels smoothed between a rock and the ground behind it are few and
    near neither. Patches connected by small steps must reach a smallest size.
    """
    farthest = np.float32(params.sigma_parallax_px / params.max_relative_sigma)
    near = view.mask & (view.parallax >= farthest)  # NaN is not
    parallax = np.where(near, view.parallax, np.float32(0))
    off = cv2.medianBlur(parallax, 5)
    np.abs(np.subtract(parallax, off, out=off), out=off)
    parallax[off > params.max_spike_px] = 0.0
    steps = np.minimum(parallax * np.float32(SUBPIXEL), np.iinfo(np.int16).max).astype(np.int16)
    step = round(largest_step_px(view.geometry.base_m, params) * SUBPIXEL)
    cv2.filterSpeckles(steps, 0, MIN_REGION_PX, step)
    parallax[steps <= 0] = np.nan
    return parallax


def largest_step_px(base_m: float, params: SightParams) -> float:
    """Largest step of parallax between neighbouring pixels of continuous ground."""
    return base_m / params.min_height_m


def ground_points(view: TerrainView, parallax: ParallaxMap, params: SightParams) -> PixelPoints:
    """Position of every trusted pixel, from the camera; NaN beyond the radius."""
    geometry = view.geometry
    rotation = map_from_pair_rotation(view.lsl_from_pair)
    across = (np.arange(parallax.shape[1]) - geometry.centre_px[0]) / geometry.focal_px
    down = (np.arange(parallax.shape[0]) - geometry.centre_px[1]) / geometry.focal_px
    focal_base = np.float32(geometry.focal_px * geometry.base_m)
    radius_m = np.float32(params.radius_m)
    return points_of_pixels(parallax, rotation, across, down, focal_base, radius_m)


def continuous_ground(
    planes: PixelPoints, parallax: ParallaxMap, view: TerrainView, params: SightParams
) -> Mask:
    """Squares of continuous ground, by their upper left pixels."""
    step_px = np.float32(largest_step_px(view.geometry.base_m, params))
    return continuous_squares(planes, parallax, step_px, np.float32(params.max_gap_m))
