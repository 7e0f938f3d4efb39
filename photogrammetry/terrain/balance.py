"""Brightness balance: one gain and offset a view, so that views agree where they overlap.

For every two views a, b that share enough ground, the means m and spreads s of their brightness
there should agree after balancing, and all gains stay near one:

    g_a m_ab + o_a = g_b m_ba + o_b,     g_a s_ab = g_b s_ba,     g = 1,  o = 0

each with its own weight, solved by least squares (after Brown & Lowe 2007, section 6, who balance
gains only). The means are medians and the spreads are from the middle half of the values, so that
the odd shadow or rock that one view shows and the other does not has no say.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64

LEAST_SHARED = 50
"""Cells that two views must share to be compared."""
SIGMA_MEAN = 0.01
"""Agreement expected of means, relative to the level of brightness."""
SIGMA_SPREAD = 0.05
"""Agreement expected of spreads, relative to the spread."""
LEAST_SPREAD = 0.02
"""Spread, relative to the level, below which it is noise rather than contrast."""
SIGMA_GAIN = 0.2
"""How far gains stray: exposures and vignetting differ by tens of percent at most."""
SIGMA_OFFSET = 0.1
"""How far offsets stray, relative to the level: bias and stray light."""

Balance = Float64[np.ndarray, "views 2"]
"""Gain and offset of every view."""


def balance(brightness: Float32[np.ndarray, "views n"]) -> Balance:
    """Gains and offsets that make views agree on the cells they share; NaN where not shown."""
    count = len(brightness)
    shown = np.isfinite(brightness)
    level = float(np.median(brightness[shown])) if shown.any() else 1.0
    level = level if level > 0 else 1.0
    rows, values = [], []
    for a, b in combinations(range(count), 2):
        shared = shown[a] & shown[b]
        if shared.sum() < LEAST_SHARED:
            continue
        (m_a, s_a), (m_b, s_b) = (_middle(brightness[v, shared] / level) for v in (a, b))
        mean, spread = np.zeros(2 * count), np.zeros(2 * count)
        mean[[2 * a, 2 * a + 1, 2 * b, 2 * b + 1]] = (m_a, 1, -m_b, -1)
        spread[[2 * a, 2 * b]] = (s_a, -s_b)
        contrast = max((s_a + s_b) / 2, LEAST_SPREAD)
        rows += [mean / SIGMA_MEAN, spread / (SIGMA_SPREAD * contrast)]
        values += [0.0, 0.0]
    prior = np.diag(np.tile([1 / SIGMA_GAIN, 1 / SIGMA_OFFSET], count))
    design = np.vstack([*rows, prior])
    target = np.concatenate([values, np.tile([1 / SIGMA_GAIN, 0.0], count)])
    solution = np.linalg.lstsq(design, target, rcond=None)[0].reshape(count, 2)
    return solution * [1.0, level]


def _middle(values: Float32[np.ndarray, " n"]) -> tuple[float, float]:
    """Median and half the distance between the quartiles."""
    low, middle, high = np.percentile(values, (25, 50, 75))
    return float(middle), float(high - low) / 2
