"""Accumulated differences between telemetry and the corrected traverse, as in the paper.

Di et al. 2008 (section 3.3) compare the traverse by telemetry with the adjusted one at every stop:
the accumulated difference is the distance in plan between both positions of a stop, when both
traverses have the same start, and its percentage is that of the distance travelled so far. "Locally
accumulated" is the same with a common start at the beginning of a section (the ascent of Husband
Hill). Here the distance travelled is measured along the corrected traverse, which excludes wheel
slip.

The differences of single legs, which accumulation may cancel, are computed for each leg: its vector
by telemetry minus the corrected one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, Int32, ObjectPoints, PerPoint
from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.traverse.records import Traverse, leg_lengths

LEAST_DISTANCE_M = 20.0
"""Distance from which percentages are compared: of a first step of a metre, a wheel's width is 20
%."""


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """Telemetry minus corrected, stop by stop, with the same start."""

    stops: tuple[str, ...]
    sols: Int32[np.ndarray, " points"]
    distance_m: PerPoint
    """Distance in plan since the start, along the corrected traverse."""
    offset_m: ObjectPoints
    """(east, north, up) of telemetry minus corrected; up is NaN where one of them has none."""

    @property
    def horizontal_m(self) -> PerPoint:
        """Accumulated difference in plan."""
        return np.hypot(self.offset_m[:, 0], self.offset_m[:, 1])

    @property
    def percent(self) -> PerPoint:
        """Accumulated difference in plan, percent of the distance travelled; NaN at the start."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.distance_m > 0, 100 * self.horizontal_m / self.distance_m, np.nan)

    @property
    def leg_m(self) -> Float64[np.ndarray, " legs"]:
        """Difference in plan of every single leg."""
        return leg_lengths(self.offset_m)

    def summary(self, least_distance_m: float = LEAST_DISTANCE_M) -> Summary:
        """The last difference, and the largest ones."""
        far = np.flatnonzero(self.distance_m >= min(least_distance_m, self.distance_m[-1]))
        worst = int(far[np.argmax(np.nan_to_num(self.percent[far]))])
        return Summary(
            stops=len(self.stops),
            end=self._row(len(self.stops) - 1),
            worst=self._row(worst),
            farthest=self._row(int(np.argmax(self.horizontal_m))),
        )

    def by_sol(self) -> tuple[Difference, ...]:
        """The difference at the last stop of every sol."""
        last = np.flatnonzero(np.append(np.diff(self.sols) != 0, [True]))
        return tuple(self._row(int(row)) for row in last)

    def _row(self, row: int) -> Difference:
        return Difference(
            stop=self.stops[row],
            sol=int(self.sols[row]),
            distance_m=float(self.distance_m[row]),
            horizontal_m=float(self.horizontal_m[row]),
            percent=float(self.percent[row]),
            elevation_m=float(self.offset_m[row, 2]),
        )


@dataclass(frozen=True, slots=True)
class Difference:
    """The accumulated difference at one stop."""

    stop: str
    sol: int
    distance_m: float
    horizontal_m: float
    percent: float
    elevation_m: float
    """Telemetry above the corrected position; NaN where one of them has no elevation."""

    def __str__(self) -> str:
        return (
            f"{self.horizontal_m:.1f} m, {self.percent:.1f} % of {self.distance_m:.1f} m "
            f"(stop {self.stop}, sol {self.sol})"
        )


@dataclass(frozen=True, slots=True)
class Summary:
    """Figures of a traverse as in the paper."""

    stops: int
    end: Difference
    """Difference at the last stop."""
    worst: Difference
    """Stop with the largest percentage, except for the first metres."""
    farthest: Difference
    """Stop with the largest distance."""


def differences(telemetry: Traverse, corrected: Traverse) -> Differences:
    """Compare two traverses of the same stops, both starting at the first of them.

    Raises:
        TraverseError: they do not have the same stops, or fewer than two.
    """
    if telemetry.stops != corrected.stops:
        known = set(corrected.stops)
        lost = next((stop for stop in telemetry.stops if stop not in known), "another order")
        raise TraverseError(
            f"the {telemetry.solution} and {corrected.solution} traverses have different stops "
            f"({lost}): compare `common_stops` of them"
        )
    if len(telemetry) < 2:  # noqa: PLR2004 - a leg has two ends
        raise TraverseError("a traverse of fewer than two stops has nothing to compare")
    along = np.concatenate([[0.0], np.cumsum(leg_lengths(corrected.places_m))])
    started = telemetry.starting_at(corrected.places_m[0])
    offset_m = started.places_m - corrected.places_m
    return Differences(corrected.stops, corrected.sols, along, offset_m)


def common_stops(first: Traverse, second: Traverse) -> tuple[Traverse, Traverse]:
    """Both traverses at the stops that both have, in the order of the first."""
    rows = {stop: row for row, stop in enumerate(second.stops)}
    here = [row for row, stop in enumerate(first.stops) if stop in rows]
    return first.at(here), second.at([rows[first.stops[row]] for row in here])
