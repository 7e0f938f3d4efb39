"""The ground as one view sees it: which parallaxes are trusted, and the mesh between them.

Neighbouring pixels of the left epipolar image form a mesh. With p = f B / Z, a plane that passes h
below the camera (measured along the image's y axis) changes by B / h pixels of parallax a line,
whatever its distance, so continuous ground has small steps everywhere and an occlusion edge does
not: the step tells them apart. The relative standard deviation along the view is

    sigma_Z / Z = sigma_p / p

which is how far a view is believed. Coordinates are (east, north, up) in metres from the camera, in
single precision: a hundredth of a millimetre at a hundred metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from photogrammetry.arrays import Float32, Float64, ParallaxMap, Vector3
from photogrammetry.frames import Pose
from photogrammetry.terrain.records import TerrainView

Planes3 = Float32[np.ndarray, "3 lines samples"]
"""East, north and up of every pixel, metres from the camera; NaN where not trusted."""
Samples3 = Float32[np.ndarray, "3 n"]
"""East, north and up of samples of the surface, metres from the camera."""

MAP_FROM_LSL = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Turns (north, east, down) into (east, north, up)."""
SUBPIXEL = 16
"""Steps a pixel in which parallax is compared when regions are grown."""
SAMPLES_AT_ONCE = 2_000_000
"""Mesh samples held at one time: some tens of megabytes."""


@dataclass(frozen=True, slots=True)
class MeshParams:
    """Which parallaxes to trust and what to take for one continuous surface."""

    sigma_parallax_px: float = 0.25
    """Standard deviation of a dense parallax: published stereo has 0.32 px on board and 0.1-0.2 px
    with a good sub-pixel matcher on texture (NPO-42487; Di et al. 2008)."""
    max_relative_sigma: float = 0.03
    """Largest standard deviation along the view over the distance. Three percent is reached at 29 m
    by Navcam and 129 m by Pancam: the extents of the paper's maps (section 5)."""
    radius_m: float = 60.0
    """Farthest ground from the camera: half of the 120 m that the paper maps from Pancam."""
    max_spike_px: float = 0.75
    """Largest distance from the median of the neighbourhood: three standard deviations."""
    min_height_m: float = 0.4
    """Least height of the camera above the plane of continuous ground, which may then step by
    B / height a pixel: 0.5 px with Navcam, 0.75 px with Pancam. Flat ground lies 1.5 m below a mast
    and 0.5 m below a hazard camera; a plane any nearer is seen edge-on, as are only the sides and
    backs of rocks."""
    min_region_px: int = 100
    """Smallest connected patch of parallax: two matching windows of 7 x 7 side by side."""
    max_gap_m: float = 0.5
    """Widest gap bridged between neighbouring pixels: the line spacing of Navcam on flat ground at
    the end of its range, Z^2 / (f h) = 29^2 / (1222 x 1.5) = 0.46 m."""


def map_from_pair_rotation(lsl_from_pair: Pose) -> Float64[np.ndarray, "3 3"]:
    """Rotation from (right, down, forward) of a pair to (east, north, up)."""
    return MAP_FROM_LSL @ lsl_from_pair.rotation


def camera_on_map(lsl_from_pair: Pose) -> Vector3:
    """East, north and elevation of the left camera, metres."""
    return MAP_FROM_LSL @ lsl_from_pair.translation_m


def trusted_parallax(view: TerrainView, params: MeshParams) -> ParallaxMap:
    """The parallax without what is too far, alone, or between two surfaces.

    A pixel stays when it agrees with the median of its 5 x 5 neighbourhood, unmatched neighbours
    counting as infinitely far: pixels smeared between a rock and the ground behind it are few and
    lie near neither. Patches that hang together by small steps must reach a smallest size.
    """
    parallax = np.where(view.mask & np.isfinite(view.parallax), view.parallax, 0.0)
    parallax = parallax.astype(np.float32)
    farthest = params.sigma_parallax_px / params.max_relative_sigma
    parallax[parallax < farthest] = 0.0
    spike = np.abs(parallax - cv2.medianBlur(parallax, 5)) > params.max_spike_px
    parallax[spike] = 0.0
    steps = np.clip(parallax * SUBPIXEL, 0, np.iinfo(np.int16).max).astype(np.int16)
    step = round(largest_step_px(view.geometry.base_m, params) * SUBPIXEL)
    cv2.filterSpeckles(steps, 0, params.min_region_px, step)
    return np.where(steps > 0, parallax, np.float32(np.nan))


def largest_step_px(base_m: float, params: MeshParams) -> float:
    """Largest step of parallax between neighbouring pixels of continuous ground."""
    return base_m / params.min_height_m


