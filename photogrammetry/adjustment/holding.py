"""What holds each stop: ties that lead to the datum, or telemetry from the stop before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.collinearity import Observations
from photogrammetry.arrays import Bool
from photogrammetry.imagery import StopId


@dataclass(frozen=True, slots=True, eq=False)
class Holding:
    """How the stops of a network hang together by their used ties."""

    shared: tuple[dict[int, int], ...]
    """Of every stop: how many ties it shares with each other one."""
    held: Bool[np.ndarray, " stops"]
    reached: Bool[np.ndarray, " stops"]
    """Whether ties lead to a stop that is held, or known from before."""

    @classmethod
    def of(
        cls,
        observations: Observations,
        used: Bool[np.ndarray, " rows"],
        held: Bool[np.ndarray, " stops"],
        known: Bool[np.ndarray, " stops"],
    ) -> Holding:
        """Of the used observations of a network; `held` is the datum, `known` is joined to it."""
        shared: tuple[dict[int, int], ...] = tuple({} for _ in held)
        for a, b, count in _couples(observations.point[used], observations.stop[used]):
            shared[a][b] = shared[b][a] = shared[a].get(b, 0) + count
        reached = held | known
        front = np.flatnonzero(reached).tolist()
        while front:
            for other in shared[front.pop()]:
                if not reached[other]:
                    reached[other] = True
                    front.append(other)
        return cls(shared, held, reached)

    def told(self, names: tuple[StopId, ...], k: int) -> str:
        """What holds stop k, in words."""
        if self.held[k]:
            return "held as the datum"
        ties = sorted(self.shared[k].items())
        listed = ", ".join(f"{count} with {names[other]}" for other, count in ties)
        if self.reached[k]:
            return f"cross-site ties: {listed}"
        carried = f"telemetry increment from {names[k - 1]}" if k else "telemetry"
        return f"{carried}; ties do not reach the datum ({listed})" if listed else carried


def _couples(point: np.ndarray, stop: np.ndarray) -> list[tuple[int, int, int]]:
    """Every two stops (a < b) with points that both saw, and how many; some come in parts."""
    seen = np.unique(np.column_stack([point, stop]), axis=0)
    couples: list[tuple[int, int, int]] = []
    for lag in range(1, len(seen)):
        same = seen[lag:, 0] == seen[:-lag, 0]
        if not same.any():
            break
        both, counts = np.unique(
            np.column_stack([seen[:-lag, 1], seen[lag:, 1]])[same], axis=0, return_counts=True
        )
        couples += [(a, b, n) for (a, b), n in zip(both.tolist(), counts.tolist(), strict=True)]
    return couples
