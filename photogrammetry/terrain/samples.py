"""Brightness of all views at a sample of seen cells: what balance and stretch are found from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64
from solmap.photogrammetry.stretching import black_and_white
from solmap.photogrammetry.terrain.balance import balance
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.looks import Look

SIDE = 200
"""Root of the number of cells at which the brightness of views is compared."""
SMOOTH = np.float32(2.0)
"""Pyramid level at which views are compared: four pixels a side, so that noise and a small
misregistration have no say."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Brightness of every view at the same cells; NaN where it does not show one."""

    smooth: Float32[np.ndarray, "views bands n"]
    """Averaged over some pixels."""
    best: Float32[np.ndarray, "bands n"]
    """As the best view of each cell shows it; NaN where none does."""
    best_view: np.ndarray

    def balance(self) -> Float64[np.ndarray, "views bands 2"]:
        """(gain, offset) that make the views agree, band by band."""
        bands = range(self.smooth.shape[1])
        return np.stack([balance(self.smooth[:, band]) for band in bands], axis=1)

    def stretch(
        self, gains: Float64[np.ndarray, "views bands 2"], percent: tuple[float, float]
    ) -> tuple[tuple[float, float], ...]:
        """Percentiles of the balanced brightness, band by band; (0, 1) where there is none."""
        gain, offset = np.moveaxis(gains[self.best_view], 2, 0)
        bands = self.best * gain.T + offset.T
        return tuple(black_and_white(band[np.isfinite(band)], percent) for band in bands)


def sampled(dtm: Dtm, looks: Sequence[Look], cell_m: float, tolerance_px: float) -> Samples:
    """Brightness of all views at evenly chosen seen cells, also in orthophoto cells of `cell_m`.

    The ground is taken to be level, which is enough to choose good views by.
    """
    ground = _chosen(dtm)
    shape = ground.shape[1:]
    level_ground = np.zeros(ground.shape, np.float32)
    level_ground[2] = 1.0
    bands = len(looks[0].bands)
    smooth = np.full((len(looks), bands, *shape), np.nan, np.float32)
    best = np.full((bands, *shape), np.nan, np.float32)
    worth, best_view = np.zeros(shape, np.float32), np.zeros(shape, np.int64)
    for number, look in enumerate(looks):
        from_camera = (ground - look.camera[:, None, None]).astype(np.float32)
        sight = look.sight(from_camera, level_ground, tolerance_px, dtm.grid.cell_m)
        shown, better = sight.worth > 0, sight.worth > worth
        level = np.log2(np.maximum(np.sqrt(sight.density) * np.float32(cell_m), 1))
        worth[better], best_view[better] = sight.worth[better], number
        for band in range(bands):
            flat = look.brightness(sight.sample, sight.line, np.full_like(level, SMOOTH), band)
            smooth[number, band][shown] = flat[shown]
            best[band][better] = look.brightness(sight.sample, sight.line, level, band)[better]
    return Samples(
        smooth.reshape(len(looks), bands, -1), best.reshape(bands, -1), best_view.ravel()
    )


def _chosen(dtm: Dtm) -> Float64[np.ndarray, "3 rows cols"]:
    """Ground (east, north, up) of evenly chosen seen cells, about `SIDE` x `SIDE`."""
    seen = np.flatnonzero(np.isfinite(dtm.elevation))
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, SIDE**2).astype(np.int64))]
    chosen = np.resize(chosen, (-(-len(chosen) // SIDE), SIDE))
    row, col = np.divmod(chosen, dtm.grid.cols)
    east, north = dtm.grid.centres()
    return np.stack([east[col], north[row], dtm.elevation[row, col]])