def ground_of(view: TerrainView, parallax: ParallaxMap, params: MeshParams) -> Planes3:
    """Where every trusted pixel lies, from the camera; NaN beyond the radius."""
    geometry = view.geometry
    rotation = map_from_pair_rotation(view.lsl_from_pair)
    across = (np.arange(parallax.shape[1]) - geometry.centre_px[0]) / geometry.focal_px
    down = (np.arange(parallax.shape[0]) - geometry.centre_px[1]) / geometry.focal_px
    depth = np.float32(geometry.focal_px * geometry.base_m) / parallax
    planes = np.empty((3, *parallax.shape), dtype=np.float32)
    for axis, (right, below, forward) in enumerate(rotation):
        ray = (right * across[None, :] + below * down[:, None] + forward).astype(np.float32)
        np.multiply(ray, depth, out=planes[axis])
    planes[:, np.hypot(planes[0], planes[1]) > params.radius_m] = np.nan
    return planes


_Quads = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class MeshSamples:
    """Samples between the pixels of a mesh."""

    points: Samples3
    sag_m: Float32[np.ndarray, " n"]
    """Length that the ground between may stray over: L t (1 - t), L the spacing of the lines and
    t the place between them."""


def mesh_samples(
    planes: Planes3, parallax: ParallaxMap, spacing_m: float, step_px: float, gap_m: float
) -> Iterator[MeshSamples]:
    """Samples that cover the quads of the mesh which are wider than `spacing_m`, piece by piece.

    A quad is one surface when none of its four sides steps by more than `step_px` in parallax or
    `gap_m` on the ground. It is divided bilinearly into as many parts as its sides need.
    """
    quads = _continuous_quads(planes, parallax, step_px, gap_m)
    held: list[MeshSamples] = []
    for piece in _divided_quads(planes, quads, spacing_m):
        held.append(piece)
        if sum(len(one.sag_m) for one in held) > SAMPLES_AT_ONCE:
            yield _joined(held)
            held = []
    if held:
        yield _joined(held)


def _joined(pieces: list[MeshSamples]) -> MeshSamples:
    return MeshSamples(
        np.concatenate([one.points for one in pieces], axis=1),
        np.concatenate([one.sag_m for one in pieces]),
    )


def _divided_quads(planes: Planes3, quads: _Quads, spacing_m: float) -> Iterator[MeshSamples]:
    """Samples of the quads, those of equal division together."""
    corners, lines, samples = quads
    down = np.ceil(np.maximum(1, lines / spacing_m)).astype(np.int64)
    across = np.ceil(np.maximum(1, samples / spacing_m)).astype(np.int64)
    wide = np.flatnonzero(down * across > 1)  # elsewhere the pixels themselves are close enough
    code = down[wide] * (int(across.max(initial=1)) + 1) + across[wide]
    order = wide[np.argsort(code, kind="stable")]
    _, starts = np.unique(np.sort(code), return_index=True)
    flat = planes.reshape(3, -1)
    for group in np.split(order, starts[1:]) if len(order) else ():
        parts = (int(down[group[0]]), int(across[group[0]]))
        piece = max(1, SAMPLES_AT_ONCE // (parts[0] * parts[1]))
        for first in range(0, len(group), piece):
            chosen = group[first : first + piece]
            yield _divide(flat, corners[chosen], lines[chosen], planes.shape[2], parts)


def _continuous_quads(
    planes: Planes3, parallax: ParallaxMap, step_px: float, gap_m: float
) -> _Quads:
    """First corners of the quads of one surface, and their sides on the ground down and across."""
    with np.errstate(invalid="ignore"):
        down_step = np.abs(np.diff(parallax, axis=0)) <= step_px
        across_step = np.abs(np.diff(parallax, axis=1)) <= step_px
        down_m = np.hypot(*np.diff(planes[:2], axis=1))
        across_m = np.hypot(*np.diff(planes[:2], axis=2))
        down_step &= down_m <= gap_m
        across_step &= across_m <= gap_m
    whole = down_step[:, :-1] & down_step[:, 1:] & across_step[:-1] & across_step[1:]
    row, col = np.nonzero(whole)
    corners = row * parallax.shape[1] + col
    lines = np.maximum(down_m[row, col], down_m[row, col + 1])
    samples = np.maximum(across_m[row, col], across_m[row + 1, col])
    return corners, lines, samples


def _divide(
    flat: np.ndarray, corners: np.ndarray, lines: np.ndarray, width: int, parts: tuple[int, int]
) -> MeshSamples:
    """Bilinear samples at the middles of `parts` (down, across) of quads."""
    t = ((np.arange(parts[0], dtype=np.float32) + 0.5) / parts[0])[:, None]
    s = ((np.arange(parts[1], dtype=np.float32) + 0.5) / parts[1])[None, :]
    weights = ((1 - t) * (1 - s), (1 - t) * s, t * (1 - s), t * s)
    points = np.zeros((3, len(corners), parts[0] * parts[1]), dtype=np.float32)
    for weight, shift in zip(weights, (0, 1, width, width + 1), strict=True):
        points += flat[:, corners + shift, None] * weight.ravel()
    bow = np.broadcast_to(t * (1 - t), parts).ravel()
    return MeshSamples(points.reshape(3, -1), (lines[:, None] * bow).ravel())
