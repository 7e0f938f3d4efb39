"""Matches candidates on the ground: from plans to ties.

Around a candidate both pairs are drawn as orthophotos over the surfaces of their own stops
(`ground_patches`), and matched on the ground (`conjugates`). The centre of the patch and its
conjugate are then image points of both pairs, where the parallax is measured (`tie_views`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Flags, Float32, ImagePoints, PerPoint
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.conjugates import (
    ConjugateParams,
    TieView,
    in_view,
    match_patches,
    measured_parallax,
)
from solmap.photogrammetry.matching.cross_site_candidates import Plan, horizontal_turn
from solmap.photogrammetry.matching.ground_spread import spread_on_the_ground
from solmap.photogrammetry.matching.records import Ties, joined

WINDOW_STEP = 8
"""Windows grow in steps of so many cells: patches of one size are drawn together."""
MARGIN_CELLS = 3
"""Search patches are wider by so much, for refinement to move in."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundTies:
    """Ties between two stops, and how wide the patch of ground is that each was matched by."""

    ties: Ties
    width_m: PerPoint

    def taking(self, rows: Flags) -> GroundTies:
        """The ties of some rows."""
        return GroundTies(self.ties.taking(rows), self.width_m[rows])

    def swapped(self) -> GroundTies:
        """First and second exchanged."""
        return GroundTies(self.ties.swapped(), self.width_m)

    def __len__(self) -> int:
        return len(self.ties)


@dataclass(frozen=True, slots=True)
class GroundMatchingParams:
    """How patches of ground are matched and their parallaxes measured."""

    half_cells: int = 8
    """Half a patch: 17 x 17 cells are 1.4 m of ground at 10 m, and enough to be unique."""
    patches: ConjugateParams = field(
        default_factory=lambda: ConjugateParams(threshold=0.6, ambiguity=0.85, sigma_floor_px=0.4)
    )
    """Looks at the ground from far apart correlate less than the eyes of one pair; that a place is
    the only one within the window, and fits the others in space, has to make up for it. Against
    truth a patch is good to 0.4 cells, for its relief is not quite that of the surface."""
    first_sigma_px: float = 0.1
    """The centre of a patch is a point by definition; what is left is resampling."""
    blur_cells: float = 0.7
    """Takes from both what only one of them resolves."""
    parallax: ConjugateParams = field(
        default_factory=lambda: ConjugateParams(parallax_floor_px=0.1)
    )
    """How the parallax of a tie is measured in its pairs; against truth 0.07 px on rendered soil,
    0.1-0.2 px on real one of good texture (NTB NPO-42487)."""

    def __post_init__(self) -> None:
        if self.half_cells < 3:  # noqa: PLR2004
            raise MatchingError(
                f"patches of ground are 7 x 7 cells or more, not half_cells = {self.half_cells}"
            )


ParallaxOf = Callable[[TieView, ImagePoints], tuple[PerPoint, PerPoint]]
"""(parallax, standard deviation) at left image points of a pair; NaN where there is none."""


def match_ground(
    forth: Sequence[Plan],
    back: Sequence[Plan],
    params: GroundMatchingParams,
    pair_ids: tuple[str, ...],
    dense_sigma_px: float | None = None,
) -> GroundTies:
    """Ties between two stops; first the earlier's pair, second the later's.

    `forth` looks for ground of the earlier stop in the later one, `back` the other way round. The
    parallax is measured by least-squares matching, or, if the standard deviation of the dense one
    is given, looked up.
    """

    def parallax_of(view: TieView, points: ImagePoints) -> tuple[PerPoint, PerPoint]:
        if dense_sigma_px is None:
            return measured_parallax(view, points, params.parallax)
        return dense_parallax(view, points, dense_sigma_px)

    found = [_carried_out(plan, params, parallax_of, pair_ids) for plan in forth]
    returned = [_carried_out(plan, params, parallax_of, pair_ids).swapped() for plan in back]
    return _joined([t for t in (*found, *returned) if len(t)], pair_ids)


def _joined(ties: Sequence[GroundTies], pair_ids: tuple[str, ...]) -> GroundTies:
    """All ties of several sets."""
    width_m = np.concatenate([t.width_m for t in ties]) if ties else np.zeros(0)
    return GroundTies(joined([t.ties for t in ties], pair_ids), width_m)


def _carried_out(
    plan: Plan, params: GroundMatchingParams, parallax_of: ParallaxOf, pair_ids: tuple[str, ...]
) -> GroundTies:
    """Look for the candidates of a plan, those with windows of like size together."""
    classes = np.ceil(plan.reach / WINDOW_STEP).astype(np.int64)
    ties = [
        _looked_for(
            plan.taking(classes == size), int(WINDOW_STEP * size), params, parallax_of, pair_ids
        )
        for size in np.unique(classes)
    ]
    return _joined(ties, pair_ids)


def _looked_for(
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
    templates, whole = plan.source.patches(centres, plan.cells, half, half)
    searches, there = plan.target.patches(ahead, cells_there, wide, half)
    templates, searches = (_blurred(stack, params.blur_cells) for stack in (templates, searches))
    found, offset, sigma, _ = match_patches(templates, searches, whole & there, params.patches)
    moved = (cells_there @ offset[:, ::-1, None])[:, :, 0]
    first, _ = plan.source.image_of(centres[:, 0], centres[:, 1])
    second, _ = plan.target.image_of(ahead[:, 0] + moved[:, 0], ahead[:, 1] + moved[:, 1])
    found &= in_view(plan.source.view, first, 8) & in_view(plan.target.view, second, 8)
    first, second = first[found], second[found]
    parallax, sigma_parallax = parallax_of(plan.source.view, first)
    parallax_there, sigma_there = parallax_of(plan.target.view, second)
    pixels = plan.target.derivative(ahead[found]) @ cells_there[found]
    sample, line, sigma_there = spread_on_the_ground(
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
        np.full(n, params.first_sigma_px),
        sample,
        sigma_parallax,
        sigma_there,
        np.full(n, params.first_sigma_px),
        line,
    )
    width_m = (2 * half + 1) * plan.cell_m[found]
    return GroundTies(ties, width_m).taking(np.isfinite(parallax) & np.isfinite(parallax_there))


def _blurred(stack: Float32[np.ndarray, "n a a"], sigma: float) -> Float32[np.ndarray, "n a a"]:
    """Every patch through a Gaussian."""
    for patch in stack:
        cv2.GaussianBlur(patch, (0, 0), sigma, dst=patch)
    return stack


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
