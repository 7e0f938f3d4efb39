"""How large the test of an observation may be before it counts as a blunder.

T (see `residuals`) is held against s times a gate, s = max(1, robust spread 1.48 median |w| of its
kind, cross-site or not): where matching or a bent bar promised more than it held, every residual is
large, and that is a finding for sigma0 rather than a thousand blunders.

The gate depends on how many blunders there are (Benjamini and Hochberg 1995): it lets good
observations go with probability alpha (`critical_value`), or, among ties of a kind of which a share
of k/n is wrong, with q k/n, so that at most a share q of what is set aside is good. A few blunders
thus cost a mission no ties, and among many the small ones do not hide. That presumes that the
others are as good as stated: where s is above one the gate stays with alpha.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import gammaincc, gammainccinv

from solmap.photogrammetry.adjustment.collinearity import Observations
from solmap.photogrammetry.adjustment.observations import seen_differently
from solmap.photogrammetry.adjustment.params import AdjustmentParams
from solmap.photogrammetry.adjustment.residuals import CERTAIN, Residuals


def gates(
    observations: Observations, found: Residuals, used: np.ndarray, params: AdjustmentParams
) -> np.ndarray:
    """Gate of the test of every observation, by spread and blunders of its kind."""
    T, measured = found.test.copy(), (observations.sights.weight > 0).sum(axis=0)
    aside, joining = ~used & observations.is_stereo, _joins_stops(observations)
    loose = _quantile(params.false_share, 3)  # no sign of a blunder whatever their share
    gate = np.full(len(T), np.inf)
    for of_kind in (joining, ~joining):
        tested = of_kind & (found.test > 0)
        spread = found.spread(of_kind)
        T[of_kind] /= spread
        p = np.sort(_chance(T[tested & (loose < T)], 3))
        set_aside = int((aside & of_kind).sum())
        share = _share_of_blunders(p, int(tested.sum()), set_aside, params.false_share)
        if spread > 1.0:  # sigmas or model are not what was stated, and tails tell nothing
            share = 0.0
        for coordinates in (2, 3):
            least = coordinates * float(gammaincc(0.5, params.critical_value**2 / 2))
            alpha = max(least, params.false_share * share)
            gate[of_kind & (measured == coordinates)] = spread * _quantile(alpha, coordinates)
    return gate


def _share_of_blunders(p: np.ndarray, tested: int, aside: int, false_share: float) -> float:
    """How many observations of a kind are wrong for certain, as a share of all.

    `p` are the smallest probabilities of their tests, ascending; others are set `aside` already.
    """
    found = aside + np.arange(len(p) + 1)
    surely = np.maximum(found - CERTAIN * np.sqrt(found), 0.0) / max(tested + aside, 1)
    passed = np.flatnonzero(p <= false_share * surely[1:])
    return float(surely[passed[-1] + 1 if len(passed) else 0])


def _chance(T: np.ndarray, coordinates: int) -> np.ndarray:
    """Probability that noise alone exceeds T (chi distribution)."""
    return gammaincc(coordinates / 2, np.square(T) / 2)


@cache
def _quantile(alpha: float, coordinates: int) -> float:
    """What noise alone exceeds with probability alpha."""
    return float(np.sqrt(2 * gammainccinv(coordinates / 2, alpha)))


def _joins_stops(observations: Observations) -> np.ndarray:
    """Which observations are of points that several stops see."""
    point = observations.point
    return seen_differently(point, observations.stop, observations.points)[point]
