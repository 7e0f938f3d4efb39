"""How far any two stops disagree over the ground that both have mapped: counted, not kept.

Differences of all cells of a large region would fill the memory, so they are counted in classes
whose limits grow by two percent; a median or percentile read from these counts is good to one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from solmap.photogrammetry.terrain.records import Dtm
from solmap.photogrammetry.terrain.region import StopTerrain

LEAST, GROWTH, CLASSES = 1e-4, 1.02, 800
"""From a tenth of a millimetre to beyond a hundred metres; the same numbers serve sigmas."""


@dataclass(frozen=True, slots=True)
class Seam:
    """The disagreement between two stops."""

    stops: tuple[int, int]
    """Their numbers in the region."""
    cells: int
    mean_m: float
    """Of the second less the first: what one stands too high over the other."""
    median_m: float
    p90_m: float
    median_sigmas: float
    p90_sigmas: float


@dataclass(slots=True, eq=False)
class _Counts:
    metres: np.ndarray = field(default_factory=lambda: np.zeros(CLASSES, dtype=np.int64))
    sigmas: np.ndarray = field(default_factory=lambda: np.zeros(CLASSES, dtype=np.int64))
    signed_m: float = 0.0


@dataclass(slots=True, eq=False)
class SeamCounter:
    """Counts the differences between stops, block by block."""

    counts: dict[tuple[int, int], _Counts] = field(default_factory=dict)

    def add(self, stops: Sequence[StopTerrain], inside: tuple[slice, slice]) -> None:
        """Count the cells `inside` a block."""
        for one, other in combinations(stops, 2):
            self._add((one.number, other.number), one.dtm, other.dtm, inside)

    def _add(
        self, pair: tuple[int, int], one: Dtm, other: Dtm, inside: tuple[slice, slice]
    ) -> None:
        apart = other.elevation[inside] - one.elevation[inside]
        both = np.isfinite(apart)
        if not both.any():
            return
        apart = apart[both]
        sigma = np.hypot(one.sigma_m[inside][both], other.sigma_m[inside][both])
        counts = self.counts.setdefault(pair, _Counts())
        counts.signed_m += float(apart.sum(dtype=np.float64))
        counts.metres += _counted(np.abs(apart))
        counts.sigmas += _counted(np.abs(apart) / sigma)

    def seams(self) -> tuple[Seam, ...]:
        """The disagreement of every two stops that share ground."""
        return tuple(
            Seam(
                pair,
                int(counts.metres.sum()),
                round(counts.signed_m / int(counts.metres.sum()), 4),
                *(
                    round(_percentile(values, share), 4)
                    for values in (counts.metres, counts.sigmas)
                    for share in (0.5, 0.9)
                ),
            )
            for pair, counts in sorted(self.counts.items())
        )


def _counted(values: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        at = np.log(values / LEAST) / np.log(GROWTH)
    return np.bincount(np.clip(at, 0, CLASSES - 1).astype(np.int64), minlength=CLASSES)


def _percentile(counts: np.ndarray, share: float) -> float:
    """The value below which a share of the counted ones lies."""
    reached = np.cumsum(counts)
    at = int(np.searchsorted(reached, share * reached[-1]))
    return float(LEAST * GROWTH ** (at + 0.5))
