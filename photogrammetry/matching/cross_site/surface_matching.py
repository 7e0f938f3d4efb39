"""Surface-matched cross-site ties, where image matching leaves the bearing weak.

Stops on opposite sides of the same ground see other faces of its stones, under another sun; patches
that look alike are then not quite the same, and the few there are leave a tenth of a degree of
azimuth open. The shape of the ground is one and the same. Once two stops are linked by
image-matched ties, the ground that two of their pairs share is aligned (`surface_alignment`), first
as a whole, then block by block; the blocks become ties.

What the stops see of a block differs along their rays and upwards, by an amount that no number of
points averages out; a surface-matched tie states it in its covariance. So all of its weight is in
the bearing, where blocks are true to millimetres, and ranges and heights are left to the
image-matched ties.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, Int32, ObjectPoints, PerPoint
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.surface_alignment import (
    Ground,
    GroundPair,
    Misfits,
    SurfaceParams,
    SurfaceView,
    robust_weights,
)
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.ranges import Count, Metres
from solmap.photogrammetry.robust import robust_sigma

DEFINED_PX = 0.02
"""A point of the earlier stop is where it is by definition."""


BLOCK_SHARE = 0.06
"""Least side of a block as a share of the distance of the stops: far away there are fewer pixels to
a metre."""


@dataclass(frozen=True, slots=True)
class SurfaceTieParams:
    """Which blocks of ground become ties."""

    enabled: bool = True
    surface: SurfaceParams = field(default_factory=SurfaceParams)
    block_m: Metres = 1.0
    """Side of a block, and at least"""
    least_points: Count = 30
    largest_sigma_m: Metres = 0.06
    """Across the rays: blocks without relief know no better and are left out."""
    least: Count = 8
    """With fewer blocks there are no surface-matched ties."""
    most: Count = 80
    """Blocks that become ties, the most certain."""

    def __post_init__(self) -> None:
        if not (self.block_m > 0 and self.least_points > 0 and self.most >= self.least > 0):
            raise MatchingError(
                "surface-matched ties need blocks above zero in size, points and number"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks of ground that a pair of either stop has seen, n of them, each laid on its own."""

    number: Int32[np.ndarray, " n"]
    """By which a block is known among all pairs."""
    point: Int32[np.ndarray, " n"]
    """The point of the earlier stop's ground in its middle."""
    shift_m: ObjectPoints
    """What lays the later stop's ground onto the earlier one's, common frame."""
    covariance: Float64[np.ndarray, "n 3 3"]
    """Of the shift."""
    shape_bias: Float64[np.ndarray, "n 3 3"]
    """Covariance of how far apart what the stops see of the block is, which blocks share."""
    across_m: PerPoint
    """Shift across the rays, from where all the ground of both pairs was laid."""
    sigma_m: PerPoint
    """Its standard deviation."""

    def __len__(self) -> int:
        return len(self.number)

    def select(self, rows: np.ndarray) -> Blocks:
        """Some of them."""
        return Blocks(*(getattr(self, column.name)[rows] for column in fields(self)))

    def inflate(self, factor: float) -> Blocks:
        """The same where blocks differ by so much more than they state."""
        return replace(self, covariance=factor**2 * self.covariance, sigma_m=factor * self.sigma_m)


def tie_by_surface(
    earlier: Mapping[str, SurfaceView], later: Mapping[str, SurfaceView], params: SurfaceTieParams
) -> Ties:
    """Surface-matched ties between the pairs of two stops.

    All views stand in one frame, level, north first; image-matched ties have placed the stops to
    some centimetres and tenths of a degree. None where there is little relief.
    """
    pair_ids = (*earlier, *later)
    seen = list(_shared_ground(earlier, later, params))
    blocks = [blocks for *_, blocks in seen]
    if not blocks:
        return Ties.none(pair_ids)
    across, sigma, number = (
        np.concatenate([getattr(some, name) for some in blocks])
        for name in ("across_m", "sigma_m", "number")
    )
    kept = _most_certain(number, sigma, params)
    if kept.sum() < params.least:
        return Ties.none(pair_ids)
    scatter = max(robust_sigma(across[kept] / sigma[kept]), 1.0)
    mine = np.split(kept, np.cumsum([len(some) for some in blocks])[:-1])
    columns = [
        _tie_columns(couple, some.select(rows).inflate(scatter), int(kept.sum()), params.surface)
        for (*_, couple, some), rows in zip(seen, mine, strict=True)
    ]
    first, second = (
        np.repeat([pair_ids.index(names[k]) for names in seen], [rows.sum() for rows in mine])
        for k in (0, 1)
    )
    ties = Ties(
        pair_ids,
        first.astype(np.int32),
        second.astype(np.int32),
        *(np.concatenate(column) for column in zip(*columns, strict=True)),
    )
    return replace(ties, by_shape=np.ones(len(ties), dtype=bool))


def _shared_ground(
    earlier: Mapping[str, SurfaceView], later: Mapping[str, SurfaceView], params: SurfaceTieParams
) -> Iterator[tuple[str, str, GroundPair, Blocks]]:
    """Every two pairs that share ground, with its blocks."""
    here, there = (np.mean([v.centre for v in some.values()], axis=0) for some in (earlier, later))
    ones = {name: Ground.of(view, there, params.surface) for name, view in earlier.items()}
    others = {name: Ground.of(view, here, params.surface) for name, view in later.items()}
    side_m = max(params.block_m, BLOCK_SHARE * float(np.linalg.norm(there - here)))
    for one, ground in ones.items():
        for other, its_ground in others.items():
            couple = GroundPair.of(ground, its_ground, params.surface)
            if couple is not None:
                yield one, other, couple, align_blocks(couple, side_m, params)


