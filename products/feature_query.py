"""Which features of an index are asked for, and what that is in SQL."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import shapely

from solmap.photogrammetry.terrain.dtm.grid import Bounds

COLUMNS = "f.name, f.shape, f.properties, f.first_sol, f.last_sol, f.first, f.last"
"""What `feature_of` reads."""


@dataclass(frozen=True, slots=True)
class IndexedFeature:
    """A feature as the index keeps it."""

    name: str
    """Its identifier, unique in its layer."""
    shape: bytes | None
    """Well-known binary, metres of the local map; None where its place is not known."""
    properties: str
    """A JSON object."""
    sols: tuple[int, int] | None = None
    """First and last sol."""
    times: tuple[str, str] | None = None
    """First and last moment, UTC, ISO 8601 with the same digits in all (they are compared)."""


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """What part of the map is asked for."""

    shape: shapely.Geometry
    """Metres of the local map."""
    inner: Bounds
    """A box that lies in it whole; what is in this box need not be looked at closer."""

    @classmethod
    def of_box(cls, bounds: Bounds) -> Area:
        """All between west, south, east and north."""
        return cls(shapely.box(*bounds), bounds)


@dataclass(frozen=True, slots=True)
class Selection:
    """Which features are asked for; what is None does not matter."""

    keys: Sequence[str]
    """Of layers."""
    area: Area | None = None
    sols: tuple[int | None, int | None] | None = None
    times: tuple[str | None, str | None] | None = None
    equal: Mapping[str, str] = field(default_factory=dict)
    """Values of properties, as text."""

    @property
    def is_whole(self) -> bool:
        """Whether all features of the layers are asked for."""
        return not (self.area or self.sols or self.times or self.equal)


@dataclass(frozen=True, slots=True)
class Extent:
    """Where and when the features of some layers are."""

    count: int
    bounds: Bounds | None
    times: tuple[str, str] | None


class Meets:
    """Whether a shape meets the area; SQLite calls it for shapes near the area's edge."""

    def __init__(self, area: shapely.Geometry) -> None:
        shapely.prepare(area)
        self._area = area

    def __call__(self, shape: bytes) -> bool:
        """Whether this one does."""
        return bool(self._area.intersects(shapely.from_wkb(shape)))


def condition_of(selection: Selection) -> tuple[str, list[Any]]:
    """FROM and what follows, and its values; it asks the table `asked` and the function `meets`.

    An area alone is answered by the boxes; features are looked up only for what boxes do not say.
    """
    terms, values = _beside(selection)
    if not selection.area:
        terms.insert(0, "f.layer IN (SELECT number FROM asked)")
        return f"FROM features f WHERE {' AND '.join(terms)}", values
    west, south, east, north = selection.area.shape.bounds
    near = "b.west <= ? AND b.east >= ? AND b.south <= ? AND b.north >= ?"
    values = [east, west, north, south, *values]
    west, south, east, north = selection.area.inner
    inside = (
        "(b.west >= ? AND b.east <= ? AND b.south >= ? AND b.north <= ?) "
        "OR meets((SELECT s.shape FROM features s WHERE s.id = b.id))"
    )
    values[4:4] = [west, east, south, north]
    join = " JOIN features f USING (id)" if terms else ""
    terms = ["b.layer IN (SELECT number FROM asked)", *terms]
    here = f"SELECT b.id AS id, b.layer AS layer FROM boxes b WHERE {near} AND ({inside})"  # noqa: S608
    return f"FROM ({here}) b{join} WHERE {' AND '.join(terms)}", values


def _beside(selection: Selection) -> tuple[list[str], list[Any]]:
    """What is asked of features beside where they are."""
    terms: list[str] = []
    values: list[Any] = []
    for span, first, last in (
        (selection.sols, "f.first_sol", "f.last_sol"),
        (selection.times, "f.first", "f.last"),
    ):
        if span:
            terms.append(f"{first} IS NOT NULL")
            terms += [f"{last} >= ?"] if span[0] is not None else []
            terms += [f"{first} <= ?"] if span[1] is not None else []
            values += [end for end in span if end is not None]
    for name, value in selection.equal.items():
        terms.append("CAST(json_extract(f.properties, ?) AS TEXT) = ?")
        values += [f'$."{name}"', value]
    return terms, values


def feature_of(row: tuple[Any, ...]) -> IndexedFeature:
    """A row of `COLUMNS`."""
    name, shape, properties, first_sol, last_sol, first, last = row
    sols = None if first_sol is None else (first_sol, last_sol)
    return IndexedFeature(name, shape, properties, sols, (first, last) if first else None)
