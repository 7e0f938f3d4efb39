"""Cross-site candidates: points to search for in the pairs of another stop.

Every sparse match of a pair that should be visible in a pair of the other stop is a candidate. Of
several candidates on the same ground, the match and target pair with the best common resolution are
taken; the next candidate is a fraction of a patch away, so that ties are nearly independent. A
candidate must be predicted to be visible: if the dense parallax of the target at the predicted
point differs from the predicted one, the ground is occluded there.

The search window covers the uncertainty of the prediction: the pose between the stops, and the
ranges at both stops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, ImagePoints, ObjectPoints, PerPoint
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.conjugates import in_view
from solmap.photogrammetry.matching.cross_site.ground_views import (
    GroundView,
    common_cells,
    limit_resolution,
)
from solmap.photogrammetry.matching.cross_site.tie_weights import select_apart
from solmap.photogrammetry.ranges import CellSize, Count, Metres, Pixels

APART_CELLS = 5.0
"""Least distance of two candidates in cells of their patches, a third of a patch: with more ground
in common a tie adds little information."""


FOOTPRINTS = 1.5
"""Size of a cell in pixels of the coarser image, by the resolution of optics and sampling."""


FINEST_CELL_M = 0.05
"""Lower limit of the cell size: the surface has no finer detail (its cells are 0.08 m)."""


COARSEST_CELL_M = 1.0
"""Largest length of a cell: two Navcam pixels at 30 m on level ground."""


WIDEST_WINDOW = 24
"""Largest search distance to each side, in cells of a patch."""


WINDOW_SIGMAS = 2.5
"""Half width of a search window, in standard deviations of the prediction."""


VISIBLE_PX = 2.0
"""Largest difference of predicted and dense parallax, besides that by the uncertain pose."""


FIRST_GAP_M = 0.15
"""Standard deviation between the positions of the same ground at both stops after the bird's-eye
search: a cell of 0.16 m, and half a degree over some metres."""


LAST_GAP_M = 0.05
"""Search radius after a first alignment: its uncertainty and the pointing errors of pairs."""


@dataclass(frozen=True, slots=True)
class CandidateParams:
    """Selection of candidates."""

    cell_m: CellSize = 0.75
    """Side of the ground cells that contain one candidate each at most."""
    farthest_m: Metres = 30.0
    """Farthest ground from either camera."""
    most: Count = 120
    """Most candidates while a hypothesis is tested."""
    most_at_last: Count = 300
    """Most candidates of the final search for a hypothesis."""
    square_m: Metres = 0.2
    """Cells are square up to this length; longer ones are narrower, of the same area, as far as
    both images resolve it. Stops far apart see the ground between them along one line, with finer
    resolution across it; but narrow patches are less unique, so only where necessary."""
    parallax_sigma_px: Pixels = 0.3
    """Standard deviation of the dense parallax that defines a patch's surface (NTB NPO-42487:
    0.32)."""

    def __post_init__(self) -> None:
        if not self.cell_m > 0:
            raise MatchingError(f"candidates need a cell above zero, not {self.cell_m} m")


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Points of a source pair to be searched for in a target pair."""

    source: GroundView
    target: GroundView
    target_from_source: Pose
    """Motion between the level frames."""
    places: ObjectPoints
    """Positions in the level frame of the source."""
    cells: Float64[np.ndarray, "n 2 2"]
    """G of the patch around every point, metres in the level axes of the source."""
    reach: PerPoint
    """Search radius in cells."""

    @property
    def cell_m(self) -> PerPoint:
        """Width of a square cell as large as those of the patches."""
        return np.sqrt(np.abs(np.linalg.det(self.cells)))

    def select(self, rows: Flags) -> Plan:
        """The plan for some of its points."""
        return Plan(
            self.source,
            self.target,
            self.target_from_source,
            self.places[rows],
            self.cells[rows],
            self.reach[rows],
        )


def plan_searches(
    earlier: Sequence[GroundView],
    later: Sequence[GroundView],
    earlier_from_later: Pose,
    gap_m: float,
    params: CandidateParams,
) -> tuple[list[Plan], list[Plan]]:
    """Search plans: matches of the earlier stop in the later one, and vice versa."""
    later_from_earlier = earlier_from_later.inverse
    forth = _plans(earlier, later, later_from_earlier, gap_m, params)
    back = _plans(later, earlier, earlier_from_later, gap_m, params)
    return _best_of_the_ground(forth, back, earlier_from_later, params)


def _plans(
    sources: Sequence[GroundView],
    targets: Sequence[GroundView],
    targets_from_sources: Pose,
    gap_m: float,
    params: CandidateParams,
) -> list[Plan]:
    """Every match of every source pair that should be visible in a target pair."""
    every = (_plan(s, t, targets_from_sources, gap_m, params) for s in sources for t in targets)
    return [plan for plan in every if plan is not None and len(plan.places)]


