"""Ties measured again in the original images, over the facet of ground they lie on.

A patch of ground is drawn over a surface with errors of its own; the relief that it misses deforms
the patch, and against truth its place is good to 0.4 cells. Once the pose between the stops is
known, the facet around a tie maps one epipolar image straight onto the other (`local_surface`), and
least-squares matching there (`conjugates`) is left with what the images themselves show: half the
error. What it does not find keeps its place, with the standard deviation of a patch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Float64, Int32
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.alignment import Alignment
from solmap.photogrammetry.matching.conjugates import (
    ConjugateParams,
    TieView,
    find_conjugates,
    measured_parallax,
)
from solmap.photogrammetry.matching.ground_spread import spread_on_the_ground
from solmap.photogrammetry.matching.parallax_planes import (
    ParallaxPlanes,
    mapped,
    parallax_planes,
    plane_homographies,
)
from solmap.photogrammetry.matching.records import Ties

MEASURED_AGAIN = ("left", "parallax_px", "sigma_px", "sigma_line_px", "sigma_parallax_px")
"""Columns of a second measurement."""


@dataclass(frozen=True, slots=True)
class RefinementParams:
    """How ties are measured again."""

    facet: ConjugateParams = field(
        default_factory=lambda: ConjugateParams(
            half_px=8, threshold=0.6, ambiguity=1.0, sigma_floor_px=0.25
        )
    )
    """The place is known, so it need not be the only one. Stops look at the ground from different
    sides: against truth, a quarter of a common cell is what least squares come to."""
    reach: int = 3
    """Cells to each side: the 0.4 cells of a patch, and what is left of the pose, three times."""

    def __post_init__(self) -> None:
        if self.reach < 1:
            raise MatchingError(f"a tie is looked for 1 cell around or more, not {self.reach}")


def refined(
    ties: Ties,
    views: Mapping[str, TieView],
    alignment: Alignment,
    params: RefinementParams,
    parallax: ConjugateParams,
) -> Ties:
    """The ties, those that are found again with the place and parallax measured there."""
    columns = {name: getattr(ties, f"second_{name}").copy() for name in MEASURED_AGAIN}
    for a, b in sorted({*zip(ties.first.tolist(), ties.second.tolist(), strict=True)}):
        rows = np.flatnonzero((ties.first == a) & (ties.second == b)).astype(np.int32)
        source, target = views[ties.pair_ids[a]], views[ties.pair_ids[b]]
        target_from_source = _between(source, target, alignment)
        maps = _maps(ties, rows, source, target, target_from_source, params.facet.half_px)
        found = find_conjugates(
            source.left, target.left, ties.first_left[rows], maps, params.reach, params.facet
        )
        there = rows[found.found]
        points, spread = found.points[found.found], found.spread[found.found]
        measured, of_parallax = measured_parallax(target, points, parallax)
        good = np.isfinite(measured)
        sample, line, of_parallax = spread_on_the_ground(
            target, points, measured, of_parallax, spread
        )
        again = (points, measured, sample, line, of_parallax)
        for name, column in zip(MEASURED_AGAIN, again, strict=True):
            columns[name][there[good]] = column[good]
    return replace(ties, **{f"second_{name}": column for name, column in columns.items()})


def _between(source: TieView, target: TieView, alignment: Alignment) -> Pose:
    """target_from_source with the pose and the pointing that the alignment found."""
    first, second = (pointed(view, alignment) for view in (source, target))
    return second.inverse @ alignment.first_from_second.inverse @ first


def pointed(view: TieView, alignment: Alignment) -> Pose:
    """rover_from_pair, its pointing corrected."""
    pose = view.geometry.rover_from_pair
    theta = alignment.pointing.get(view.pair.pair_id, np.zeros(3))
    turn = ScipyRotation.from_rotvec(theta).as_matrix()
    return Pose(pose.target, pose.source, pose.rotation @ turn, pose.translation_m)


def _maps(
    ties: Ties,
    rows: Int32[np.ndarray, " n"],
    source: TieView,
    target: TieView,
    target_from_source: Pose,
    half_px: int,
) -> Float64[np.ndarray, "n 3 3"]:
    """Maps over the facet of every tie, moved to carry the first point onto the second one."""
    points = ties.first_left[rows]
    planes = parallax_planes(source.pair.parallax, points, half_px)
    planes = ParallaxPlanes(ties.first_parallax_px[rows], planes.gradient, planes.residual_px)
    maps = plane_homographies(source.geometry, target.geometry, target_from_source, points, planes)
    at, _ = mapped(maps, points)
    moves = np.tile(np.eye(3), (len(rows), 1, 1))
    moves[:, :2, 2] = ties.second_left[rows] - at
    return moves @ maps
