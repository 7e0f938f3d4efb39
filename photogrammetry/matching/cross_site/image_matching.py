"""Image-matched cross-site ties: patches of ground matched, then refined in the images.

Around a candidate both pairs are resampled to orthophotos over the surfaces of their own stops
(`ground_views`), and matched on the ground (`conjugates`). The centre of the patch and its
conjugate are then image points of the two pairs, where the parallax is measured.

A matching error displaces a point along the ground: its image moves along the surface, and its
parallax is that of the displaced point. With the standard deviation s of a cell and the derivative
P of the image by cells (columns: the axes of the patch), displacements of one standard deviation
are the columns of S = s P, and with g the gradient of parallax over the image on the surface
around,

    s_x^2 = |S_x|^2 + (f r/Z)^2      s_y^2 = |S_y|^2 + (f r/Z)^2      s_p'^2 = s_p^2 + |g' S|^2

where r is the height of ground above or below the patch's surface, which limits the accuracy
because stops on different sides see different faces of it. At a grazing angle a shift on the ground
moves a point far more across an image than up: at 17 m a shift of 10 cm is 20 pixels of a Pancam
sideways, but 2 pixels up. With equal standard deviations of both, heights would get a tenth of
their proper weight and ranges ten times theirs, and links between stops would be less accurate than
stated.

The surface of a patch has errors; missing relief deforms the patch, and compared with truth its
position is accurate to 0.4 cells. Once the pose between the stops is known, the facet around a tie
maps one epipolar image directly to the other (`parallax_planes`), and least-squares matching there
(`refine_ties`) depends only on the images: half the error. Ties that it does not find keep their
position, with the standard deviation of a patch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import (
    Flags,
    Float32,
    Float64,
    ImagePoints,
    Int32,
    PerPoint,
)
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.alignment import Alignment
from solmap.photogrammetry.matching.conjugates import (
    ConjugateParams,
    TieView,
    find_conjugates,
    in_view,
    match_patches,
    measure_parallax,
)
from solmap.photogrammetry.matching.cross_site.candidates import Plan, horizontal_turn
from solmap.photogrammetry.matching.cross_site.light import shadow_difference
from solmap.photogrammetry.matching.parallax_planes import (
    ParallaxPlanes,
    map_points,
    parallax_planes,
    plane_homographies,
)
from solmap.photogrammetry.matching.records import Ties, join_ties
from solmap.photogrammetry.ranges import HalfWindow

WINDOW_STEP = 8
"""Step of window sizes in cells: patches of one size are resampled together."""

MARGIN_CELLS = 3
"""Additional width of search patches, for refinement."""

ParallaxOf = Callable[[TieView, ImagePoints], tuple[PerPoint, PerPoint]]
"""(parallax, standard deviation) at left image points of a pair; NaN where there is none."""

RELIEF_M = 0.015
"""r: height of soil and pebbles above the mean of a patch; compared with truth 1 to 2 cm."""

HALF_PX = 10
"""Half the window of the surrounding surface."""

FACET = ConjugateParams(half_px=8, threshold=0.6, ambiguity=1.0, sigma_floor_px=0.25)
"""How a tie is refined. Its position is known, so it need not be unique. Stops see the ground from
different sides: compared with truth, least-squares matching is accurate to a quarter of a common
cell."""

FACET_REACH = 3
"""Cells to each side: three times the 0.4 cells of a patch and the remaining error of the pose."""

MEASURED_AGAIN = ("left", "parallax_px", "sigma_px", "sigma_line_px", "sigma_parallax_px")
"""Number of values of a second measurement."""


FIRST_SIGMA_PX = 0.1
"""The centre of a patch defines the tie; the only error is resampling."""


BLUR_CELLS = 0.7
"""Smooths both to the resolution of the coarser one."""


@dataclass(frozen=True, slots=True)
class GroundMatchingParams:
    """How patches of ground are matched and their parallaxes measured."""

    half_cells: HalfWindow = 8
    """Half a patch: 17 x 17 cells are 1.4 m of ground at 10 m, and enough to be unique."""
    patches: ConjugateParams = field(
        default_factory=lambda: ConjugateParams(threshold=0.6, ambiguity=0.85, sigma_floor_px=0.4)
    )
    """Views of the ground from far apart correlate less than the two images of a pair; uniqueness
    within the window and agreement in space compensate for it. Compared with truth a patch is
    accurate to 0.4 cells, because its relief differs slightly from the surface."""
    parallax: ConjugateParams = field(
        default_factory=lambda: ConjugateParams(parallax_floor_px=0.1)
    )
    """How the parallax of a tie is measured in its pairs; compared with truth 0.07 px on rendered
    soil, 0.1-0.2 px on real one of good texture (NTB NPO-42487)."""

    def __post_init__(self) -> None:
        if self.half_cells < 3:  # noqa: PLR2004
            raise MatchingError(
                "patches of ground must have 7 x 7 cells or more, not half_cells = "
                f"{self.half_cells}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class GroundTies:
    """Ties between two stops, with the patch of ground by which each was matched."""

    ties: Ties
    width_m: PerPoint
    by_light_px: Float64[np.ndarray, "n 2 3"]
    """(sample, line, parallax) by which different positions of the sun may displace the first and
    the second measurement: shadows of relief as high as that of the patch."""

    def select(self, rows: Flags) -> GroundTies:
        """The ties of some rows."""
        return GroundTies(self.ties.select(rows), self.width_m[rows], self.by_light_px[rows])

    def swap(self) -> GroundTies:
        """First and second exchanged."""
        return GroundTies(self.ties.swap(), self.width_m, self.by_light_px[:, ::-1])

    def __len__(self) -> int:
        return len(self.ties)


def match_ground(
    forth: Sequence[Plan],
    back: Sequence[Plan],
    params: GroundMatchingParams,
    pair_ids: tuple[str, ...],
    dense_sigma_px: float | None = None,
) -> GroundTies:
    """Ties between two stops; first the earlier's pair, second the later's.

    `forth` searches for points of the earlier stop in the later one, `back` vice versa. The
    parallax is measured by least-squares matching, or, if the standard deviation of the dense one
    is given, interpolated from it.
    """

    def parallax_of(view: TieView, points: ImagePoints) -> tuple[PerPoint, PerPoint]:
        if dense_sigma_px is None:
            return measure_parallax(view, points, params.parallax)
        return look_up_parallax(view, points, dense_sigma_px)

    found = [_match_plan(plan, params, parallax_of, pair_ids) for plan in forth]
    returned = [_match_plan(plan, params, parallax_of, pair_ids).swap() for plan in back]
    return _join([t for t in (*found, *returned) if len(t)], pair_ids)


def _join(ties: Sequence[GroundTies], pair_ids: tuple[str, ...]) -> GroundTies:
    """All ties of several sets."""
    width_m = np.concatenate([np.zeros(0), *(t.width_m for t in ties)])
    by_light_px = np.concatenate([np.zeros((0, 2, 3)), *(t.by_light_px for t in ties)])
    return GroundTies(join_ties([t.ties for t in ties], pair_ids), width_m, by_light_px)


def _match_plan(
    plan: Plan, params: GroundMatchingParams, parallax_of: ParallaxOf, pair_ids: tuple[str, ...]
) -> GroundTies:
    """Search for the candidates of a plan, grouped by window size."""
    classes = np.ceil(plan.reach / WINDOW_STEP).astype(np.int64)
    ties = [
        _match_window_class(
            plan.select(classes == size), int(WINDOW_STEP * size), params, parallax_of, pair_ids
        )
        for size in np.unique(classes)
    ]
    return _join(ties, pair_ids)


def _match_window_class(
    plan: Plan,
    reach: int,
    params: GroundMatchingParams,
    parallax_of: ParallaxOf,
    pair_ids: tuple[str, ...],
) -> GroundTies:
    """Match the ground of a plan's candidates and measure both parallaxes."""
    half, turn = params.half_cells, horizontal_turn(plan.target_from_source)
    cells_there = turn @ plan.cells
    centres = plan.places[:, :2]
    ahead = plan.target_from_source.apply(plan.places)[:, :2]
    wide = half + reach + MARGIN_CELLS
    templates, whole = plan.source.draw_patches(centres, plan.cells, half, half, plan.target.sun)
    searches, there = plan.target.draw_patches(ahead, cells_there, wide, half)
    templates, searches = (_blur(stack, BLUR_CELLS) for stack in (templates, searches))
    found, offset, sigma, _ = match_patches(templates, searches, whole & there, params.patches)
    moved = (cells_there @ offset[:, ::-1, None])[:, :, 0]
    first, _ = plan.source.project(centres[:, 0], centres[:, 1])
    second, _ = plan.target.project(ahead[:, 0] + moved[:, 0], ahead[:, 1] + moved[:, 1])
    found &= in_view(plan.source.view, first, 8) & in_view(plan.target.view, second, 8)
    first, second = first[found], second[found]
    parallax, sigma_parallax = parallax_of(plan.source.view, first)
    parallax_there, sigma_there = parallax_of(plan.target.view, second)
    pixels = plan.target.derivative(ahead[found]) @ cells_there[found]
    sample, line, sigma_there = ground_sigmas(
        plan.target.view, second, parallax_there, sigma_there, pixels * sigma[found, None, None]
    )
    n = int(found.sum())
    source, target = (
        np.full(n, pair_ids.index(v.view.pair.pair_id), np.int32)
        for v in (plan.source, plan.target)
    )
    ties = Ties(
        pair_ids,
        source,
        target,
        first,
        second,
        parallax,
        parallax_there,
        np.full(n, FIRST_SIGMA_PX),
        sample,
        sigma_parallax,
        sigma_there,
        np.full(n, FIRST_SIGMA_PX),
        line,
    )
    width_m = (2 * half + 1) * plan.cell_m[found]
    by_light_px = np.zeros((n, 2, 3))
    by_light_px[:, 1] = _displaced_by_light(plan.select(found), ahead[found], second, half)
    known = np.isfinite(parallax) & np.isfinite(parallax_there)
    return GroundTies(ties, width_m, by_light_px).select(known)


