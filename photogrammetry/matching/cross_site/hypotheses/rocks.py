"""Rocks as landmarks: what stands above the ground is seen from all sides, under every sun.

The ground is the mean elevation of a neighbourhood from which what stands out of it has been taken,
step by step. With h the height of the mast and s_p that of a parallax, the elevation of a point at
the range Z is known to

    s_Z h / Z = Z s_p h / (f B),

and what is raised by less than some of these may be noise. Pixels beside which the parallax jumps
are left out, so that what stands one behind the other falls into two patches.

In the image a rock is a patch of pixels whose points lie above the ground around them. With Z its
range, f the focal length and w, v its extent in columns and rows,

    width = w Z / f,        height = largest of the patch's heights above the ground,

and its place is the point at the patch's median range, moved away from the camera by half the
width: only the face is seen, and from the other side it is another face. Rocks of two stops may be
the same if their widths and heights agree; all pairs that may be the same vote for the place of the
later stop (`voting`; Li et al. 2007 and 2011 match constellations of rocks between sites 26 m
apart).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, Int32, Mask, ObjectPoints, PerPoint, Raster
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeView, SearchGate
from solmap.photogrammetry.matching.cross_site.hypotheses.voting import (
    Landmarks,
    VotedPlace,
    VotingParams,
    vote_for_places,
)
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop
from solmap.photogrammetry.ranges import FactorFromOne, Metres, MetresOrZero

HIGHEST_PERCENT = 95.0
"""Percentile of a patch's heights that counts as its largest: single pixels may be wrong."""

SAME_CHI_SQUARE = 5.99
"""95 % point of chi-square with 2 degrees of freedom."""

ORIENTATION_SIGMA = 0.003
"""Radians: pointing of the mast, across the ray."""

GROUND_ROUNDS = 4
"""Times that the ground is estimated anew without what stands out of it."""


LEAST_PIXELS = 12


GROUND_WAVE_M = 1.2
"""Standard deviation of the neighbourhood that the ground is the mean of."""


EDGE_PX = 1.0
"""Parallax that parts a rock from what stands behind it."""


PARALLAX_SIGMA_PX = 0.3


ABOVE_SIGMAS = 2.5
"""Of the elevation of a point, which a rock must exceed."""


DEPTH_SHARE = 0.25
"""Standard deviation of half a rock's depth, as a share of its width."""


@dataclass(frozen=True, slots=True)
class RockParams:
    """Which bumps are rocks, and which of them may be the same."""

    least_height_m: MetresOrZero = 0.08
    least_width_m: Metres = 0.12
    largest_width_m: Metres = 3.0
    farthest_m: Metres = 30.0
    size_ratio: FactorFromOne = 2.0
    """Widths, and heights, that differ by more than this factor are of two rocks."""
    voting: VotingParams = field(
        default_factory=lambda: VotingParams(cell_m=0.3, azimuth_step=0.0175)
    )
    """Coarse: at 15 m a rock is placed to 0.3 m, and least squares settle what is found."""

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

    def select(self, rows: np.ndarray) -> Rocks:
        """Some of the rocks."""
        marks = self.landmarks
        some = Landmarks(marks.places[rows], marks.covariances[rows])
        return Rocks(some, self.width_m[rows], self.height_m[rows])


@dataclass(frozen=True, slots=True, eq=False)
class RaisedPatches:
    """The pixels of a pair that stand above the ground, and the camera."""

    label: np.ndarray
    """Number of the patch that a pixel belongs to."""
    sample: np.ndarray
    range_m: PerPoint
    level: ObjectPoints
    height_m: PerPoint
    origin_m: Float64[np.ndarray, " 2"]
    geometry: EpipolarPair


def find_rocks(stop: MatchedStop, view: BirdsEyeView, params: RockParams) -> Rocks:
    """The rocks of all pairs of a stop, every one once; `view` shows the stop from above."""
    ground = bare_ground(view)
    raised = (raised_patches(stop, pair, ground, view.cell_m, params) for pair in stop.pairs)
    each = [_rocks_in(patches, params) for patches in raised]
    every = _join(each)
    every = every.select(np.argsort(-every.width_m, kind="stable"))
    return every.select(_unique(every))


