"""From ties between two pairs to the tie points of a network.

Ties that share a measurement show the same feature: measurements of one pair closer than half a
pixel are merged, ties and measurements are joined by union-find, and every connected set is a tie
point. A set with two different measurements of one pair contains a wrong tie; it cannot be decided
which, so the whole set is dropped.

Ties between pairs determine the geometry of the network and are all kept. Points seen in only one
pair do not constrain its pose, because the baseline is fixed; they are thinned to the most certain
one in every cell of a grid (Di et al. 2008, section 3.1: selection by gridding; about 300 a stop).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from solmap.photogrammetry.arrays import Flags, ImagePoints, Int32, PerPoint
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.imagery import StereoMatches, TiePoints
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.ranges import Pixels, WholePixels

MEASURED = ("parallax_px", "sigma_px", "sigma_parallax_px", "sigma_line_px")
"""Columns of a tie for each of its pairs, and tie points for every observation."""


@dataclass(frozen=True, slots=True)
class TrackParams:
    """How tie points are assembled."""

    same_px: Pixels = 0.5
    """Measurements of one pair closer than this are of one feature."""
    intra_cell_px: WholePixels = 160
    """One intra-stereo point is kept in every cell: about 40 per pair, 300 and more per
    panorama."""

    def __post_init__(self) -> None:
        if not (self.same_px > 0 and self.intra_cell_px > 0):
            raise MatchingError("tie points need a merging distance and a cell above zero")


@dataclass(frozen=True, slots=True, eq=False)
class _Measurements:
    """All measurements of ties, two per tie."""

    pair: Int32[np.ndarray, " n"]
    left: ImagePoints
    surface_matched: Flags
    parallax_px: PerPoint
    sigma_px: PerPoint
    sigma_parallax_px: PerPoint
    sigma_line_px: PerPoint


def build_tie_points(
    matches: Sequence[StereoMatches], ties: Sequence[Ties], params: TrackParams
) -> TiePoints:
    """Tie points of a network of pairs, from their own matches and the ties between them.

    `matches` lists the pairs of the network; ties with other pairs are ignored.
    """
    pair_ids = tuple(m.pair_id for m in matches)
    if len(set(pair_ids)) < len(pair_ids):
        twice = next(name for name, n in Counter(pair_ids).items() if n > 1)
        raise MatchingError(f"{twice} is listed twice among the pairs of a network")
    measured = _measurements(ties, pair_ids)
    point, keep = _points(measured, params.same_px)
    pair, left, parallax = measured.pair[keep], measured.left[keep], measured.parallax_px[keep]
    sigma, sigma_parallax = measured.sigma_px[keep], measured.sigma_parallax_px[keep]
    sigma_line = measured.sigma_line_px[keep]
    first = int(point.max()) + 1 if len(point) else 0
    rows = [_thin(m, left[pair == k], params) for k, m in enumerate(matches)]
    alone = [_select_rows(m, some) for m, some in zip(matches, rows, strict=True)]
    counts = [len(some) for some in rows]
    return TiePoints(
        pair_ids,
        np.concatenate([point, first + np.arange(sum(counts))]).astype(np.int32),
        np.concatenate([pair, np.repeat(np.arange(len(matches)), counts)]).astype(np.int32),
        np.concatenate([left, *(m.left for m in alone)]),
        np.concatenate([parallax, *(m.parallax_px for m in alone)]),
        np.concatenate([sigma, *(m.sigma_px for m in alone)]),
        np.concatenate([sigma_parallax, *(m.sigma_px for m in alone)]),
        np.concatenate([sigma_line, *(m.sigma_px for m in alone)]),
        np.concatenate([measured.surface_matched[keep], np.zeros(sum(counts), dtype=bool)]),
    )


def _select_rows(matches: StereoMatches, rows: np.ndarray) -> StereoMatches:
    """Some rows of a pair's matches."""
    return StereoMatches(
        matches.pair_id, matches.left[rows], matches.parallax_px[rows], matches.sigma_px[rows]
    )


def _measurements(ties: Sequence[Ties], pair_ids: tuple[str, ...]) -> _Measurements:
    """Rows 2k and 2k + 1 are the two measurements of tie k."""
    place = {name: k for k, name in enumerate(pair_ids)}
    pairs: list[np.ndarray] = []
    lefts: list[np.ndarray] = []
    columns: dict[str, list[np.ndarray]] = {name: [] for name in MEASURED}
    surface_matched: list[np.ndarray] = []
    for some in ties:
        index = np.array([place.get(name, -1) for name in some.pair_ids] or [-1])
        pair = np.column_stack([index[some.first], index[some.second]])
        known = (pair >= 0).all(axis=1)
        pairs.append(pair[known].ravel())
        lefts.append(np.stack([some.first_left, some.second_left], axis=1)[known].reshape(-1, 2))
        surface_matched.append(np.repeat(some.surface_matched[known], 2))
        for name, column in columns.items():
            both = [getattr(some, f"first_{name}"), getattr(some, f"second_{name}")]
            column.append(np.column_stack(both)[known].ravel())
    measured = (np.concatenate(columns[name] or [np.zeros(0)]) for name in MEASURED)
    return _Measurements(
        np.concatenate(pairs or [np.zeros(0)]).astype(np.int32),
        np.concatenate(lefts or [np.zeros((0, 2))]),
        np.concatenate(surface_matched or [np.zeros(0, dtype=bool)]),
        *measured,
    )


def _points(
    measured: _Measurements, same_px: float
) -> tuple[Int32[np.ndarray, " k"], Int32[np.ndarray, " k"]]:
    """(tie point, row) of every measurement kept: one for each feature and pair."""
    n = len(measured.pair)
    if not n:
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    apart = 4.0 * np.abs(measured.left).max() + 4.0  # pairs side by side, at a large distance
    places = measured.left + np.column_stack([apart * measured.pair, np.zeros(n)])
    same = cKDTree(places).query_pairs(same_px, output_type="ndarray")
    feature = _connected_sets(n, same)
    two = np.column_stack([feature[0::2], feature[1::2]])
    point = _connected_sets(int(feature.max()) + 1, two)[feature]
    best = np.lexsort((measured.sigma_px, feature))
    rows = best[np.unique(feature[best], return_index=True)[1]]
    twice = Counter(zip(point[rows].tolist(), measured.pair[rows].tolist(), strict=True))
    ambiguous = {p for (p, _), count in twice.items() if count > 1}
    good = ~np.isin(point[rows], list(ambiguous))
    rows = rows[good]
    _, renumbered = np.unique(point[rows], return_inverse=True)
    order = np.lexsort((measured.pair[rows], renumbered))
    return renumbered[order].astype(np.int32), rows[order].astype(np.int32)


def _connected_sets(n: int, links: np.ndarray) -> np.ndarray:
    """A number for the connected set of each of n items."""
    ones = np.ones(len(links), dtype=np.int8)
    return connected_components(coo_matrix((ones, (links[:, 0], links[:, 1])), shape=(n, n)))[1]


def _thin(matches: StereoMatches, taken: ImagePoints, params: TrackParams) -> np.ndarray:
    """Rows of the most certain match of every cell, away from existing points."""
    free = np.ones(len(matches), dtype=bool)
    if len(taken) and len(matches):
        free = cKDTree(taken).query(matches.left)[0] > params.same_px
    rows = np.flatnonzero(free)
    order = rows[np.argsort(matches.sigma_px[rows], kind="stable")]
    cells = np.floor_divide(matches.left[order], params.intra_cell_px).astype(np.int64)
    if not len(cells):
        return order
    return np.sort(order[np.unique(cells, axis=0, return_index=True)[1]])
