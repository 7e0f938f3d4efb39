"""Rocks as landmarks: what stands above the ground is seen from all sides, under every sun.

In the image a rock is a patch of pixels whose points lie above the ground around them. With Z its
range, f the focal length and w, v its extent in columns and rows,

    width = w Z / f,        height = largest of the patch's heights above the ground,

and its place is the point at the patch's median range, moved away from the camera by half the
width: only the face is seen, and from the other side it is another face (`raised_ground` tells what
stands above). Rocks of two stops may be the same if their widths and heights agree; all pairs that
may be the same vote for the place of the later stop (`voting`; Li et al. 2007 and 2011 match
constellations of rocks between sites 26 m apart).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Flags, Int32, PerPoint
from solmap.photogrammetry.matching.birds_eye import BirdsEyeView, SearchGate
from solmap.photogrammetry.matching.raised_ground import (
    RaisedPatches,
    RockParams,
    ground_below,
    raised_patches,
)
from solmap.photogrammetry.matching.records import MatchedStop
from solmap.photogrammetry.matching.voting import Elected, Landmarks, elect


HIGHEST_PERCENT = 95.0
"""Percentile of a patch's heights that counts as its largest: single pixels may be wrong."""
SAME_CHI_SQUARE = 5.99
"""95 % point of chi-square with 2 degrees of freedom."""
ORIENTATION_SIGMA = 0.003
"""Radians: pointing of the mast, across the ray."""


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
    ground = ground_below(view, params)
    raised = (raised_patches(stop, pair, ground, view.cell_m, params) for pair in stop.pairs)
    each = [_measured(patches, params) for patches in raised]
    every = _together(each)
    every = every.taking(np.argsort(-every.width_m, kind="stable"))
    return every.taking(_seen_once(every))


def _together(each: Sequence[Rocks]) -> Rocks:
    """All of some rocks."""
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


def _measured(patches: RaisedPatches, params: RockParams) -> Rocks:
    """The patches that are rocks."""
    order = np.argsort(patches.label, kind="stable")
    starts = np.flatnonzero(np.diff(patches.label[order], prepend=-1))
    each = [_rock(patches, rows, params) for rows in np.split(order, starts[1:])]
    return _together([rock for rock in each if rock is not None])


def _rock(patches: RaisedPatches, rows: np.ndarray, params: RockParams) -> Rocks | None:
    """The rock that some pixels show, None if it is none."""
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
    place = face + ray * width / 2
    height = float(np.percentile(patches.height_m[rows], HIGHEST_PERCENT))
    return Rocks(Landmarks(place[None], covariance[None]), np.array([width]), np.array([height]))


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
