"""Groups of linked stops, and the ground of a group merged into one surface.

Stops 25 to 50 m apart see their common ground from far, with few points and from one side. Where
the links of a stop to earlier ones leave them in separate parts, the relative poses within a part
are known, so all its pairs are treated as those of one stop: heights are averaged, and ground
hidden from one stop may be visible from another. Parts are then linked like stops, with ties
between the pairs that saw the ground. The error of relative poses within a part, some centimetres,
does not affect the ties: every block of ground and every patch is matched in the pairs that see it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeAlias

import numpy as np

from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop

LinkPoses: TypeAlias = Mapping[tuple[StopId, StopId], Pose]
"""First rover from second one, for the stops of accepted links."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Linked stops, in the frame of one of them."""

    stop: StopId
    beside: Mapping[StopId, Pose]
    """Poses of the other rovers in its rover frame."""

    @classmethod
    def of(cls, stop: StopId, links: LinkPoses) -> Part:
        """A stop with all stops that links join to it, over as few links as possible."""
        places = {stop: Pose.identity(stop.frame, stop.frame)}
        reached = [stop]
        for here in reached:
            for (one, other), pose in links.items():
                if here in (one, other):
                    there, step = (other, pose) if here == one else (one, pose.inverse)
                    if there not in places:
                        places[there] = places[here] @ step
                        reached.append(there)
        del places[stop]
        return cls(stop, places)

    @property
    def stops(self) -> list[StopId]:
        """All stops."""
        return [self.stop, *self.beside]


def parts_to_link(
    stops: Sequence[StopId],
    telemetry: Mapping[StopId, Pose],
    links: LinkPoses,
    reach_m: float,
) -> Iterator[tuple[Part, Part]]:
    """The last stop's part with each other part, earlier one first, nearest stops leading.

    Args:
        stops: In the order of the traverse: those that the last one was tried with, and itself.
        telemetry: Of at least these stops.
        links: Those between them that stand.
        reach_m: Stops that are farther from the leading stop of the other part are left out.

    Yields:
        Parts of more than two stops together: two single stops have been linked before.
    """

    def apart_m(ends: Iterable[StopId]) -> float:
        one, other = (telemetry[stop].translation_m[:2] for stop in ends)
        return float(np.linalg.norm(one - other))

    def part(stop: StopId, other: StopId) -> Part:
        every = Part.of(stop, among).beside.items()
        return Part(
            stop, {there: pose for there, pose in every if apart_m((there, other)) <= reach_m}
        )

    among = {ends: pose for ends, pose in links.items() if set(ends) <= set(stops)}
    mine = Part.of(stops[-1], among).stops
    left = [stop for stop in stops if stop not in mine]
    while left:
        others = Part.of(left[0], among).stops
        left = [stop for stop in left if stop not in others]
        one, other = sorted(min(product(others, mine), key=apart_m), key=stops.index)
        both = part(one, other), part(other, one)
        if any(some.beside for some in both):
            yield both


def merge_ground(stop: MatchedStop, beside: Iterable[tuple[MatchedStop, Pose]]) -> MatchedStop:
    """A stop that also has the pairs of others, transformed to its rover frame."""
    moved = (_moved(pair, pose) for other, pose in beside for pair in other.pairs)
    return replace(stop, pairs=(*stop.pairs, *moved))


def _moved(pair: MatchedPair, pose: Pose) -> MatchedPair:
    """A pair in the frame of another rover."""
    return replace(pair, geometry=pair.geometry.move(pose))
