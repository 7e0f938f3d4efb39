"""Cross-site conjugates: which ground to look for in which pairs of another stop, and where.

The ground common to both stops is divided into cells; in every cell that sparse match is the
candidate, and that pair of the other stop its target, which resolve the ground best together. A
candidate must be predicted to be visible: the dense parallax of the target at the predicted place
agrees with the predicted one, or something stands before it.

Around the candidate both pairs are drawn as orthophotos over the surfaces of their own stops
(`ground_patches`), and matched on the ground. The window covers what is uncertain of the
prediction: the pose between the stops (`Gap`), and the ranges of both stops. The centre of the
patch and its conjugate are then image points of both pairs, where the parallax is measured anew
(`tie_views`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from photogrammetry.arrays import Flags, Float32, Float64, ImagePoints, ObjectPoints, PerPoint
from photogrammetry.frames import Pose
from photogrammetry.matching.conjugates import ConjugateParams, match_patches
from photogrammetry.matching.ground_patches import GroundView
from photogrammetry.matching.tie_views import in_view, measured_parallax
from photogrammetry.matching.ties import Ties, joined


@dataclass(frozen=True, slots=True)
class Gap:
    """How far the same ground may seem apart from both stops: a standard deviation in metres."""

    across_m: float


@dataclass(frozen=True, slots=True)
class Candidates:
    """How candidates are chosen."""

    cell_m: float = 0.75
    farthest_m: float = 30.0
    most: int = 400
    """In a trial of a hypothesis."""
    most_at_last: int = 800
    """When the hypothesis is settled."""
    half_cells: int = 8
    """Half a patch: 17 x 17 cells are 1.4 m of ground at 10 m, and enough to be unique."""
    footprints: float = 1.5
    """Pixels of the coarser image in a cell along the view: what optics and sampling resolve."""
    finest_cell_m: float = 0.02
    coarsest_cell_m: float = 0.5
    """Two Navcam pixels at 20 m on level ground."""
    widest_window: int = 24
    """Cells of a patch to each side."""
    window_sigmas: float = 2.5
    first_gap: Gap = field(default_factory=lambda: Gap(0.15))
    """After the bird's-eye search: a cell of 0.16 m, and half a degree over some metres."""
    last_gap: Gap = field(default_factory=lambda: Gap(0.05))
    """After a first alignment: its own uncertainty and the pointing of single pairs."""
    parallax_sigma_px: float = 0.3
    """Of the dense parallax, which places the surface a patch is drawn on (NTB NPO-42487: 0.32)."""
    ground: ConjugateParams = field(
        default_factory=lambda: ConjugateParams(threshold=0.6, ambiguity=0.85)
    )
    """Looks at the ground from far apart correlate less than the eyes of one pair; that a place is
    the only one within the window, and fits the others in space, has to make up for it."""
    blur_cells: float = 0.7
    """Takes from both what only one of them resolves."""
    visible_px: float = 2.0
    """Predicted and dense parallax may differ this much, besides what the gap makes of it."""


def tie_candidates(
    earlier: Sequence[GroundView],
    later: Sequence[GroundView],
    earlier_from_later: Pose,
    gap: Gap,
    candidates: Candidates,
    conjugates: ConjugateParams,
) -> Ties:
    """Conjugates with parallax between two stops; first the earlier's pair, second the later's.

    `earlier_from_later` joins the level frames of both stops.
    """
    pair_ids = tuple(v.view.pair.pair_id for v in (*earlier, *later))
    forth = _plans(earlier, later, earlier_from_later.inverse, gap, candidates)
    back = _plans(later, earlier, earlier_from_later, gap, candidates)
    forth, back = _best_of_cells(forth, back, earlier_from_later, candidates)
    found = [_carried_out(plan, candidates, conjugates, pair_ids) for plan in forth]
    returned = [_swapped(_carried_out(plan, candidates, conjugates, pair_ids)) for plan in back]
    return joined([t for t in (*found, *returned) if len(t)], pair_ids)


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """Places seen by a source pair, to be looked for in a target pair."""

    source: GroundView
    target: GroundView
    target_from_source: Pose
    """Between the level frames."""
    places: ObjectPoints
    """In the level frame of the source."""
    cell_m: PerPoint
    reach: PerPoint
    """In cells."""

    def taking(self, rows: Flags) -> _Plan:
        return _Plan(
            self.source,
            self.target,
            self.target_from_source,
            self.places[rows],
            self.cell_m[rows],
            self.reach[rows],
        )