def match_rocks(
    earlier: Rocks, later: Rocks, gate: SearchGate, most: int, params: RockParams
) -> list[VotedPlace]:
    """The places of the later stop that its rocks vote for."""
    pairs = similar_rocks(earlier, later, params)
    return vote_for_places(earlier.landmarks, later.landmarks, pairs, gate, most, params.voting)


def similar_rocks(earlier: Rocks, later: Rocks, params: RockParams) -> Int32[np.ndarray, "n 2"]:
    """Pairs of rocks whose width and height agree."""
    ratios = [
        np.abs(np.log(a[:, None] / b[None, :]))
        for a, b in ((earlier.width_m, later.width_m), (earlier.height_m, later.height_m))
    ]
    same = np.maximum(*ratios) < np.log(params.size_ratio)
    return np.argwhere(same).astype(np.int32)


def _join(each: Sequence[Rocks]) -> Rocks:
    """All of some rocks."""
    places = [np.zeros((0, 2)), *(r.landmarks.places for r in each)]
    covariances = [np.zeros((0, 2, 2)), *(r.landmarks.covariances for r in each)]
    return Rocks(
        Landmarks(np.concatenate(places), np.concatenate(covariances)),
        np.concatenate([np.zeros(0), *(r.width_m for r in each)]),
        np.concatenate([np.zeros(0), *(r.height_m for r in each)]),
    )


def _rocks_in(patches: RaisedPatches, params: RockParams) -> Rocks:
    """The patches that are rocks."""
    order = np.argsort(patches.label, kind="stable")
    starts = np.flatnonzero(np.diff(patches.label[order], prepend=-1))
    each = [_rock(patches, rows, params) for rows in np.split(order, starts[1:])]
    return _join([rock for rock in each if rock is not None])


def _rock(patches: RaisedPatches, rows: np.ndarray, params: RockParams) -> Rocks | None:
    """The rock that some pixels show, None if it is none."""
    if len(rows) < LEAST_PIXELS:
        return None
    g, z = patches.geometry, float(np.median(patches.range_m[rows]))
    width = float(np.ptp(patches.sample[rows]) + 1) * z / g.focal_px
    if not params.least_width_m <= width <= params.largest_width_m:
        return None
    face = np.median(patches.level[rows, :2], axis=0)
    ray = (face - patches.origin_m) / np.linalg.norm(face - patches.origin_m)
    range_sigma = z * z * PARALLAX_SIGMA_PX / (g.focal_px * g.base_m)
    along = np.hypot(range_sigma, DEPTH_SHARE * width)
    across = np.hypot(z * ORIENTATION_SIGMA, DEPTH_SHARE * width / 2)
    axes = np.column_stack([ray, [-ray[1], ray[0]]])
    covariance = axes @ np.diag([along**2, across**2]) @ axes.T
    place = face + ray * width / 2
    height = float(np.percentile(patches.height_m[rows], HIGHEST_PERCENT))
    return Rocks(Landmarks(place[None], covariance[None]), np.array([width]), np.array([height]))


def _unique(rocks: Rocks) -> Flags:
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


def bare_ground(view: BirdsEyeView) -> Raster:
    """Elevation of the ground without what stands on it, wherever something was seen near by."""
    wave = GROUND_WAVE_M / view.cell_m
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


def raised_patches(
    stop: MatchedStop, pair: MatchedPair, ground: Raster, cell_m: float, params: RockParams
) -> RaisedPatches:
    """What a pair shows above the ground, connected pixels as one patch."""
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
    sigma = points[:, 2] * PARALLAX_SIGMA_PX / scale * max(-origin[2], 0.5)
    with np.errstate(invalid="ignore"):
        raised = height > np.maximum(params.least_height_m, ABOVE_SIGMAS * sigma)
    mask = np.zeros(near.shape, np.uint8)
    mask[line[raised], sample[raised]] = 1
    mask[_edges(pair.parallax, EDGE_PX)] = 0
    _, labels = cv2.connectedComponents(mask, connectivity=4)
    label = labels[line, sample]
    seen = label > 0
    return RaisedPatches(
        label[seen], sample[seen], points[seen, 2], level[seen], height[seen], origin[:2], geometry
    )


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
