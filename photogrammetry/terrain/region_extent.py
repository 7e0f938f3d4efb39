"""Which stops make a region together: those whose ground meets, as far as a map can be looked at.

The stops are taken in the order of the traverse. A stop joins the region before it when its ground
meets that of one of the region's stops and the region does not grow beyond the largest side; else a
new region begins. So a longer traverse changes the last region at most.
"""

from __future__ import annotations

from collections.abc import Sequence

Bounds = tuple[float, float, float, float]
"""(west, south, east, north), metres."""


def regions_of(stops: Sequence[Bounds], largest_m: float) -> list[list[int]]:
    """The regions of a traverse, each as the numbers of its stops."""
    regions: list[list[int]] = []
    for number, bounds in enumerate(stops):
        last = [stops[k] for k in regions[-1]] if regions else []
        joins = any(_meet(bounds, other) for other in last)
        if joins and _side_m([*last, bounds]) <= largest_m:
            regions[-1].append(number)
        else:
            regions.append([number])
    return regions


def _meet(one: Bounds, other: Bounds) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _side_m(stops: Sequence[Bounds]) -> float:
    west, south, east, north = zip(*stops, strict=True)
    return max(max(east) - min(west), max(north) - min(south))
