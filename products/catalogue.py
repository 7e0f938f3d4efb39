"""The catalogue: which missions, images and layers there are, and which version is the latest.

One transaction publishes everything that belongs together; readers see all of it or nothing. The
catalogue is a database (SQLite in the store's folder unless another URL is given), the products are
files: the catalogue holds references and what the map needs to know without opening them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine.interfaces import DBAPIConnection

from photogrammetry.imagery import StopId
from products.crs import LandingPoint
from products.errors import ProductNotFoundError
from products.model import LEVEL, Layer, ProductKind, ProductRef, Scope, ScopeLevel

_tables = sa.MetaData()
_missions = sa.Table(
    "missions",
    _tables,
    sa.Column("mission", sa.String, primary_key=True),
    sa.Column("document", sa.JSON, nullable=False),
)
_images = sa.Table(
    "images",
    _tables,
    sa.Column("id", sa.String, primary_key=True),
    sa.Column("mission", sa.String, nullable=False, index=True),
    sa.Column("stop", sa.String, nullable=False, index=True),
    sa.Column("sol", sa.Integer, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)
_layers = sa.Table(
    "layers",
    _tables,
    sa.Column("scope", sa.String, primary_key=True),
    sa.Column("kind", sa.String, primary_key=True),
    sa.Column("digest", sa.String, primary_key=True),
    sa.Column("mission", sa.String, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)
_latest = sa.Table(
    "latest",
    _tables,
    sa.Column("scope", sa.String, primary_key=True),
    sa.Column("kind", sa.String, primary_key=True),
    sa.Column("digest", sa.String, nullable=False),
)
_outcomes = sa.Table(
    "outcomes",
    _tables,
    sa.Column("subject", sa.String, primary_key=True),
    sa.Column("document", sa.JSON, nullable=False),
)
_events = sa.Table(
    "events",
    _tables,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("kind", sa.String, nullable=False),
    sa.Column("document", sa.JSON, nullable=False),
    sa.Column("at", sa.String, nullable=False),
)


@dataclass(frozen=True, slots=True)
class MissionEntry:
    """A rover whose images are in the store, and where its map lies on Mars."""

    mission: str
    title: str
    landing: LandingPoint
    lsl_note: str | None
    """Says so when the chain of sites does not reach the lander and the LSL starts elsewhere."""


@dataclass(frozen=True, slots=True)
class ImageEntry:
    """An ingested image: what it is, whom it pairs with, and its files."""

    id: str
    mission: str
    stop: str
    site: int
    drive: int
    sol: int
    instrument: str
    eye: str
    product_type: str
    start_time: str | None
    local_solar_time: str | None
    partner: str | None
    unpaired_because: str | None
    ref: ProductRef
    browse: ProductRef
    code: str | None = None
    """The table that its pixels are coded by, where its label says so."""
    darkened_by: str | None = None
    """The camera whose fall of light is still in its pixels, where its label says so."""
    radiometry: ProductRef | None = None
    """The tables and flat fields that its pixels are read with; None: they are taken as stored."""
    notes: tuple[str, ...] = ()
    """What is peculiar about its pixels, a line each."""

    @property
    def stop_id(self) -> StopId:
        """The stop that it was taken at; `stop` is its name."""
        return StopId(self.mission, self.site, self.drive)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How the last processing of a file or sol ended."""

    subject: str
    """A file name, or a sol as `mer2-sol0156`."""
    is_failure: bool
    notes: tuple[str, ...]
    at: str
    """UTC, ISO 8601."""

    @classmethod
    def now(cls, subject: str, notes: tuple[str, ...], *, is_failure: bool = False) -> Outcome:
        """What has just ended."""
        return cls(subject, is_failure, notes, datetime.now(UTC).isoformat(timespec="seconds"))


@dataclass(frozen=True, slots=True)
class Event:
    """Something the browser wants to hear about."""

    id: int
    kind: str
    document: dict[str, Any]
    at: str


