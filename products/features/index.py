"""An index of features on disk, so that a page of 150,000 takes milliseconds, with its queries.

Layers are GeoJSON files, one for each scope: reading them for every request would take seconds. The
index is a table of all their features beside an R*Tree of their boxes (SQLite's own), filled once
for each version of a layer, each with its own key. It can be rebuilt from products, so it may be
deleted while nothing runs.

Shapes are well-known binary in metres of the local map, (east, north) or (east, north, up). The
R*Tree keeps boxes in single precision, rounded outwards; whether a shape intersects the area of a
query is then tested with the shape itself.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from solmap.photogrammetry.terrain.dtm.grid import Bounds

COLUMNS = "f.name, f.shape, f.properties, f.first_sol, f.last_sol, f.first, f.last"
"""Columns read by `feature_of`."""


@dataclass(frozen=True, slots=True)
class IndexedFeature:
    """A feature in the index."""

    name: str
    """Its identifier, unique in its layer."""
    shape: bytes | None
    """Well-known binary, metres of the local map; None without geometry."""
    properties: str
    """A JSON object."""
    sols: tuple[int, int] | None = None
    """First and last sol."""
    times: tuple[str, str] | None = None
    """First and last moment, UTC, ISO 8601 with the same digits in all (they are compared)."""


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """Requested part of the map."""

    shape: shapely.Geometry
    """Metres of the local map."""
    inner: Bounds
    """A box inside it; features in this box need no further test."""

    @classmethod
    def of_box(cls, bounds: Bounds) -> Area:
        """All between west, south, east and north."""
        return cls(shapely.box(*bounds), bounds)


@dataclass(frozen=True, slots=True)
class Selection:
    """Requested features; None selects all."""

    keys: Sequence[str]
    """Keys of layers."""
    area: Area | None = None
    sols: tuple[int | None, int | None] | None = None
    times: tuple[str | None, str | None] | None = None
    equal: Mapping[str, str] = field(default_factory=dict)
    """Values of properties, as text."""

    @property
    def is_whole(self) -> bool:
        """Whether all features of the layers are selected."""
        return not (self.area or self.sols or self.times or self.equal)


@dataclass(frozen=True, slots=True)
class Extent:
    """Extent of some layers in space and time."""

    count: int
    bounds: Bounds | None
    times: tuple[str, str] | None


class Meets:
    """Whether a shape meets the area; SQLite calls it for shapes near the area's edge."""

    def __init__(self, area: shapely.Geometry) -> None:
        shapely.prepare(area)
        self._area = area

    def __call__(self, shape: bytes) -> bool:
        """Test one shape."""
        return bool(self._area.intersects(shapely.from_wkb(shape)))


def condition_of(selection: Selection) -> tuple[str, list[Any]]:
    """The FROM clause and its values; it uses the table `asked` and the function `meets`.

    An area alone is answered by the boxes; features are only read for other conditions.
    """
    terms, values = _other_conditions(selection)
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


def _other_conditions(selection: Selection) -> tuple[list[str], list[Any]]:
    """Conditions on features other than their position."""
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
    """The feature of a row of `COLUMNS`."""
    name, shape, properties, first_sol, last_sol, first, last = row
    sols = None if first_sol is None else (first_sol, last_sol)
    return IndexedFeature(name, shape, properties, sols, (first, last) if first else None)


