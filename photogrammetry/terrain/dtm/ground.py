"""The ground of one view: trusted parallaxes, their points, and the mesh between them.

Neighbouring pixels of the left epipolar image form a mesh. With p = f B / Z, a plane that passes h
below the camera (measured along the image's y axis) changes by B / h pixels of parallax per line at
any distance, so continuous ground has small steps everywhere and an occlusion edge does not: the
step distinguishes them. The relative standard deviation along the view is

    sigma_Z / Z = sigma_p / p

which limits the range of a view. Coordinates are (east, north, up) in metres from the camera, in
single precision: a hundredth of a millimetre at a hundred metres.

Four neighbouring pixels form a quad. A quad is measured ground when none of its sides has a larger
step of parallax than continuous ground or is longer than a set gap. Farther away the quads grow
larger than the cells of the map; samples inside them, bilinear between the corners, give the cells
that they cover and their heights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, Mask, ParallaxMap, Vector3
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.ranges import Metres, Pixels, ShareAboveZero
from solmap.photogrammetry.terrain.dtm.records import TerrainView

PixelPoints = Float32[np.ndarray, "3 lines samples"]
"""East, north and up of every pixel, metres from the camera; NaN where not trusted."""

MAP_FROM_LSL = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Rotates (north, east, down) to (east, north, up)."""
SUBPIXEL = 16
"""Steps per pixel in which parallax is compared when regions are grown."""


MIN_REGION_PX = 100
"""Smallest connected patch of parallax: two matching windows of 7 x 7 side by side."""
Samples3 = Float32[np.ndarray, "3 n"]
"""East, north and up of samples of the surface, metres from the camera."""
SAMPLES_AT_ONCE = 2_000_000
"""Mesh samples held at one time: some tens of megabytes."""


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
    parallax = np.where(view.mask & np.isfinite(view.parallax), view.parallax, 0.0)
    parallax = parallax.astype(np.float32)
    farthest = params.sigma_parallax_px / params.max_relative_sigma
    parallax[parallax < farthest] = 0.0
    spike = np.abs(parallax - cv2.medianBlur(parallax, 5)) > params.max_spike_px
    parallax[spike] = 0.0
    steps = np.clip(parallax * SUBPIXEL, 0, np.iinfo(np.int16).max).astype(np.int16)
    step = round(largest_step_px(view.geometry.base_m, params) * SUBPIXEL)
    cv2.filterSpeckles(steps, 0, MIN_REGION_PX, step)
    return np.where(steps > 0, parallax, np.float32(np.nan))


def largest_step_px(base_m: float, params: SightParams) -> float:
    """Largest step of parallax between neighbouring pixels of continuous ground."""
    return base_m / params.min_height_m


def ground_points(view: TerrainView, parallax: ParallaxMap, params: SightParams) -> PixelPoints:
    """Position of every trusted pixel, from the camera; NaN beyond the radius."""
    geometry = view.geometry
    rotation = map_from_pair_rotation(view.lsl_from_pair)
    across = (np.arange(parallax.shape[1]) - geometry.centre_px[0]) / geometry.focal_px
    down = (np.arange(parallax.shape[0]) - geometry.centre_px[1]) / geometry.focal_px
    depth = np.float32(geometry.focal_px * geometry.base_m) / parallax
    planes = np.empty((3, *parallax.shape), dtype=np.float32)
    for axis, (right, below, forward) in enumerate(rotation):
        ray = (right * across[None, :] + below * down[:, None] + forward).astype(np.float32)
        np.multiply(ray, depth, out=planes[axis])
    np.copyto(planes, np.float32(np.nan), where=np.hypot(planes[0], planes[1]) > params.radius_m)
    return planes


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """Quads of continuous ground."""

    corner: np.ndarray
    """Their first corners: line and sample of the image."""
    lines_m: Float32[np.ndarray, " n"]
    """Distance on the map between their lines."""
    samples_m: Float32[np.ndarray, " n"]
    """Distance on the map between their samples."""

    def __len__(self) -> int:
        return len(self.corner)


