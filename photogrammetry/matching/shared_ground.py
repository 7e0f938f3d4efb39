"""How much of their ground ties share, and what that leaves of their weight.

The error of a patch that was matched is a mean over its ground. Two square patches of widths w_i
and w_j that share the area A_ij therefore have errors that are correlated by about

    R_ij = A_ij / (w_i w_j),

and of n ties with R as their correlation a common shift is known as well as from

    1' R^-1 1  ~  sum_i 1 / k_i,        k_i = sum_j R_ij,

independent ones. Taken for independent they would promise too much, so ties that are handed on lie
apart, and what overlap is left is taken into their standard deviations, as sqrt(k_i).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from photogrammetry.arrays import Flags, Float64, Int32, PerPoint
from photogrammetry.matching.ties import Ties


def counted_as_one(places: Float64[np.ndarray, "n 2"], width_m: PerPoint) -> PerPoint:
    """k_i: how many ties say what one would, for square patches around places of the ground."""
    together = np.zeros(len(places))
    for k, (place, width) in enumerate(zip(places, width_m, strict=True)):
        side = (width_m + width)[:, None] / 2 - np.abs(places - place)
        side = np.clip(side, 0.0, np.minimum(width_m, width)[:, None])
        together[k] = (side.prod(axis=1) / (width_m * width)).sum()
    return together


def weighed_down(ties: Ties, together: PerPoint) -> Ties:
    """Ties with standard deviations sqrt(k) as large."""
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


def spread_out(
    places: Float64[np.ndarray, "n 2"], width_m: PerPoint, apart: float, at_least: int
) -> Flags:
    """Which ties to hand on: each `apart` times its width from all others, the smallest first.

    If that leaves fewer than `at_least`, they may lie as much nearer as it takes.
    """
    order = np.argsort(width_m, kind="stable")
    while True:
        kept = lying_apart(places[order], apart * width_m[order], len(places))
        if len(kept) >= min(at_least, len(places)) or apart < 0.05:  # noqa: PLR2004 - all of them
            break
        apart *= 0.8
    flags = np.zeros(len(places), dtype=bool)
    flags[order[kept]] = True
    return flags


def lying_apart(
    places: Float64[np.ndarray, "n 2"], distance_m: PerPoint, most: int
) -> Int32[np.ndarray, " kept"]:
    """Rows, in the order given, that lie their own distance away from all rows kept before."""
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