log = logging.getLogger(__name__)
_SCHEMA = """
CREATE TABLE IF NOT EXISTS layers(
    number INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, family TEXT NOT NULL,
    count INTEGER NOT NULL, west REAL, south REAL, east REAL, north REAL, first TEXT, last TEXT);
CREATE TABLE IF NOT EXISTS features(
    id INTEGER PRIMARY KEY, layer INTEGER NOT NULL, name TEXT NOT NULL, shape BLOB,
    properties TEXT NOT NULL, first_sol INTEGER, last_sol INTEGER, first TEXT, last TEXT);
CREATE INDEX IF NOT EXISTS features_of_layer ON features(layer, id);
CREATE INDEX IF NOT EXISTS features_by_name ON features(name);
CREATE VIRTUAL TABLE IF NOT EXISTS boxes USING rtree(id, west, east, south, north, +layer);
"""
_TYPES: dict[type, str] = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    list: "array",
    dict: "object",
}
_VERSION = 2
"""Version of the tables, increased when they change."""
_FORGET_ALL = f"""
DROP TABLE IF EXISTS layers; DROP TABLE IF EXISTS features; DROP TABLE IF EXISTS boxes;
PRAGMA user_version={_VERSION};
"""
_FIELDS_OF = 100
"""Features whose properties are examined for the fields of a collection."""
_WAIT_S = 60.0
"""Waiting time for another process that fills the index."""


