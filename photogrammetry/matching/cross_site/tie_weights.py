"""Correlation of ties by common ground, and their weights.

The error of a matched patch is a mean over its ground. Two square patches of widths w_i and w_j
that share the area A_ij therefore have errors that are correlated by about

    R_ij = A_ij / (w_i w_j),

and n ties with the correlation matrix R determine a common shift as well as

    1' R^-1 1  ~  sum_i 1 / k_i,        k_i = sum_j R_ij,

independent ones. Treated as independent they would seem too accurate, so returned ties are spaced
apart, and the remaining overlap enlarges their standard deviations by sqrt(k_i).

Three errors are common to all ties of a link, at any spacing. A distant stop sees the tops of
relief that a near one sees from above, so its ground is higher by b. All parallaxes of a pair have
a common error c. Where the suns differ, lit faces and shadows are on other sides of the relief, all
displaced along one direction by a fraction l of the displacement of shadows (`light`). Errors
common to n ties do not average out; adding sqrt(n) b to each gives their mean the right
uncertainty. Light displaces sample, line and parallax together, each counted separately: sqrt(3 n)
l.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, Int32, PerPoint
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.matching.records import Ties

SHARED_HEIGHT_M = 0.006
"""b: ground seen from 14 m and from 8 m differs by 3 to 9 mm in simulated and rendered worlds."""
SHARED_PARALLAX_PX = 0.015
"""c: medians of a pair's errors of parallax, simulated and rendered, are 0.013 px (root mean
square) at 10 to 20 m, 0.007 px at 6 to 10 m. With 0.010 the longest links, which compare the
farthest ground, contradicted the others, and the variance component made all uncertain."""

SHARED_LIGHT = 0.4
"""l: ties under suns from opposite sides, at 30 degrees, had 0.5 and 0.2 of it (rendered)."""


def overlap_counts(places: Float64[np.ndarray, "n 2"], width_m: PerPoint) -> PerPoint:
    """k_i: number of ties equivalent to one independent tie, for square patches of ground."""
    together = np.zeros(len(places))
    for k, (place, width) in enumerate(zip(places, width_m, strict=True)):
        side = (width_m + width)[:, None] / 2 - np.abs(places - place)
        side = np.clip(side, 0.0, np.minimum(width_m, width)[:, None])
        together[k] = (side.prod(axis=1) / (width_m * width)).sum()
    return together


def inflate_sigmas(ties: Ties, together: PerPoint) -> Ties:
    """Ties with standard deviations enlarged by sqrt(k)."""
    more = np.sqrt(np.maximum(together, 1.0))
    return replace(
        ties,
        first_sigma_px=ties.first_sigma_px * more,
        second_sigma_px=ties.second_sigma_px * more,
        first_sigma_parallax_px=ties.first_sigma_parallax_px * more,
        second_sigma_parallax_px=ties.second_sigma_parallax_px * more,
        first_sigma_line_px=ties.first_sigma_line_px * more,
        second_sigma_line_px=ties.second_sigma_line_px * more,
    )


def add_shared_errors(
    ties: Ties,
    geometries: Mapping[str, EpipolarPair],
    by_light_px: Float64[np.ndarray, "n 2 3"],
) -> Ties:
    """Ties with the common errors added: height (lines of the further image), parallax, light.

    `by_light_px` are the displacements of shadows in (sample, line, parallax) of both measurements.
    """
    pairs = [[geometries[ties.pair_ids[k]] for k in which] for which in (ties.first, ties.second)]
    own, base_m = (
        [np.array([getattr(pair, name) for pair in some], dtype=np.float64) for some in pairs]
        for name in ("focal_px", "base_m")
    )
    scale = [ties.first_parallax_px / base_m[0], ties.second_parallax_px / base_m[1]]
    second_is_far = scale[1] / own[1] < scale[0] / own[0]
    shared = SHARED_HEIGHT_M * len(ties) ** 0.5
    first = np.hypot(ties.first_sigma_line_px, np.where(second_is_far, 0.0, shared * scale[0]))
    second = np.hypot(ties.second_sigma_line_px, np.where(second_is_far, shared * scale[1], 0.0))
    parallax = SHARED_PARALLAX_PX * len(ties) ** 0.5
    light = SHARED_LIGHT * (3 * len(ties)) ** 0.5 * np.abs(by_light_px)
    return replace(
        ties,
        first_sigma_px=np.hypot(ties.first_sigma_px, light[:, 0, 0]),
        second_sigma_px=np.hypot(ties.second_sigma_px, light[:, 1, 0]),
        first_sigma_line_px=np.hypot(first, light[:, 0, 1]),
        second_sigma_line_px=np.hypot(second, light[:, 1, 1]),
        first_sigma_parallax_px=np.hypot(
            ties.first_sigma_parallax_px, np.hypot(parallax, light[:, 0, 2])
        ),
        second_sigma_parallax_px=np.hypot(
            ties.second_sigma_parallax_px, np.hypot(parallax, light[:, 1, 2])
        ),
    )


def select_spread(
    places: Float64[np.ndarray, "n 2"], width_m: PerPoint, apart: float, at_least: int
) -> Flags:
    """Ties to return: each `apart` times its width from all others, the smallest first.

    If that leaves fewer than `at_least`, the distance is reduced until it does not.
    """
    order = np.argsort(width_m, kind="stable")
    while True:
        kept = select_apart(places[order], apart * width_m[order], len(places))
        if len(kept) >= min(at_least, len(places)) or apart < 0.05:  # noqa: PLR2004 - all of them
            break
        apart *= 0.8
    flags = np.zeros(len(places), dtype=bool)
    flags[order[kept]] = True
    return flags


def select_apart(
    places: Float64[np.ndarray, "n 2"], distance_m: PerPoint, most: int
) -> Int32[np.ndarray, " kept"]:
    """Rows, in the order given, at their own minimum distance from all rows kept before."""
    kept = np.zeros(min(most, len(places)), np.int32)
    there = np.full((len(kept), 2), np.inf)
    n = 0
    for k, (place, least) in enumerate(zip(places, distance_m, strict=True)):
        if n == len(kept):
            break
        if n and (np.abs(there[:n] - place).max(axis=1) < least).any():
            continue
        kept[n], there[n] = k, place
        n += 1
    return kept[:n]
