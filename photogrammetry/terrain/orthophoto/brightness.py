"""Brightness balancing: one gain and offset per view, so that views agree where they overlap.

For every two views a, b that share enough ground, the means m and spreads s of their brightness
there should agree after balancing, and all gains stay near one:

    g_a m_ab + o_a = g_b m_ba + o_b,     g_a s_ab = g_b s_ba,     g = 1,  o = 0

each with its own weight, solved by least squares (after Brown & Lowe 2007, section 6, who balance
gains only). The means are medians and the spreads are from the middle half of the values, so that
shadows or rocks visible in only one of the views have no influence.

Gains and the brightness shown as black and white are computed from a sample of known cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64
from solmap.photogrammetry.stretching import black_and_white
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.orthophoto.view_sampling import ViewSampler

LEAST_SHARED = 50
"""Cells that two views must share to be compared."""
SIGMA_MEAN = 0.01
"""Expected agreement of means, relative to the level of brightness."""
SIGMA_SPREAD = 0.05
"""Expected agreement of spreads, relative to the spread."""
LEAST_SPREAD = 0.02
"""Spread, relative to the level, below which it is noise rather than contrast."""
SIGMA_GAIN = 0.2
"""Prior deviation of gains: exposures and vignetting differ by tens of percent at most."""
SIGMA_OFFSET = 0.1
"""Prior deviation of offsets, relative to the level: bias and stray light."""

Balance = Float64[np.ndarray, "views 2"]
"""Gain and offset of every view."""
SIDE = 200
"""Root of the number of cells at which views are compared."""
SMOOTH = np.float32(2.0)
"""Pyramid level at which views are compared: four pixels per side, which reduces the effect of
noise and small misregistration."""


def balance(brightness: Float32[np.ndarray, "views n"]) -> Balance:
    """Gains and offsets that make views agree on their common cells; NaN where not visible."""
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


@dataclass(frozen=True, slots=True, eq=False)
class BrightnessSamples:
    """Brightness of every view at the same cells; NaN where the cell is not visible."""

    smooth: Float32[np.ndarray, "views bands n"]
    """Averaged over some pixels."""
    best: Float32[np.ndarray, "bands n"]
    """Brightness in the best view of each cell; NaN where it has none."""
    best_view: np.ndarray

    def balance(self) -> Float64[np.ndarray, "views bands 2"]:
        """(gain, offset) that make the views agree, for each band."""
        bands = range(self.smooth.shape[1])
        return np.stack([balance(self.smooth[:, band]) for band in bands], axis=1)

    def stretch(
        self, gains: Float64[np.ndarray, "views bands 2"]
    ) -> tuple[tuple[float, float], ...]:
        """Percentiles of the balanced brightness, for each band; (0, 1) where there is none."""
        gain, offset = np.moveaxis(gains[self.best_view], 2, 0)
        bands = self.best * gain.T + offset.T
        return tuple(black_and_white(band[np.isfinite(band)]) for band in bands)


def sample_brightness(
    dtm: Dtm, samplers: Sequence[ViewSampler], cell_m: float
) -> BrightnessSamples:
    """Brightness of all views at evenly chosen known cells, also in orthophoto cells of `cell_m`.

    The ground is assumed to be level, which is sufficient for choosing views.
    """
    ground = _chosen_ground(dtm)
    shape = ground.shape[1:]
    level_ground = np.zeros(ground.shape, np.float32)
    level_ground[2] = 1.0
    bands = len(samplers[0].bands)
    smooth = np.full((len(samplers), bands, *shape), np.nan, np.float32)
    best = np.full((bands, *shape), np.nan, np.float32)
    worth, best_view = np.zeros(shape, np.float32), np.zeros(shape, np.int64)
    for number, sampler in enumerate(samplers):
        from_camera = (ground - sampler.camera[:, None, None]).astype(np.float32)
        cells = sampler.project(from_camera, level_ground, dtm.grid.cell_m)
        shown, better = cells.worth > 0, cells.worth > worth
        level = np.log2(np.maximum(np.sqrt(cells.density) * np.float32(cell_m), 1))
        worth[better], best_view[better] = cells.worth[better], number
        for band in range(bands):
            flat = sampler.brightness(cells.sample, cells.line, np.full_like(level, SMOOTH), band)
            smooth[number, band][shown] = flat[shown]
            best[band][better] = sampler.brightness(cells.sample, cells.line, level, band)[better]
    return BrightnessSamples(
        smooth.reshape(len(samplers), bands, -1), best.reshape(bands, -1), best_view.ravel()
    )


def _chosen_ground(dtm: Dtm) -> Float64[np.ndarray, "3 rows cols"]:
    """Ground (east, north, up) of evenly chosen known cells, about `SIDE` x `SIDE`."""
    seen = np.flatnonzero(np.isfinite(dtm.elevation))
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, SIDE**2).astype(np.int64))]
    chosen = np.resize(chosen, (-(-len(chosen) // SIDE), SIDE))
    row, col = np.divmod(chosen, dtm.grid.cols)
    east, north = dtm.grid.centres()
    return np.stack([east[col], north[row], dtm.elevation[row, col]])