@dataclass(frozen=True, slots=True)
class FeatureIndex:
    """The index in a file. Every call opens it again, so threads and processes may share it."""

    path: Path

    @classmethod
    def open(cls, path: Path) -> FeatureIndex:
        """Open or create the index; a damaged one is rebuilt."""
        path.parent.mkdir(parents=True, exist_ok=True)
        index = cls(path)
        try:
            index._prepare()
        # it cannot be written, or another process holds it too long
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError as error:
            log.warning("%s is damaged and rebuilt: %s", path.name, error)
            for file in path.parent.glob(f"{path.name}*"):
                file.unlink(missing_ok=True)
            index._prepare()
        return index

    def _prepare(self) -> None:
        with self._connection() as connection:
            connection.execute("PRAGMA journal_mode=WAL")
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            if version != _VERSION:  # it can be rebuilt from the products
                connection.executescript(_FORGET_ALL)
            connection.executescript(_SCHEMA)

    def missing(self, keys: Iterable[str]) -> list[str]:
        """The layers that are not in it yet."""
        with self._connection() as connection:
            held = {key for (key,) in connection.execute("SELECT key FROM layers")}
        return [key for key in keys if key not in held]

    def put(self, key: str, family: str, features: Iterable[IndexedFeature]) -> None:
        """Add a layer, unless another process just has; earlier ones of its family are removed.

        The versions of one layer are a family: its collection and scope.
        """
        rows = list(features)
        shapes = shapely.from_wkb([row.shape for row in rows])
        boxes = shapely.bounds(shapes).reshape(-1, 4)
        times = [row.times for row in rows if row.times]
        with self._connection() as connection:
            connection.execute("BEGIN IMMEDIATE")
            if connection.execute("SELECT 1 FROM layers WHERE key = ?", (key,)).fetchone():
                return
            _forget(connection, family)
            placed = boxes[~np.isnan(boxes[:, 0])]
            around = [*placed[:, :2].min(axis=0), *placed[:, 2:].max(axis=0)] if len(placed) else []
            west, south, east, north = map(float, around) if around else (None,) * 4
            number = connection.execute(
                "INSERT INTO layers(key, family, count, west, south, east, north, first, last) "
                "VALUES(?,?,?,?,?,?,?,?,?)",
                (key, family, len(rows), west, south, east, north)
                + ((min(a for a, _ in times), max(b for _, b in times)) if times else (None, None)),
            ).lastrowid
            (last,) = connection.execute("SELECT coalesce(max(id), 0) FROM features").fetchone()
            connection.executemany(
                "INSERT INTO features VALUES(?,?,?,?,?,?,?,?,?)",
                (
                    (last + k, number, row.name, row.shape, row.properties)
                    + (row.sols or (None, None))
                    + (row.times or (None, None))
                    for k, row in enumerate(rows, 1)
                ),
            )
            connection.executemany(
                "INSERT INTO boxes VALUES(?,?,?,?,?,?)",
                (
                    (last + k, box[0], box[2], box[1], box[3], number)
                    for k, box in enumerate(boxes.tolist(), 1)
                    if not math.isnan(box[0])  # it has no geometry
                ),
            )

    def extent(self, keys: Sequence[str]) -> Extent:
        """Number, bounds and times of the features of layers."""
        with self._connection(keys) as connection:
            count, west, south, east, north, first, last = connection.execute(
                "SELECT coalesce(sum(count), 0), min(west), min(south), max(east), max(north), "
                "min(first), max(last) FROM layers WHERE number IN (SELECT number FROM asked)"
            ).fetchone()
        bounds = None if west is None else (west, south, east, north)
        return Extent(count, bounds, (first, last) if first else None)

    def count(self, selection: Selection) -> int:
        """Number of selected features."""
        if selection.is_whole:
            return self.extent(selection.keys).count
        with self._connection(selection.keys, selection.area) as connection:
            where, values = condition_of(selection)
            (count,) = connection.execute(f"SELECT count(*) {where}", values).fetchone()
        return int(count)

    def fields(self, keys: Sequence[str]) -> dict[str, str]:
        """Properties of some features, and their types in the terms of JSON Schema."""
        found: dict[str, str] = {}
        for feature in self.page(Selection(keys), _FIELDS_OF):
            for name, value in json.loads(feature.properties).items():
                if value is not None:
                    found[name] = _TYPES[type(value)]
        return found

    def page(self, selection: Selection, limit: int, offset: int = 0) -> list[IndexedFeature]:
        """A page of the selected features in the order of their layers, from `offset` on."""
        with self._connection(selection.keys, selection.area) as connection:
            where, values = condition_of(selection)
            rows = connection.execute(
                f"SELECT {COLUMNS} FROM features f WHERE f.id IN "  # noqa: S608 - our own words
                f"(SELECT id {where} ORDER BY id LIMIT ? OFFSET ?) ORDER BY f.id",
                (*values, limit, offset),
            ).fetchall()
        return [feature_of(row) for row in rows]

    def find(self, keys: Sequence[str], name: str) -> IndexedFeature | None:
        """The feature of a name."""
        with self._connection(keys) as connection:
            row = connection.execute(
                f"SELECT {COLUMNS} FROM features f WHERE f.name = ? "  # noqa: S608 - as above
                "AND f.layer IN (SELECT number FROM asked)",
                (name,),
            ).fetchone()
        return feature_of(row) if row else None

    @contextlib.contextmanager
    def _connection(
        self, keys: Sequence[str] | None = None, area: Area | None = None
    ) -> Iterator[sqlite3.Connection]:
        """A connection with the requested layers (table `asked`) and area (`meets`)."""
        connection = sqlite3.connect(self.path, timeout=_WAIT_S)
        try:
            with connection:
                if keys is not None:
                    _request_layers(connection, keys)
                if area:
                    connection.create_function("meets", 1, Meets(area.shape), deterministic=True)
                yield connection
        finally:
            connection.close()


def _request_layers(connection: sqlite3.Connection, keys: Sequence[str]) -> None:
    connection.execute("CREATE TEMP TABLE wanted(key TEXT PRIMARY KEY)")
    connection.executemany("INSERT OR IGNORE INTO wanted VALUES(?)", ((key,) for key in keys))
    connection.execute(
        "CREATE TEMP TABLE asked AS SELECT number FROM layers JOIN wanted USING (key)"
    )


def _forget(connection: sqlite3.Connection, family: str) -> None:
    """Remove the earlier versions of a layer."""
    for (number,) in connection.execute(
        "SELECT number FROM layers WHERE family = ?", (family,)
    ).fetchall():
        of_layer = "SELECT id FROM features WHERE layer = ?"
        connection.execute(f"DELETE FROM boxes WHERE id IN ({of_layer})", (number,))  # noqa: S608
        connection.execute("DELETE FROM features WHERE layer = ?", (number,))
        connection.execute("DELETE FROM layers WHERE number = ?", (number,))