@dataclass(frozen=True, slots=True, eq=False)
class Catalogue:
    """The database of what has been published."""

    engine: sa.Engine

    @classmethod
    def open(cls, root: Path, url: str | None = None) -> Catalogue:
        """Open or found the catalogue of the store at `root`, or at a database URL."""
        engine = sa.create_engine(url or f"sqlite:///{root / 'catalogue.sqlite'}")
        if engine.dialect.name == "sqlite":
            sa.event.listen(engine, "connect", _configure_sqlite)
        _tables.create_all(engine)
        return cls(engine)

    def missions(self) -> list[MissionEntry]:
        """All missions, by name."""
        rows = self._documents(sa.select(_missions.c.document).order_by(_missions.c.mission))
        return [MissionEntry(**{**row, "landing": LandingPoint(**row["landing"])}) for row in rows]

    def mission(self, name: str) -> MissionEntry:
        """One mission.

        Raises:
            ProductNotFoundError: nothing of that mission is in the store.
        """
        for entry in self.missions():
            if entry.mission == name:
                return entry
        raise ProductNotFoundError(f"no mission {name!r} is in the store")

    def images(
        self, mission: str | None = None, stop: str | None = None, sol: int | None = None
    ) -> list[ImageEntry]:
        """Images, by identifier; all, or those of a mission, stop or sol."""
        query = sa.select(_images.c.document).order_by(_images.c.id)
        for column, value in (
            (_images.c.mission, mission),
            (_images.c.stop, stop),
            (_images.c.sol, sol),
        ):
            if value is not None:
                query = query.where(column == value)
        return [_image_entry(row) for row in self._documents(query)]

    def image(self, image_id: str) -> ImageEntry:
        """One image.

        Raises:
            ProductNotFoundError: no such image has been ingested.
        """
        query = sa.select(_images.c.document).where(_images.c.id == image_id)
        for row in self._documents(query):
            return _image_entry(row)
        raise ProductNotFoundError(f"no image {image_id!r} has been ingested")

    def images_version(self, mission: str) -> str:
        """Changes whenever an image of a mission is ingested, anew or for the first time."""
        query = sa.select(sa.func.count(), sa.func.max(sa.literal_column("rowid")))
        query = query.select_from(_images).where(_images.c.mission == mission)
        with self.engine.connect() as connection:
            count, last = connection.execute(query).one()
        return f"{count}-{last or 0}"

    def layers(
        self, mission: str | None = None, kinds: Collection[ProductKind] | None = None
    ) -> list[Layer]:
        """The latest layer of every scope and kind; all, or those of a mission or of some kinds."""
        query = sa.select(_layers.c.document).join(
            _latest,
            (_latest.c.scope == _layers.c.scope)
            & (_latest.c.kind == _layers.c.kind)
            & (_latest.c.digest == _layers.c.digest),
        )
        if mission is not None:
            query = query.where(_layers.c.mission == mission)
        if kinds is not None:
            query = query.where(_layers.c.kind.in_([str(kind) for kind in kinds]))
        query = query.order_by(_layers.c.scope, _layers.c.kind)
        return [_layer(row) for row in self._documents(query)]

    def layer(self, scope: str, kind: ProductKind, digest: str | None = None) -> Layer:
        """One layer: the version with `digest`, or the latest.

        Raises:
            ProductNotFoundError: no such layer has been published.
        """
        query = sa.select(_layers.c.document).where(
            _layers.c.scope == scope, _layers.c.kind == str(kind)
        )
        if digest is None:
            newest = sa.select(_latest.c.digest).where(
                _latest.c.scope == scope, _latest.c.kind == str(kind)
            )
            query = query.where(_layers.c.digest == newest.scalar_subquery())
        else:
            query = query.where(_layers.c.digest == digest)
        for row in self._documents(query):
            return _layer(row)
        version = f" with digest {digest}" if digest else ""
        raise ProductNotFoundError(f"no {kind} of {scope}{version} has been published")

    def latest(self, scope: str, kind: ProductKind) -> str | None:
        """The digest that the pointer of a scope and kind is at, published as a layer or not."""
        query = sa.select(_latest.c.digest).where(
            _latest.c.scope == scope, _latest.c.kind == str(kind)
        )
        with self.engine.connect() as connection:
            return connection.execute(query).scalar_one_or_none()

    def pointers(self, kind: ProductKind) -> list[ProductRef]:
        """What the pointers of a kind are at, by scope: inputs and stages that are no layers."""
        query = sa.select(_latest).where(_latest.c.kind == str(kind)).order_by(_latest.c.scope)
        level = LEVEL[kind]
        with self.engine.connect() as connection:
            return [
                ProductRef(kind, Scope(level, row.scope), row.digest)
                for row in connection.execute(query)
            ]

    def outcomes(self) -> list[Outcome]:
        """How the last processing of every file and sol ended, by subject."""
        rows = self._documents(sa.select(_outcomes.c.document).order_by(_outcomes.c.subject))
        return [Outcome(**{**row, "notes": tuple(row["notes"])}) for row in rows]

    def events_since(self, event_id: int) -> list[Event]:
        """Events after `event_id`, oldest first."""
        query = sa.select(_events).where(_events.c.id > event_id).order_by(_events.c.id)
        with self.engine.connect() as connection:
            return [Event(**row._mapping) for row in connection.execute(query)]  # noqa: SLF001 - documented name

    def publish(
        self,
        *,
        missions: Iterable[MissionEntry] = (),
        images: Iterable[ImageEntry] = (),
        layers: Sequence[Layer] = (),
        pointers: Iterable[ProductRef] = (),
        outcomes: Iterable[Outcome] = (),
    ) -> None:
        """Publish all of it in one transaction; `pointers` are products that are no map layers."""
        with self.engine.begin() as connection:
            for entry in missions:
                _put(connection, _missions, {"mission": entry.mission}, _document(entry))
            for image in images:
                columns = {"mission": image.mission, "stop": image.stop, "sol": image.sol}
                _put(connection, _images, {"id": image.id}, _document(image), **columns)
            fresh = [layer for layer in layers if _point(connection, layer.ref)]
            for layer in layers:
                keys = _keys(layer.ref) | {"digest": layer.ref.digest}
                _put(connection, _layers, keys, _document(layer), mission=layer.mission)
            for ref in pointers:
                _point(connection, ref)
            for outcome in outcomes:
                _put(connection, _outcomes, {"subject": outcome.subject}, _document(outcome))
            if fresh:
                document = {"layers": [layer.id for layer in fresh]}
                now = datetime.now(UTC).isoformat(timespec="milliseconds")
                connection.execute(
                    _events.insert().values(kind="layers.published", document=document, at=now)
                )

    def _documents(self, query: sa.Select[Any]) -> list[dict[str, Any]]:
        with self.engine.connect() as connection:
            return [row[0] for row in connection.execute(query)]