def _displaced_by_light(
    plan: Plan, ahead: Float64[np.ndarray, "n 2"], points: ImagePoints, half: int
) -> Float64[np.ndarray, "n 3"]:
    """(sample, line, parallax) displacement of shadows of relief like that of the patches.

    `ahead` are the points in the level frame of the target, `points` their images.
    """
    if plan.source.sun is None or plan.target.sun is None:
        return np.zeros((len(points), 3))
    height_m = plan.source.relief_m(plan.places[:, :2], plan.cells, half)
    shift_m = height_m[:, None] * shadow_difference(plan.source.sun, plan.target.sun)
    moved = (plan.target.derivative(ahead) @ shift_m[:, :, None])[:, :, 0]
    slope = np.nan_to_num(parallax_planes(plan.target.view.pair.parallax, points, HALF_PX).gradient)
    return np.nan_to_num(np.column_stack([moved, (slope * moved).sum(axis=1)]))


def _blur(stack: Float32[np.ndarray, "n a a"], sigma: float) -> Float32[np.ndarray, "n a a"]:
    """Smooth every patch by a Gaussian."""
    for patch in stack:
        cv2.GaussianBlur(patch, (0, 0), sigma, dst=patch)
    return stack


def look_up_parallax(
    view: TieView, points: ImagePoints, sigma_px: float
) -> tuple[PerPoint, PerPoint]:
    """(parallax, its standard deviation) at left image points, from dense matching."""
    lines, samples = view.pair.parallax.shape
    col = np.clip(np.round(points[:, 0]), 0, samples - 1).astype(np.int64)
    row = np.clip(np.round(points[:, 1]), 0, lines - 1).astype(np.int64)
    parallax = view.pair.parallax[row, col].astype(np.float64)
    parallax[parallax <= 0] = np.nan
    return parallax, np.where(np.isfinite(parallax), sigma_px, np.nan)


