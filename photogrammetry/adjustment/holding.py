"""What holds each stop: ties that lead to the datum, or telemetry from the stop before."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import Observations
from solmap.photogrammetry.adjustment.control_equations import Control
from solmap.photogrammetry.adjustment.datum import MAP
from solmap.photogrammetry.adjustment.observations import seen_differently
from solmap.photogrammetry.adjustment.records import Network
from solmap.photogrammetry.arrays import Bool


@dataclass(frozen=True, slots=True, eq=False)
class Holding:
    """How the stops of a network hang together by their used ties."""

    shared: tuple[dict[int, int], ...]
    """Of every stop: how many ties it shares with each other one."""
    held: Bool[np.ndarray, " stops"]
    reached: Bool[np.ndarray, " stops"]
    """Whether ties or control lead to a stop that is held, or known from before."""
    placed: dict[int, list[int]]
    """Of stops that control has placed: the numbers of the frames."""

    @classmethod
    def of(
        cls,
        observations: Observations,
        used: Bool[np.ndarray, " rows"],
        held: Bool[np.ndarray, " stops"],
        known: Bool[np.ndarray, " stops"],
        control: Control | None = None,
    ) -> Holding:
        """Of the used observations of a network; `held` is the datum, `known` is joined to it."""
        shared: tuple[dict[int, int], ...] = tuple({} for _ in held)
        stop, point = observations.stop[used], observations.point[used]
        joins = seen_differently(point, stop, observations.points)[point]
        for (a, b), count in _couples(point[joins], stop[joins], len(held)).items():
            shared[a][b] = shared[b][a] = count
        placed = _placed(control)
        near = [{*others, *(other for f in placed.get(k, ()) for other in _shown(placed, f))}
                for k, others in enumerate(shared)]  # fmt: skip
        reached = np.array(held | known)
        if control:
            free = control.is_free[control.frame]
            reached[control.stop[control.used & np.logical_not(free.any(axis=1))]] = True
        front = np.flatnonzero(reached).tolist()
        while front:
            for other in near[front.pop()]:
                if not reached[other]:
                    reached[other] = True
                    front.append(other)
        return cls(shared, held, reached, placed)

    def told(self, network: Network, k: int) -> str:
        """What holds stop k, in words."""
        if self.held[k]:
            return "held as the datum"
        names, frames = network.stop_ids, network.frames
        held = [frames[f].name for f in self.placed.get(k, ())]
        parts = ["the datum by its place"] if MAP.name in held else []
        if images := [name for name in held if name != MAP.name]:
            parts.append(f"control: its place in {', '.join(images)}")
        ties = sorted(self.shared[k].items())
        listed = ", ".join(f"{count} with {names[other]}" for other, count in ties)
        if self.reached[k]:
            return "; ".join([*parts, *([f"cross-site ties: {listed}"] if listed else [])])
        carried = f"telemetry increment from {names[k - 1]}" if k else "telemetry"
        return f"{carried}; ties do not reach the datum ({listed})" if listed else carried


def _placed(control: Control | None) -> dict[int, list[int]]:
    placed: dict[int, list[int]] = {}
    if control:
        both = np.column_stack([control.stop, control.frame])[control.used]
        for stop, frame in np.unique(both, axis=0).tolist():
            placed.setdefault(stop, []).append(frame)
    return placed


def _shown(placed: dict[int, list[int]], frame: int) -> list[int]:
    """Stops that a control frame shows."""
    return [stop for stop, frames in placed.items() if frame in frames]


def _couples(point: np.ndarray, stop: np.ndarray, stops: int) -> Counter[tuple[int, int]]:
    """Every two stops (a < b) with points that both saw, and how many."""
    point, stop = np.divmod(np.unique(point.astype(np.int64) * stops + stop), stops)
    couples: Counter[tuple[int, int]] = Counter()
    for lag in range(1, len(point)):
        same = point[lag:] == point[:-lag]
        if not same.any():
            break
        counts = np.bincount(stop[:-lag][same] * stops + stop[lag:][same])
        both = np.flatnonzero(counts)
        for code, count in zip(both.tolist(), counts[both].tolist(), strict=True):
            couples[divmod(code, stops)] += count
    return couples