def align_blocks(couple: GroundPair, side_m: float, params: SurfaceTieParams) -> Blocks:
    """The blocks of the ground that two pairs share: squares of some side, each laid on its own."""
    laid = couple.shifts_by(couple.align(params.surface))
    names = [
        _squares(ground.places + shift, side_m)
        for ground, shift in zip(couple.grounds, laid, strict=True)
    ]
    number, place = np.unique(np.concatenate(names), return_inverse=True)
    place = place.ravel().astype(np.int32)
    block = np.split(place, [len(names[0])])
    middle = _middles(np.concatenate([g.places for g in couple.grounds]), place, len(number))
    prior, shift = couple.prior(middle, params.surface), np.zeros((len(number), 3))
    for _ in range(params.surface.rounds):
        shifts = (laid[0] + shift[block[0]], laid[1] + shift[block[1]])
        seen = couple.misfits(shifts, params.surface)
        misfit, by_shift, weight = robust_weights(seen, params.surface)
        of = np.concatenate([b[m.row] for b, m in zip(block, seen, strict=True)])
        weighted = weight[:, None] * by_shift
        normal = prior.copy()
        np.add.at(normal, of, weighted[:, :, None] * by_shift[:, None, :])
        right = -(prior @ shift[:, :, None])[:, :, 0]
        np.add.at(right, of, -weighted * misfit[:, None])
        shift = shift + np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    covariance, across = np.linalg.inv(normal), couple.across
    sigma = np.sqrt(np.einsum("i,nij,j->n", across, covariance, across))
    point = _middle_points(couple.earlier, seen[0], block[0], len(number))
    good = np.bincount(of, minlength=len(number)) >= params.least_points
    good &= (sigma < params.largest_sigma_m) & (point >= 0)
    found = Blocks(
        number.astype(np.int32),
        point,
        laid[0][point] + shift,
        covariance,
        couple.shape_bias(middle, params.surface),
        shift @ across,
        sigma,
    )
    return found.select(good)


def _squares(places: ObjectPoints, side_m: float) -> Int32[np.ndarray, " n"]:
    """A number for the square of level ground in which every place lies."""
    row, col = np.floor(places[:, :2] / side_m).astype(np.int32).T
    return row * 10_000 + col


def _middles(
    places: ObjectPoints, block: Int32[np.ndarray, " n"], blocks: int
) -> Float64[np.ndarray, "blocks 3"]:
    """The middle of the places in every block; the origin for blocks without any."""
    count = np.maximum(np.bincount(block, minlength=blocks), 1)
    return np.column_stack([np.bincount(block, axis, blocks) / count for axis in places.T])


def _middle_points(
    ground: Ground, seen: Misfits, block: Int32[np.ndarray, " points"], blocks: int
) -> Int32[np.ndarray, " blocks"]:
    """The point seen that is nearest to the middle of those of its block; -1 if there is none."""
    of, places = block[seen.row], ground.places[seen.row]
    middle = _middles(places, of, blocks)
    order = np.lexsort((np.linalg.norm(places - middle[of], axis=1), of))
    found, first = np.unique(of[order], return_index=True)
    nearest = np.full(blocks, -1, dtype=np.int32)
    nearest[found] = seen.row[order[first]]
    return nearest


def _most_certain(
    number: Int32[np.ndarray, " n"], sigma: PerPoint, params: SurfaceTieParams
) -> Flags:
    """Every block once, by the pairs most certain of it; and the most certain of all blocks."""
    order = np.argsort(sigma, kind="stable")
    _, first = np.unique(number[order], return_index=True)
    kept = np.zeros(len(number), dtype=bool)
    kept[order[np.sort(first)[: params.most]]] = True
    return kept


def _tie_columns(
    couple: GroundPair, blocks: Blocks, count: int, params: SurfaceParams
) -> tuple[np.ndarray, ...]:
    """Ties in the middle of blocks, column by column as `Ties` has them.

    What all `count` ties of a link share is as uncertain in their mean as it is in each
    (`tie_weights`): how far apart the shapes are, and with it range and height, which the
    image-matched ties fix.
    """
    view, target = couple.earlier.view, couple.later.view
    first = couple.earlier.points[blocks.point]
    parallax = view.at(first).parallax_px
    there = (view.place(first, parallax) - blocks.shift_m - target.centre) @ target.rotation
    second, second_parallax = target.geometry.project(there)
    by_place = target.by_place(there)
    own, bias, told = (
        np.diagonal(by_place @ covariance @ by_place.mT, axis1=1, axis2=2)
        for covariance in (
            blocks.covariance,
            blocks.shape_bias,
            params.shift_sigma_m**2 * np.eye(3),
        )
    )
    sample, line, along = np.sqrt(own + count * (bias + told * (0.0, 1.0, 1.0))).T
    defined = np.full(len(blocks), DEFINED_PX)
    of_parallax = np.full(len(blocks), params.sigma_parallax_px)
    return (
        first,
        second,
        parallax,
        second_parallax,
        defined,
        sample,
        of_parallax,
        along,
        defined,
        line,
    )