def _configure_sqlite(connection: DBAPIConnection, _record: object) -> None:
    """Readers never wait for a writer, and two writers wait for each other."""
    for pragma in ("journal_mode=WAL", "busy_timeout=30000", "synchronous=NORMAL"):
        connection.cursor().execute(f"PRAGMA {pragma}")


def _keys(ref: ProductRef) -> dict[str, str]:
    return {"scope": ref.scope.name, "kind": str(ref.kind)}


def _put(
    connection: sa.Connection,
    table: sa.Table,
    keys: dict[str, Any],
    document: dict[str, Any],
    **columns: Any,  # noqa: ANN401 - column values
) -> None:
    where = sa.and_(*(table.c[name] == value for name, value in keys.items()))
    connection.execute(table.delete().where(where))
    connection.execute(table.insert().values(**keys, **columns, document=document))


def _point(connection: sa.Connection, ref: ProductRef) -> bool:
    """Move the pointer of a scope and kind; whether it moved."""
    keys = _keys(ref)
    where = sa.and_(_latest.c.scope == keys["scope"], _latest.c.kind == keys["kind"])
    before = connection.execute(sa.select(_latest.c.digest).where(where)).scalar_one_or_none()
    if before == ref.digest:
        return False
    connection.execute(_latest.delete().where(where))
    connection.execute(_latest.insert().values(**keys, digest=ref.digest))
    return True


def _document(entry: Any) -> dict[str, Any]:  # noqa: ANN401 - any record of this module
    return dataclasses.asdict(entry)


def _ref(document: dict[str, Any]) -> ProductRef:
    scope = Scope(ScopeLevel(document["scope"]["level"]), document["scope"]["name"])
    return ProductRef(ProductKind(document["kind"]), scope, document["digest"])


def _image_entry(row: dict[str, Any]) -> ImageEntry:
    refs = {name: _ref(row[name]) for name in ("ref", "browse", "radiometry") if row.get(name)}
    return ImageEntry(**{**row, **refs, "notes": tuple(row.get("notes", ()))})


def _layer(row: dict[str, Any]) -> Layer:
    tuples = {name: tuple(row[name]) for name in ("bounds", "sols")}
    value_range = tuple(row["range"]) if row["range"] else None
    return Layer(**{**row, **tuples, "range": value_range, "ref": _ref(row["ref"])})
