"""Stops whose links leave them in parts, and the ground of a part merged into one surface.

Stops 25 to 50 m apart share ground that either sees from far, thinly and from one side. Where the
links of a stop to those before it leave them in parts, the stops of a part have each other's
places, so all of their pairs are seen as those of one stop: the heights of the ground average, and
what one of them cannot see another one can. Parts are then linked as stops are, with ties between
the very pairs that saw the ground. How well links know the places within a part, some centimetres,
enters no tie by itself: every block of ground and every patch is matched where it is seen.
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
"""First rover from second one, by the stops of accepted links."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Stops that links join, seen from one of them."""

    stop: StopId
    beside: Mapping[StopId, Pose]
    """Where its rover frame has the rovers of the others."""

    @classmethod
    def of(cls, stop: StopId, links: LinkPoses) -> Part:
        """A stop with all that links join to it, over as few links as can be."""
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
        """All of them."""
        return [self.stop, *self.beside]


def parts_to_link(
    stops: Sequence[StopId],
    telemetry: Mapping[StopId, Pose],
    links: LinkPoses,
    reach_m: float,
) -> Iterator[tuple[Part, Part]]:
    """The part of the last of some stops with each other one, earlier first, nearest stops leading.

    Args:
        stops: In the order of the traverse: those that the last one was tried with, and itself.
        telemetry: Of at least these stops.
        links: Those between them that stand.
        reach_m: Stops that are farther from the leading stop of the other part are left out.

    Yields:
        Parts of more than two stops together: what two single stops tell has been told.
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
    """A stop that sees with the pairs of others too, each where its rover frame has that rover."""
    moved = (_moved(pair, pose) for other, pose in beside for pair in other.pairs)
    return replace(stop, pairs=(*stop.pairs, *moved))


def _moved(pair: MatchedPair, pose: Pose) -> MatchedPair:
    """A pair in the frame of another rover."""
    geometry = pair.images.geometry
    moved = replace(geometry, rover_from_pair=pose @ geometry.rover_from_pair)
    return replace(pair, images=replace(pair.images, geometry=moved))
