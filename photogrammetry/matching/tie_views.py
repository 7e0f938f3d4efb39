"""Matched pairs made ready for tying: pyramids, candidates, and parallax wherever it is asked for.

A conjugate found in the left image of a pair is a tie once its parallax is known. The dense
parallax gives the local surface; the parallax itself is measured anew at the very point, by
least-squares matching of the left patch in the right image over that surface, so that a tie does
not inherit the smoothing and the pixel-locking of the dense matcher.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, ImagePoints, Int32, PerPoint
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.conjugates import (
    ConjugateParams,
    Conjugates,
    View,
    find_conjugates,
)
from solmap.photogrammetry.matching.local_surface import (
    ParallaxPlanes,
    parallax_planes,
    plane_homographies,
    right_from_left,
)
from solmap.photogrammetry.matching.records import MatchedPair
from solmap.photogrammetry.matching.ties import Ties

LARGEST_Y_PX = 1.0
"""Vertical parallax at which a match in the right image is not the same point."""
DEFINED_PX = 0.02
"""An interest point is where it is by definition; what is left is the resampling of its image."""
DENSE_AGREES_PX = 1.5
"""The measured parallax may differ this much, and three times the surface's roughness, from it."""


@dataclass(frozen=True, eq=False)
class TieView:
    """A matched pair with what tying needs of it, worked out once."""

    pair: MatchedPair
    left: View
    right: View
    half_px: int
    """Half the width of the local surfaces."""

    @classmethod
    def of(cls, pair: MatchedPair, half_px: int = 10) -> TieView:
        """Make a pair ready."""
        images = pair.images
        return cls(
            pair,
            View.of(images.left, images.left_mask),
            View.of(images.right, images.right_mask),
            half_px,
        )

    @cached_property
    def planes(self) -> ParallaxPlanes:
        """Local surfaces around every sparse match of the pair."""
        return parallax_planes(self.pair.parallax, self.pair.matches.left, self.half_px)

    @property
    def geometry(self) -> EpipolarPair:
        """The pair's ideal stereo camera."""
        return self.pair.images.geometry

    @property
    def ground_sigma_m(self) -> PerPoint:
        """Standard deviation in range of every sparse match, metres: Z^2 sigma_p / (B f)."""
        matches, g = self.pair.matches, self.geometry
        scale = g.focal_px * g.base_m
        return scale * matches.sigma_px / np.maximum(matches.parallax_px, 1e-3) ** 2


def measured_parallax(
    view: TieView, points: ImagePoints, params: ConjugateParams
) -> tuple[PerPoint, PerPoint]:
    """(parallax, its standard deviation) at left image points; NaN where it cannot be measured."""
    parallax, sigma = np.full(len(points), np.nan), np.full(len(points), np.nan)
    if not len(points):
        return parallax, sigma
    planes = parallax_planes(view.pair.parallax, points, params.half_px)
    ok = planes.found & (planes.parallax_px > 0)
    some = _rows(planes, ok)
    found = find_conjugates(
        view.left,
        view.right,
        points[ok],
        right_from_left(points[ok], some),
        2,
        replace(params, ambiguity=1.0),
    )
    value = points[ok, 0] - found.points[:, 0]
    near = np.abs(value - some.parallax_px) < DENSE_AGREES_PX + 3 * some.residual_px
    level = np.abs(found.points[:, 1] - points[ok, 1]) < LARGEST_Y_PX
    good = found.found & near & level & (value > 0)
    parallax[np.flatnonzero(ok)[good]] = value[good]
    sigma[np.flatnonzero(ok)[good]] = np.maximum(found.sigma_px[good], params.parallax_floor_px)
    return parallax, sigma


def dense_parallax(
    view: TieView, points: ImagePoints, sigma_px: float
) -> tuple[PerPoint, PerPoint]:
    """(parallax, its standard deviation) at left image points, as dense matching has it."""
    lines, samples = view.pair.parallax.shape
    col = np.clip(np.round(points[:, 0]), 0, samples - 1).astype(np.int64)
    row = np.clip(np.round(points[:, 1]), 0, lines - 1).astype(np.int64)
    parallax = view.pair.parallax[row, col].astype(np.float64)
    parallax[parallax <= 0] = np.nan
    return parallax, np.where(np.isfinite(parallax), sigma_px, np.nan)


