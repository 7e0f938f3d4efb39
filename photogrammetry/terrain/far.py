"""Parameters of far ground's own map: what two stops see as one instrument (`wide_stereo`).

At 200 m a Navcam pixel covers 0.16 m across the line of sight and, from a mast, twenty metres along
it, so cells are larger, gaps wider and lines smoother than in the map of a stop.
"""

from __future__ import annotations

from dataclasses import dataclass

from solmap.photogrammetry.terrain.contours import ContourParams
from solmap.photogrammetry.terrain.dtm import DtmParams


@dataclass(frozen=True, slots=True)
class FarDtmParams(DtmParams):
    """How to build a terrain model of far ground."""

    cell_m: float = 0.64
    """Four Navcam pixels at 200 m; sixteen cells of a stop's model, so that both maps nest."""
    max_relative_sigma: float = 0.1
    """A base of 10 m reaches ten percent beyond a kilometre: the radius ends the map before."""
    radius_m: float = 400.0
    """Where errors in range have grown to a twentieth with a base of 10 m (docs/benchmarks.md)."""
    max_spike_px: float = 5.0
    """Parallax changes by B / h a line, seven pixels with 10 m: by far more than with a bar."""
    max_gap_m: float = 8.0
    """Widest gap bridged. The line spacing Z^2 / f (h + Z s) of ground that rises away from the
    camera by s a metre is 1.5 m for s = 0.1 at 200 m, and 8 m for s = 0.013."""
    slope_baseline_m: float = 8.0
    """Some cells, as in the model of a stop."""


@dataclass(frozen=True, slots=True)
class FarContourParams(ContourParams):
    """How to trace contours of far ground."""

    smoothing_m: float = 3.2
    """Five cells, as in the map of a stop."""
    min_length_m: float = 16.0
    """Twenty-five cells, as in the map of a stop."""
    simplify_m: float = 0.32
    """Half a cell."""