def continuous_quads(
    planes: PixelPoints, parallax: ParallaxMap, step_px: float, gap_m: float
) -> Quads:
    """Quads whose sides all have steps of at most `step_px` of parallax and `gap_m` on the map."""
    with np.errstate(invalid="ignore"):
        down_step = np.abs(np.diff(parallax, axis=0)) <= step_px
        across_step = np.abs(np.diff(parallax, axis=1)) <= step_px
        down_m2, across_m2 = (_squared_steps(planes, axis) for axis in (0, 1))
        down_step &= down_m2 <= np.float32(gap_m**2)
        across_step &= across_m2 <= np.float32(gap_m**2)
    whole = down_step[:, :-1] & down_step[:, 1:] & across_step[:-1] & across_step[1:]
    row, col = np.nonzero(whole)
    return Quads(
        corner=row * parallax.shape[1] + col,
        lines_m=np.sqrt(np.maximum(down_m2[row, col], down_m2[row, col + 1])),
        samples_m=np.sqrt(np.maximum(across_m2[row, col], across_m2[row + 1, col])),
    )


def _squared_steps(planes: PixelPoints, axis: int) -> np.ndarray:
    """Squared distance on the map between neighbouring pixels along an axis of the image."""
    east, north = (np.diff(plane, axis=axis) for plane in planes[:2])
    return east * east + north * north


def quad_corners(quads: Quads, shape: tuple[int, int]) -> Mask:
    """Pixels that are a corner of some quad: those connected with others."""
    corner = np.zeros(shape[0] * shape[1], dtype=np.bool_)
    for shift in (0, 1, shape[1], shape[1] + 1):
        corner[quads.corner + shift] = True
    return corner.reshape(shape)


@dataclass(frozen=True, slots=True, eq=False)
class MeshSamples:
    """Samples between the pixels of a mesh."""

    points: Samples3
    sag_m: Float32[np.ndarray, " n"]
    """Length over which the ground between may deviate: L t (1 - t), L the spacing of the lines and
    t the position between them."""


def mesh_samples(planes: PixelPoints, quads: Quads, spacing_m: float) -> Iterator[MeshSamples]:
    """Samples that cover the quads wider than `spacing_m`, piece by piece.

    A quad is divided into as many parts as its sides need.
    """
    held: list[MeshSamples] = []
    count = 0
    for piece in _divide_quads(planes, quads, spacing_m):
        held.append(piece)
        count += len(piece.sag_m)
        if count > SAMPLES_AT_ONCE:
            yield _concatenate(held)
            held, count = [], 0
    if held:
        yield _concatenate(held)


def _concatenate(pieces: list[MeshSamples]) -> MeshSamples:
    return MeshSamples(
        np.concatenate([one.points for one in pieces], axis=1),
        np.concatenate([one.sag_m for one in pieces]),
    )


def _divide_quads(planes: PixelPoints, quads: Quads, spacing_m: float) -> Iterator[MeshSamples]:
    """Samples of the quads, grouped by equal division."""
    down = np.ceil(np.maximum(1, quads.lines_m / spacing_m)).astype(np.int64)
    across = np.ceil(np.maximum(1, quads.samples_m / spacing_m)).astype(np.int64)
    wide = np.flatnonzero(down * across > 1)  # elsewhere the pixels are close enough
    code = down[wide] * (int(across.max(initial=1)) + 1) + across[wide]
    order = wide[np.argsort(code, kind="stable")]
    _, starts = np.unique(np.sort(code), return_index=True)
    flat = planes.reshape(3, -1)
    for group in np.split(order, starts[1:]) if len(order) else ():
        parts = (int(down[group[0]]), int(across[group[0]]))
        piece = max(1, SAMPLES_AT_ONCE // (parts[0] * parts[1]))
        for first in range(0, len(group), piece):
            chosen = group[first : first + piece]
            corner, lines_m = quads.corner[chosen], quads.lines_m[chosen]
            yield _divide_group(flat, corner, lines_m, planes.shape[2], parts)


def _divide_group(
    flat: np.ndarray, corner: np.ndarray, lines_m: np.ndarray, width: int, parts: tuple[int, int]
) -> MeshSamples:
    """Bilinear samples at the middles of `parts` (down, across) of quads."""
    t, s = ((np.arange(n, dtype=np.float32) + np.float32(0.5)) / np.float32(n) for n in parts)
    upper, lower = (
        _interpolate(flat[:, None, corner + shift], flat[:, None, corner + shift + 1], s[:, None])
        for shift in (0, width)
    )
    points = _interpolate(upper[:, None], lower[:, None], t[:, None, None])
    points = np.moveaxis(points, -1, 1)  # computed with the quads last: parts are often two
    bow = np.repeat(t * (1 - t), parts[1])
    return MeshSamples(points.reshape(3, -1), (lines_m[:, None] * bow).ravel())


def _interpolate(one: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Points at these fractions of the distance from one to the other."""
    return one + share * (other - one)