def _rows(planes: ParallaxPlanes, rows: Flags) -> ParallaxPlanes:
    """The planes of some points."""
    return ParallaxPlanes(planes.parallax_px[rows], planes.gradient[rows], planes.residual_px[rows])


def predicted_points(
    source: TieView, target: TieView, target_from_source: Pose, rows: Flags
) -> tuple[
    Float64[np.ndarray, "some 2"], Float64[np.ndarray, " some"], Float64[np.ndarray, "some 3"]
]:
    """(image, parallax, point) in the target of some sparse matches of the source."""
    matches = source.pair.matches
    points = source.geometry.triangulate(matches.left[rows], matches.parallax_px[rows])
    in_target = target_from_source.apply(points)
    left, parallax = target.geometry.project(in_target)
    return left, parallax, in_target


def in_view(view: TieView, left: ImagePoints, margin_px: int) -> Flags:
    """Whether image points lie on usable pixels, away from the frame."""
    g = view.geometry
    with np.errstate(invalid="ignore"):
        inside = (
            (left[:, 0] >= margin_px)
            & (left[:, 0] <= g.samples - 1 - margin_px)
            & (left[:, 1] >= margin_px)
            & (left[:, 1] <= g.lines - 1 - margin_px)
        )
    usable = np.zeros(len(left), dtype=bool)
    col, row = np.round(left[inside]).astype(np.int64).T
    usable[inside] = view.left.mask[row, col]
    return usable


def tie_pair(  # noqa: PLR0913, PLR0917 - two views, what joins them, which matches, and how
    source: TieView,
    target: TieView,
    target_from_source: Pose,
    rows: Int32[np.ndarray, " n"],
    reach: int,
    params: ConjugateParams,
    pair_ids: tuple[str, ...],
) -> Ties:
    """Ties between sparse matches `rows` of the source pair and wherever they are in the target."""
    matches = source.pair.matches
    planes = ParallaxPlanes(
        matches.parallax_px[rows], source.planes.gradient[rows], source.planes.residual_px[rows]
    )
    good = np.isfinite(planes.gradient).all(axis=1)
    rows, planes = rows[good], _rows(planes, good)
    points = matches.left[rows]
    maps = plane_homographies(source.geometry, target.geometry, target_from_source, points, planes)
    found = find_conjugates(source.left, target.left, points, maps, reach, params)
    parallax, sigma_parallax = measured_parallax(target, found.points[found.found], params)
    floor_px = params.parallax_floor_px
    return _assembled(source, target, rows, found, parallax, sigma_parallax, pair_ids, floor_px)


def _assembled(  # noqa: PLR0913, PLR0917 - gathers the columns of the ties
    source: TieView,
    target: TieView,
    rows: Int32[np.ndarray, " n"],
    found: Conjugates,
    parallax: Float64[np.ndarray, " found"],
    sigma_parallax: Float64[np.ndarray, " found"],
    pair_ids: tuple[str, ...],
    floor_px: float,
) -> Ties:
    """Found conjugates with measured parallax, as ties."""
    matches, some = source.pair.matches, rows[found.found]
    indices = [
        np.full(len(some), pair_ids.index(v.pair.pair_id), np.int32) for v in (source, target)
    ]
    ties = Ties(
        pair_ids,
        indices[0],
        indices[1],
        matches.left[some],
        found.points[found.found],
        matches.parallax_px[some],
        parallax,
        np.full(len(some), DEFINED_PX),
        found.sigma_px[found.found],
        np.maximum(matches.sigma_px[some], floor_px),
        sigma_parallax,
        np.full(len(some), DEFINED_PX),
        found.sigma_px[found.found],
    )
    return ties.taking(np.isfinite(parallax))
