"""Rocks as landmarks: what stands above the ground is seen from all sides, under every sun.

In the image a rock is a patch of pixels whose points lie above the ground around them. With Z its
range, f the focal length and w, v its extent in columns and rows,

    width = w Z / f,        height = largest of the patch's heights above the ground,

and its place is the point at the patch's median range, moved away from the camera by half the
width: only the face is seen, and from the other side it is another face. The ground is the mean
elevation of a neighbourhood from which what stands out of it has been taken, step by step. Ranges
are known to s_Z = Z^2 s_p / (f B), elevations of far points therefore to s_Z h / Z, h being the
height of the mast; rocks must stand above that. Rocks of two stops may be the same if their widths
and heights agree; all pairs that may be the same vote for the place of the later stop (`voting`;
Li et al. 2007, 2011 match constellations of rocks between sites 26 m apart).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from photogrammetry.arrays import Flags, Float64, Int32, Mask, ObjectPoints, PerPoint, Raster
from photogrammetry.cameras.epipolar import EpipolarPair
from photogrammetry.errors import MatchingError
from photogrammetry.matching.birds_eye import BirdsEyeView, SearchGate
from photogrammetry.matching.records import MatchedPair, MatchedStop
from photogrammetry.matching.voting import Elected, Landmarks, VotingParams, elect

GROUND_ROUNDS = 4
"""Times that the ground is estimated anew without what stands out of it."""
SAME_CHI_SQUARE = 5.99
"""95 % point of chi-square with 2 degrees of freedom."""
ORIENTATION_SIGMA = 0.003
"""Radians: pointing of the mast, across the ray."""


@dataclass(frozen=True, slots=True)
class RockParams:
    """Which bumps are rocks, and which of them may be the same."""

    least_height_m: float = 0.08
    least_width_m: float = 0.12
    largest_width_m: float = 3.0
    farthest_m: float = 30.0
    least_pixels: int = 12
    ground_wave_m: float = 1.2
    """Standard deviation of the neighbourhood that the ground is the mean of."""
    edge_px: float = 1.0
    """Parallax that parts a rock from what stands behind it."""
    parallax_sigma_px: float = 0.3
    above_sigmas: float = 2.5
    """Of the elevation of a point, which a rock must exceed."""
    depth_share: float = 0.25
    """Standard deviation of half a rock's depth, as a share of its width."""
    size_ratio: float = 2.0
    """Widths, and heights, that differ by more than this factor are of two rocks."""
    voting: VotingParams = field(default_factory=VotingParams)

    def __post_init__(self) -> None:
        if not (0 < self.least_width_m < self.largest_width_m and self.size_ratio > 1):
            raise MatchingError(
                f"rocks are {self.least_width_m} to {self.largest_width_m} m wide and alike up to "
                f"a factor of {self.size_ratio}: give a rising range and a factor above 1"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """The rocks around a stop, in its level frame; widest first."""

    landmarks: Landmarks
    width_m: PerPoint
    height_m: PerPoint

    def __len__(self) -> int:
        return len(self.width_m)

    def taking(self, rows: np.ndarray) -> Rocks:
        """Some of the rocks."""
        marks = self.landmarks
        some = Landmarks(marks.places[rows], marks.covariances[rows])
        return Rocks(some, self.width_m[rows], self.height_m[rows])


def find_rocks(stop: MatchedStop, view: BirdsEyeView, params: RockParams) -> Rocks:
    """The rocks of all pairs of a stop, every one once; `view` shows the stop from above."""
    ground = _ground(view, params)
    each = [_rocks_of_pair(stop, pair, ground, view.cell_m, params) for pair in stop.pairs]
    every = _together(each)
    every = every.taking(np.argsort(-every.width_m, kind="stable"))
    return every.taking(_seen_once(every))


def _together(each: Sequence[Rocks]) -> Rocks:
    """The rocks of some pairs as one."""
    places = [np.zeros((0, 2)), *(r.landmarks.places for r in each)]
    covariances = [np.zeros((0, 2, 2)), *(r.landmarks.covariances for r in each)]
    return Rocks(
        Landmarks(np.concatenate(places), np.concatenate(covariances)),
        np.concatenate([np.zeros(0), *(r.width_m for r in each)]),
        np.concatenate([np.zeros(0), *(r.height_m for r in each)]),
    )


def match_rocks(
    earlier: Rocks, later: Rocks, gate: SearchGate, most: int, params: RockParams
) -> list[Elected]:
    """The places of the later stop that its rocks vote for."""
    pairs = alike(earlier, later, params)
    return elect(earlier.landmarks, later.landmarks, pairs, gate, most, params.voting)


def alike(earlier: Rocks, later: Rocks, params: RockParams) -> Int32[np.ndarray, "n 2"]:
    """Pairs of rocks whose width and height agree."""
    ratios = [
        np.abs(np.log(a[:, None] / b[None, :]))
        for a, b in ((earlier.width_m, later.width_m), (earlier.height_m, later.height_m))
    ]
    same = np.maximum(*ratios) < np.log(params.size_ratio)
    return np.argwhere(same).astype(np.int32)


def _ground(view: BirdsEyeView, params: RockParams) -> Raster:
    """Elevation of the ground without what stands on it, wherever something was seen near by."""
    wave = params.ground_wave_m / view.cell_m
    value, seen = np.nan_to_num(view.elevation), np.isfinite(view.elevation)
    ground = value
    for _ in range(GROUND_ROUNDS):
        weight = seen.astype(np.float32)
        density = np.maximum(cv2.GaussianBlur(weight, (0, 0), wave), 1e-6)
        ground = cv2.GaussianBlur(value * weight, (0, 0), wave) / density
        above = (value - ground) * weight
        spread = np.sqrt(cv2.GaussianBlur(above * above, (0, 0), wave) / density)
        seen = seen & (value < ground + spread)
    near = cv2.GaussianBlur(np.isfinite(view.elevation).astype(np.float32), (0, 0), wave)
    return np.where(near > 0.01, ground, np.nan).astype(np.float32)  # noqa: PLR2004 - seen near by


def _rocks_of_pair(
    stop: MatchedStop, pair: MatchedPair, ground: Raster, cell_m: float, params: RockParams
) -> Rocks:
    """The rocks that a pair shows."""
    geometry = pair.images.geometry
    scale = geometry.focal_px * geometry.base_m
    with np.errstate(invalid="ignore"):
        near = pair.images.left_mask & (pair.parallax > scale / params.farthest_m)
    line, sample = np.nonzero(near)
    parallax = pair.parallax[line, sample].astype(np.float64)
    points = geometry.triangulate(np.column_stack([sample, line]).astype(np.float64), parallax)
    level_from_rover = stop.lsl_from_rover.rotation
    origin = level_from_rover @ geometry.rover_from_pair.translation_m
    level = points @ (level_from_rover @ geometry.rover_from_pair.rotation).T + origin
    height = _height_above(level, ground, cell_m)
    sigma = points[:, 2] * params.parallax_sigma_px / scale * max(-origin[2], 0.5)
    with np.errstate(invalid="ignore"):
        raised = height > np.maximum(params.least_height_m, params.above_sigmas * sigma)
    mask = np.zeros(near.shape, np.uint8)
    mask[line[raised], sample[raised]] = 1
    mask[_edges(pair.parallax, params.edge_px)] = 0
    _, labels = cv2.connectedComponents(mask, connectivity=4)
    label = labels[line, sample]
    seen = label > 0
    patches = _Patches(
        label[seen], sample[seen], points[seen, 2], level[seen], height[seen], origin[:2], geometry
    )
    return _measured(patches, params)


def _height_above(level: ObjectPoints, ground: Raster, cell_m: float) -> PerPoint:
    """Height of level points above the ground, NaN where that is unknown."""
    half = ground.shape[0] / 2 - 0.5
    row = np.round(half - level[:, 0] / cell_m).astype(np.int64)
    col = np.round(half + level[:, 1] / cell_m).astype(np.int64)
    size = ground.shape[0]
    inside = (row >= 0) & (col >= 0) & (row < size) & (col < size)
    height = np.full(len(level), np.nan)
    height[inside] = -level[inside, 2] - ground[row[inside], col[inside]]
    return height


def _edges(parallax: Raster, edge_px: float) -> Mask:
    """Pixels beside which the parallax jumps."""
    known = np.nan_to_num(parallax).astype(np.float32)
    step = cv2.morphologyEx(known, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    return step > edge_px


@dataclass(frozen=True, slots=True, eq=False)
class _Patches:
    """What is known of the pixels that stand above the ground, and of the camera."""

    label: np.ndarray
    """Number of the patch that a pixel belongs to."""
    sample: np.ndarray
    range_m: PerPoint
    level: ObjectPoints
    height_m: PerPoint
    origin_m: Float64[np.ndarray, " 2"]
    geometry: EpipolarPair


def _measured(patches: _Patches, params: RockParams) -> Rocks:
    """Size, place and covariance of every patch that is a rock."""
    order = np.argsort(patches.label, kind="stable")
    starts = np.flatnonzero(np.diff(patches.label[order], prepend=-1))
    each = [_rock(patches, rows, params) for rows in np.split(order, starts[1:])]
    rocks = [rock for rock in each if rock is not None]
    places, covariances, widths, heights = ([rock[k] for rock in rocks] for k in range(4))
    marks = Landmarks(np.reshape(places, (-1, 2)), np.reshape(covariances, (-1, 2, 2)))
    return Rocks(marks, np.array(widths, np.float64), np.array(heights, np.float64))


def _rock(
    patches: _Patches, rows: np.ndarray, params: RockParams
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """(place, covariance, width, height) of the rock that some pixels show, None if it is none."""
    if len(rows) < params.least_pixels:
        return None
    g, z = patches.geometry, float(np.median(patches.range_m[rows]))
    width = float(np.ptp(patches.sample[rows]) + 1) * z / g.focal_px
    if not params.least_width_m <= width <= params.largest_width_m:
        return None
    face = np.median(patches.level[rows, :2], axis=0)
    ray = (face - patches.origin_m) / np.linalg.norm(face - patches.origin_m)
    range_sigma = z * z * params.parallax_sigma_px / (g.focal_px * g.base_m)
    along = np.hypot(range_sigma, params.depth_share * width)
    across = np.hypot(z * ORIENTATION_SIGMA, params.depth_share * width / 2)
    axes = np.column_stack([ray, [-ray[1], ray[0]]])
    covariance = axes @ np.diag([along**2, across**2]) @ axes.T
    height = float(np.percentile(patches.height_m[rows], 95))
    return face + ray * width / 2, covariance, width, height


def _seen_once(rocks: Rocks) -> Flags:
    """All but those that are a wider rock seen by another pair, or a part of it."""
    kept = np.ones(len(rocks), dtype=bool)
    places, covariances = rocks.landmarks.places, rocks.landmarks.covariances
    for k in range(len(rocks)):
        earlier = np.flatnonzero(kept[:k])
        if not len(earlier):
            continue
        off = places[earlier] - places[k]
        both = np.linalg.inv(covariances[earlier] + covariances[k])
        kept[k] = np.einsum("ni,nij,nj->n", off, both, off).min() > SAME_CHI_SQUARE
    return kept