def ground_sigmas(
    view: TieView,
    points: ImagePoints,
    parallax_px: PerPoint,
    sigma_parallax_px: PerPoint,
    spread: Float64[np.ndarray, "n 2 2"],
) -> tuple[PerPoint, PerPoint, PerPoint]:
    """Standard deviations of (sample, line, parallax) of points matched on the ground, pixels.

    `spread` is S, `sigma_parallax_px` that of the parallax measured at the matched point.
    """
    slope = np.nan_to_num(parallax_planes(view.pair.parallax, points, HALF_PX).gradient)
    along = (slope[:, None] @ spread)[:, 0]
    relief = RELIEF_M * parallax_px / view.geometry.base_m
    sample, line = (np.hypot(np.linalg.norm(spread[:, k], axis=1), relief) for k in (0, 1))
    return sample, line, np.hypot(sigma_parallax_px, np.linalg.norm(along, axis=1))


def refine_ties(
    ties: Ties,
    views: Mapping[str, TieView],
    alignment: Alignment,
    parallax: ConjugateParams,
) -> Ties:
    """The ties, with position and parallax measured again where they are found again."""
    columns = {name: getattr(ties, f"second_{name}").copy() for name in MEASURED_AGAIN}
    for a, b in sorted({*zip(ties.first.tolist(), ties.second.tolist(), strict=True)}):
        rows = np.flatnonzero((ties.first == a) & (ties.second == b)).astype(np.int32)
        source, target = views[ties.pair_ids[a]], views[ties.pair_ids[b]]
        target_from_source = _between(source, target, alignment)
        maps = _maps(ties, rows, source, target, target_from_source, FACET.half_px)
        found = find_conjugates(
            source.left, target.left, ties.first_left[rows], maps, FACET_REACH, FACET
        )
        there = rows[found.found]
        points, spread = found.points[found.found], found.spread[found.found]
        measured, of_parallax = measure_parallax(target, points, parallax)
        good = np.isfinite(measured)
        sample, line, of_parallax = ground_sigmas(target, points, measured, of_parallax, spread)
        again = (points, measured, sample, line, of_parallax)
        for name, column in zip(MEASURED_AGAIN, again, strict=True):
            columns[name][there[good]] = column[good]
    return replace(ties, **{f"second_{name}": column for name, column in columns.items()})


def _between(source: TieView, target: TieView, alignment: Alignment) -> Pose:
    """target_from_source with the pose and the pointing of the alignment."""
    first, second = (corrected_pose(view, alignment) for view in (source, target))
    return second.inverse @ alignment.first_from_second.inverse @ first


def corrected_pose(view: TieView, alignment: Alignment) -> Pose:
    """rover_from_pair with its corrected pointing."""
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
    """Maps over the facet of every tie, shifted to map the first point to the second one."""
    points = ties.first_left[rows]
    planes = parallax_planes(source.pair.parallax, points, half_px)
    planes = ParallaxPlanes(ties.first_parallax_px[rows], planes.gradient, planes.residual_px)
    maps = plane_homographies(source.geometry, target.geometry, target_from_source, points, planes)
    at, _ = map_points(maps, points)
    moves = np.tile(np.eye(3), (len(rows), 1, 1))
    moves[:, :2, 2] = ties.second_left[rows] - at
    return moves @ maps
