"""A traverse: positions of a rover, stop by stop, by one solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.arrays import Float64, Int32, ObjectPoints
from solmap.photogrammetry.errors import TraverseError


@dataclass(frozen=True, slots=True, eq=False)
class Traverse:
    """Stops in the order in which the rover reached them."""

    solution: str
    """Solution: telemetry, adjusted, localised."""
    stops: tuple[str, ...]
    """Name of every stop, `site/drive`."""
    sols: Int32[np.ndarray, " points"]
    """Sol on which the rover reached it."""
    places_m: ObjectPoints
    """(east, north, up) on the landing site's map; up is NaN where the solution has none."""

    def __post_init__(self) -> None:
        if not len(self.stops) == len(self.sols) == len(self.places_m):
            raise TraverseError(
                f"the {self.solution} traverse has {len(self.stops)} names, {len(self.sols)} sols "
                f"and {len(self.places_m)} positions; one of each per stop is needed"
            )
        if not np.isfinite(self.places_m[:, :2]).all():
            raise TraverseError(f"the {self.solution} traverse has stops without a position")

    def __len__(self) -> int:
        return len(self.stops)

    @property
    def length_m(self) -> float:
        """Distance travelled in plan, metres."""
        return float(leg_lengths(self.places_m).sum())

    def at(self, rows: Sequence[int] | np.ndarray) -> Traverse:
        """A selection of its stops, in the requested order."""
        index = np.asarray(rows, dtype=np.intp)
        return Traverse(
            self.solution,
            tuple(self.stops[row] for row in index),
            self.sols[index],
            self.places_m[index],
        )

    def between(self, first_sol: int, last_sol: int) -> Traverse:
        """The stops that were reached within some sols, both included."""
        return self.at(np.flatnonzero((self.sols >= first_sol) & (self.sols <= last_sol)))

    def starting_at(self, place_m: np.ndarray) -> Traverse:
        """The traverse shifted so that its first stop is at a place, (east, north, up)."""
        shift = np.where(np.isfinite(place_m), place_m - self.places_m[0], 0.0)
        return replace(self, places_m=self.places_m + shift)


def leg_lengths(places_m: Float64[np.ndarray, "n axes"]) -> Float64[np.ndarray, " legs"]:
    """Length in plan of every leg between positions (east, north, ...), metres."""
    return np.hypot(*np.diff(places_m[:, :2], axis=0).T)