def _plans(
    sources: Sequence[GroundView],
    targets: Sequence[GroundView],
    targets_from_sources: Pose,
    gap: Gap,
    params: Candidates,
) -> list[_Plan]:
    """Every match of every source pair that a target pair should show."""
    every = (_plan(s, t, targets_from_sources, gap, params) for s in sources for t in targets)
    return [plan for plan in every if len(plan.places)]


def _plan(
    source: GroundView, target: GroundView, target_from_source: Pose, gap: Gap, params: Candidates
) -> _Plan:
    """The matches of one pair that another should show, and how far around to look."""
    g, t = source.view.geometry, target.view.geometry
    matches = source.view.pair.matches
    near = matches.parallax_px > g.focal_px * g.base_m / params.farthest_m
    points = g.triangulate(matches.left[near], matches.parallax_px[near])
    places = points @ source.rotation.T + source.origin_m
    seen = (target_from_source.apply(places) - target.origin_m) @ target.rotation
    left, parallax = t.project(seen)
    with np.errstate(invalid="ignore"):
        shown = parallax > t.focal_px * t.base_m / params.farthest_m
    shown &= in_view(target.view, left, 8)
    points, places, seen = points[shown], places[shown], seen[shown]
    left, parallax = left[shown], parallax[shown]
    sigmas = [
        params.parallax_sigma_px * p[:, 2] ** 2 / (v.focal_px * v.base_m)
        for p, v in ((points, g), (seen, t))
    ]
    range_m = np.hypot(*sigmas)
    ahead = target_from_source.apply(places)[:, :2]
    cell_m = np.maximum(source.footprint_m(places[:, :2]), target.footprint_m(ahead))
    cell_m *= params.footprints
    coarse = cell_m > params.coarsest_cell_m
    cell_m = np.clip(cell_m, params.finest_cell_m, params.coarsest_cell_m)
    reach = params.window_sigmas * np.hypot(range_m, gap.across_m) / cell_m + 2.0
    slack = params.window_sigmas * np.hypot(range_m, gap.across_m) * parallax / seen[:, 2]
    visible = _visible(target, left, parallax, slack + params.visible_px)
    plan = _Plan(source, target, target_from_source, places, cell_m, reach)
    return plan.taking((reach <= params.widest_window) & visible & ~coarse)


def _visible(
    target: GroundView, left: ImagePoints, parallax: PerPoint, tolerance_px: PerPoint
) -> Flags:
    """Whether the target's dense parallax at the predicted points is the predicted one."""
    col, row = np.round(left).astype(np.int64).T
    dense = target.view.pair.parallax[row, col].astype(np.float64)
    with np.errstate(invalid="ignore"):
        return np.abs(dense - parallax) <= tolerance_px


def _best_of_cells(
    forth: list[_Plan], back: list[_Plan], earlier_from_later: Pose, params: Candidates
) -> tuple[list[_Plan], list[_Plan]]:
    """Keep the candidate that resolves the ground best in every cell.

    Of more than `most_at_last` the finest, of more than `most` some of those, evenly.
    """
    plans = [*forth, *back]
    if not plans:
        return forth, back
    places = [p.places for p in forth] + [earlier_from_later.apply(p.places) for p in back]
    owner = np.concatenate([np.full(len(p.places), k) for k, p in enumerate(plans)])
    size = np.concatenate([p.cell_m for p in plans])
    cells = np.floor(np.concatenate(places)[:, :2] / params.cell_m).astype(np.int64)
    order = np.argsort(size, kind="stable")
    _, first = np.unique(cells[order], axis=0, return_index=True)
    best = order[np.sort(first)][: params.most_at_last]
    best = best[np.linspace(0, len(best) - 1, min(params.most, len(best))).astype(np.int64)]
    kept = np.zeros(len(owner), dtype=bool)
    kept[best] = True
    taken = [p.taking(kept[owner == k]) for k, p in enumerate(plans)]
    return taken[: len(forth)], taken[len(forth) :]


