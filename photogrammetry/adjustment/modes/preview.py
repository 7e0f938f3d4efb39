"""Preview of the effect of manual tie points on two stops, before anything is saved.

The network of both stops alone is adjusted twice, with the first one held: with the present ties
(`adjust_without_manual_ties`), and from there with the ties that a person adds and drops. The
difference is the effect of the manual ties. Other stops are left out, so the next adjustment of the
whole network moves less. Points seen by one pair only do not constrain poses and are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedStop,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.network import (
    Network,
    PairGeometry,
    StopPrior,
    select,
)
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust
from solmap.photogrammetry.arrays import Flags, Float64, Int32, PerPoint
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId, TiePoints
from solmap.photogrammetry.matching.records import Ties


@dataclass(frozen=True, slots=True, eq=False)
class Veto:
    """Automatic measurements that a person rejects."""

    pair_id: str
    left: Float64[np.ndarray, " 2"] | None
    """Area in the left epipolar image; None: all of it."""
    other: str
    """Pair that must see the points too; empty: any."""
    tolerance_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """Two stops with and without manual tie points."""

    before: AdjustedStop
    """The second stop, with the present ties."""
    after: AdjustedStop
    report_before: AdjustmentReport
    report: AdjustmentReport
    residuals_px: Float64[np.ndarray, "n 2 3"]
    """Residuals of each manual tie point, in both pairs: sample, line, parallax; NaN where not
    measured."""
    standardised: Float64[np.ndarray, "n 2 3"]
    status: Int32[np.ndarray, "n 2"]
    vetoed: int
    """Observations dropped."""


def part_of(
    network: AdjustedNetwork,
    priors: Mapping[StopId, StopPrior],
    geometries: Mapping[str, EpipolarPair],
) -> Network:
    """The network of some stops out of an adjusted one; pairs without geometry stay out."""
    pairs = tuple(
        PairGeometry(pair.pair_id, pair.stop, geometries[pair.pair_id])
        for pair in network.pairs
        if pair.stop in priors and pair.pair_id in geometries
    )
    names = {pair.pair_id for pair in pairs}
    seen = network.ties.observations
    inside = np.array([name in names for name in seen.pair_ids], dtype=bool)
    rows = inside[seen.pair] if len(seen) else np.zeros(0, dtype=bool)
    rows[rows] = np.bincount(seen.point[rows])[seen.point[rows]] > 1
    order = tuple(priors[stop.stop] for stop in network.stops if stop.stop in priors)
    return Network(order, pairs, select(seen, rows))


def adjust_without_manual_ties(
    network: Network, start: AdjustedNetwork, params: AdjustmentParams
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust the second stop of a network of two with the present ties, the first one held.

    Raises:
        AdjustmentError: the network is not of two stops.
    """
    if len(network.stops) != 2:  # noqa: PLR2004 - the title
        raise AdjustmentError(
            f"a preview needs a network of exactly two stops, not of {len(network.stops)}"
        )
    held, params = {network.stop_ids[0]}, replace(params, sigma_freedoms=math.inf)
    return adjust(network, held, params, start, "without manual tie points")


def preview_manual_ties(
    network: Network,
    standing: tuple[AdjustedNetwork, AdjustmentReport],
    manual: Ties,
    vetoes: Sequence[Veto],
    params: AdjustmentParams,
) -> Preview:
    """Adjust the second stop with manual tie points, starting from its pose without them."""
    held, free = network.stop_ids
    kept = _not_vetoed(network.ties, vetoes)
    ties = with_ties(select(network.ties, kept), manual)
    with_manual = Network(network.stops, network.pairs, ties)
    before, report_before = standing
    params = replace(params, sigma_freedoms=math.inf)
    after, report = adjust(with_manual, {held}, params, before, "with manual tie points")
    n = 2 * len(manual)
    rows = slice(len(after.ties.status) - n, None)
    return Preview(
        before.stop(free),
        after.stop(free),
        report_before,
        report,
        after.ties.residuals_px[rows].reshape(-1, 2, 3),
        after.ties.standardised[rows].reshape(-1, 2, 3),
        after.ties.status[rows].reshape(-1, 2),
        int((~kept).sum()),
    )


def with_ties(points: TiePoints, manual: Ties) -> TiePoints:
    """Tie points with the manual ones appended: two observations each."""
    names = tuple(dict.fromkeys((*points.pair_ids, *manual.pair_ids)))
    number = np.array([names.index(name) for name in manual.pair_ids] or [0], dtype=np.int32)
    first = int(points.point.max(initial=-1)) + 1
    pair = np.column_stack([number[manual.first], number[manual.second]]).ravel()

    def column(name: str) -> PerPoint:
        sides = [getattr(manual, f"{side}_{name}") for side in ("first", "second")]
        return np.concatenate([getattr(points, name), np.column_stack(sides).ravel()])

    left = np.stack([manual.first_left, manual.second_left], axis=1).reshape(-1, 2)
    return TiePoints(
        names,
        np.concatenate([points.point, first + np.repeat(np.arange(len(manual)), 2)]).astype(
            np.int32
        ),
        np.concatenate([points.pair, pair]).astype(np.int32),
        np.concatenate([points.left, left]),
        column("parallax_px"),
        column("sigma_px"),
        column("sigma_parallax_px"),
        column("sigma_line_px"),
        np.concatenate([points.surface_matched, np.repeat(manual.surface_matched, 2)]),
    )


def _not_vetoed(ties: TiePoints, vetoes: Sequence[Veto]) -> Flags:
    """The observations that no veto excludes."""
    kept = np.ones(len(ties), dtype=bool)
    names = np.array(ties.pair_ids, dtype=object)[ties.pair] if len(ties) else np.zeros(0, object)
    for veto in vetoes:
        meant = names == veto.pair_id
        if veto.left is not None:
            meant &= np.linalg.norm(ties.left - veto.left, axis=1) <= veto.tolerance_px
        if veto.other:
            meant &= np.isin(ties.point, ties.point[names == veto.other])
        kept &= ~meant
    return kept