def _plan(
    source: GroundView,
    target: GroundView,
    target_from_source: Pose,
    gap_m: float,
    params: CandidateParams,
) -> Plan | None:
    """The matches of one pair that another should show, with the search window of each."""
    t, ground = target.view.geometry, source.ground
    ahead = target_from_source.apply(ground.places)
    seen = (ahead - target.origin_m) @ target.rotation
    near = (ground.range_m < params.farthest_m) & (seen[:, 2] < params.farthest_m)
    rows = np.flatnonzero(near & (np.abs(seen[:, 0]) * t.focal_px < seen[:, 2] * t.samples))
    left, parallax = t.project(seen[rows])
    inside = in_view(target.view, left, 8)
    if not inside.any():
        return None
    rows, left, parallax = rows[inside], left[inside], parallax[inside]
    ahead, seen, places, range_m = (
        column[rows] for column in (ahead, seen, ground.places, ground.range_m)
    )
    spread = _spread(source, target, target_from_source, places, (range_m, seen[:, 2]), params)
    spread += gap_m**2 * np.eye(2)
    apart_m = WINDOW_SIGMAS * np.sqrt(np.linalg.eigvalsh(spread)[:, 1])
    shown = _visible(target, left, parallax, apart_m * parallax / seen[:, 2] + VISIBLE_PX)
    cells = np.full((len(places), 2, 2), np.nan)
    turn = horizontal_turn(target_from_source)
    there = turn.T @ target.footprints(ahead[shown, :2]) @ turn
    cells[shown] = FOOTPRINTS * common_cells(
        ground.footprints[rows][shown], there, params.square_m / FOOTPRINTS
    )
    shown &= np.isfinite(cells).all(axis=(1, 2))
    cells, spread = limit_resolution(cells[shown], FINEST_CELL_M), spread[shown]
    back = np.linalg.inv(cells)
    reach = np.linalg.eigvalsh(back @ spread @ np.swapaxes(back, 1, 2))[:, 1]
    plan = Plan(
        source,
        target,
        target_from_source,
        places[shown],
        cells,
        WINDOW_SIGMAS * np.sqrt(reach) + 2.0,
    )
    fine = np.linalg.norm(cells, axis=1).max(axis=1) <= COARSEST_CELL_M
    return plan.select(fine & (plan.reach <= WIDEST_WINDOW))


def _spread(
    source: GroundView,
    target: GroundView,
    target_from_source: Pose,
    places: ObjectPoints,
    range_m: tuple[PerPoint, PerPoint],
    params: CandidateParams,
) -> Float64[np.ndarray, "n 2 2"]:
    """Covariance, by range errors, of the distance between both stops' positions of a point."""
    origin = target_from_source.inverse.apply(target.origin_m[None])[0]
    spread = np.zeros((len(places), 2, 2))
    for view, start, z in ((source, source.origin_m, range_m[0]), (target, origin, range_m[1])):
        g = view.view.geometry
        sigma_m = params.parallax_sigma_px * z**2 / (g.focal_px * g.base_m)
        way = places[:, :2] - start[:2]
        way = way / np.maximum(np.hypot(*way.T), 0.1)[:, None] * sigma_m[:, None]
        spread += way[:, :, None] * way[:, None, :]
    return spread


def horizontal_turn(target_from_source: Pose) -> Float64[np.ndarray, "2 2"]:
    """The horizontal part of the rotation between two level frames."""
    azimuth = float(
        np.arctan2(target_from_source.rotation[1, 0], target_from_source.rotation[0, 0])
    )
    return np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])


def _visible(
    target: GroundView, left: ImagePoints, parallax: PerPoint, tolerance_px: PerPoint
) -> Flags:
    """Whether the target's dense parallax at the predicted points agrees with the predicted one."""
    col, row = np.round(left).astype(np.int64).T
    dense = target.view.pair.parallax[row, col].astype(np.float64)
    with np.errstate(invalid="ignore"):
        return np.abs(dense - parallax) <= tolerance_px


def _best_of_the_ground(
    forth: list[Plan], back: list[Plan], earlier_from_later: Pose, params: CandidateParams
) -> tuple[list[Plan], list[Plan]]:
    """Keep well resolved candidates that are some distance apart; thin them if too many."""
    plans = [*forth, *back]
    if not plans:
        return forth, back
    places = [p.places for p in forth] + [earlier_from_later.apply(p.places) for p in back]
    flat = np.concatenate(places)[:, :2]
    owner = np.repeat(np.arange(len(plans)), [len(p.places) for p in plans])
    size = np.concatenate([p.cell_m for p in plans])
    order = np.argsort(size, kind="stable")
    cells = np.floor(flat[order] / params.cell_m).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    best = order[np.sort(first)]
    best = best[select_apart(flat[best], APART_CELLS * size[best], params.most_at_last)]
    best = best[np.linspace(0, len(best) - 1, min(params.most, len(best))).astype(np.int64)]
    kept = np.zeros(len(owner), dtype=bool)
    kept[best] = True
    taken = [p.select(kept[owner == k]) for k, p in enumerate(plans)]
    return taken[: len(forth)], taken[len(forth) :]