def _carried_out(
    plan: _Plan, candidates: Candidates, params: ConjugateParams, pair_ids: tuple[str, ...]
) -> Ties:
    """Look for the candidates of a plan, those with windows of like size together."""
    classes = np.ceil(plan.reach / 4).astype(np.int64)
    ties = [
        _looked_for(plan.taking(classes == size), int(4 * size), candidates, params, pair_ids)
        for size in np.unique(classes)
    ]
    return joined(ties, pair_ids)


def _looked_for(
    plan: _Plan,
    reach: int,
    candidates: Candidates,
    params: ConjugateParams,
    pair_ids: tuple[str, ...],
) -> Ties:
    """Match the ground of a plan's candidates and measure both parallaxes."""
    half, turn = candidates.half_cells, _turn(plan.target_from_source)
    centres = plan.places[:, :2]
    ahead = plan.target_from_source.apply(plan.places)[:, :2]
    templates, whole = plan.source.patches(centres, np.eye(2), plan.cell_m, half, half)
    searches, there = plan.target.patches(ahead, turn, plan.cell_m, half + reach + 3, half)
    templates, searches = (
        _blurred(stack, candidates.blur_cells) for stack in (templates, searches)
    )
    found, offset, sigma, _ = match_patches(templates, searches, whole & there, candidates.ground)
    moved = np.column_stack([-offset[:, 1], offset[:, 0]]) @ turn.T * plan.cell_m[:, None]
    first, _ = plan.source.image_of(centres[:, 0], centres[:, 1])
    second, _ = plan.target.image_of(ahead[:, 0] + moved[:, 0], ahead[:, 1] + moved[:, 1])
    found &= in_view(plan.source.view, first, 8) & in_view(plan.target.view, second, 8)
    measured = [
        measured_parallax(v.view, p[found], params)
        for v, p in ((plan.source, first), (plan.target, second))
    ]
    sigma_px = (
        sigma[found]
        * plan.cell_m[found]
        * np.sqrt((plan.target.derivative(ahead[found]) ** 2).sum(axis=(1, 2)) / 2)
    )
    source, target = (
        np.full(int(found.sum()), pair_ids.index(v.view.pair.pair_id), np.int32)
        for v in (plan.source, plan.target)
    )
    ties = Ties(
        pair_ids,
        source,
        target,
        first[found],
        second[found],
        measured[0][0],
        measured[1][0],
        np.full(int(found.sum()), params.sigma_floor_px),
        sigma_px,
        measured[0][1],
        measured[1][1],
    )
    return ties.taking(np.isfinite(ties.first_parallax_px) & np.isfinite(ties.second_parallax_px))


def _blurred(stack: Float32[np.ndarray, "n a a"], sigma: float) -> Float32[np.ndarray, "n a a"]:
    """Every patch through a Gaussian."""
    for patch in stack:
        cv2.GaussianBlur(patch, (0, 0), sigma, dst=patch)
    return stack


def _turn(target_from_source: Pose) -> Float64[np.ndarray, "2 2"]:
    """The horizontal part of the turn between two level frames."""
    azimuth = float(
        np.arctan2(target_from_source.rotation[1, 0], target_from_source.rotation[0, 0])
    )
    return np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])


def _swapped(ties: Ties) -> Ties:
    """First and second exchanged."""
    return Ties(
        ties.pair_ids,
        ties.second,
        ties.first,
        ties.second_left,
        ties.first_left,
        ties.second_parallax_px,
        ties.first_parallax_px,
        ties.second_sigma_px,
        ties.first_sigma_px,
        ties.second_sigma_parallax_px,
        ties.first_sigma_parallax_px,
    )
