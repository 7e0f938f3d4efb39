"""The catalogue: missions, images and layers, with the latest version of each.

One transaction publishes everything that belongs together; readers see all of it or nothing. The
catalogue is a database (SQLite in the store's folder unless another URL is given), the products are
files. Records are kept as JSON documents: references, and what the map needs without opening files.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from solmap.products.catalogue import schema
from solmap.products.catalogue.database import (
    FINISHED,
    IMAGES,
    LATEST,
    LAYERS,
    MISSIONS,
    OUTCOMES,
    count_ingested,
    engine_of,
    move_pointer,
    pointer_keys,
    put_document,
    times_ingested,
    write_transaction,
)
from solmap.products.catalogue.events import (
    IMAGES_INGESTED,
    LAYERS_PUBLISHED,
    MISSION_CHANGED,
    PUBLICATIONS,
    Event,
    append,
    events_since,
    last_event,
)
from solmap.products.crs import LandingPoint
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.model import Layer, ProductKind, ProductRef, Scope, ScopeLevel, mission_of

if TYPE_CHECKING:
    from solmap.photogrammetry.imagery import StopId
    from solmap.photogrammetry.terrain.dtm.grid import Bounds


@dataclass(frozen=True, slots=True)
class MissionEntry:
    """A map of a rover whose images are in the store, and its position on Mars.

    Sites tied to the lander are on the map with the name of the mission; every other group of sites
    has its own map (`products.model.untied_map`).
    """

    mission: str
    """Name of the map."""
    title: str
    landing: LandingPoint
    lsl_note: str | None
    """Reason why the map is not tied to the lander; empty if it is."""


@dataclass(frozen=True, slots=True)
class ImageEntry:
    """An ingested image: identifiers, stereo partner, and files."""

    id: str
    mission: str
    """Name of the map of its stop, as in `MissionEntry`."""
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
    """The table by which its pixels are coded, if its label names one."""
    darkened_by: str | None = None
    """The camera whose vignetting is still in its pixels, according to its label."""
    radiometry: ProductRef | None = None
    """The tables and flat fields with which its pixels are read; None: pixels as stored."""
    notes: tuple[str, ...] = ()
    """Notes on its pixels, one per line."""
    created: str | None = None
    """Time at which its file was made on Earth, according to its label."""
    repeats: str | None = None
    """The image of the same exposure that is used instead: both differ in processing, version or
    size, and are one observation."""

    @property
    def stop_id(self) -> StopId:
        """The stop of the image; `stop` is its name."""
        from solmap.photogrammetry.imagery import StopId  # noqa: PLC0415 - lists need no arrays

        return StopId(mission_of(self.mission), self.site, self.drive)


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
        """The outcome of processing that ended now."""
        return cls(subject, is_failure, notes, datetime.now(UTC).isoformat(timespec="seconds"))


def document_of(entry: Any) -> dict[str, Any]:  # noqa: ANN401 - any record of this module
    """A record as plain JSON values."""
    return dataclasses.asdict(entry)


def mission_entry(row: dict[str, Any]) -> MissionEntry:
    """A mission from its document."""
    return MissionEntry(**{**row, "landing": LandingPoint(**row["landing"])})


def outcome_of(row: dict[str, Any]) -> Outcome:
    """An outcome from its document."""
    return Outcome(**{**row, "notes": tuple(row["notes"])})


def image_entry(row: dict[str, Any]) -> ImageEntry:
    """An image from its document."""
    refs = {name: _ref(row[name]) for name in ("ref", "browse", "radiometry") if row.get(name)}
    return ImageEntry(**{**row, **refs, "notes": tuple(row.get("notes", ()))})


def layer_of(row: dict[str, Any]) -> Layer:
    """A layer from its document."""
    tuples = {name: tuple(row[name]) for name in ("bounds", "sols")}
    value_range = tuple(row["range"]) if row["range"] else None
    return Layer(**{**row, **tuples, "range": value_range, "ref": _ref(row["ref"])})


def _ref(document: dict[str, Any]) -> ProductRef:
    scope = Scope(ScopeLevel(document["scope"]["level"]), document["scope"]["name"])
    return ProductRef(ProductKind(document["kind"]), scope, document["digest"])


@dataclass(frozen=True, slots=True)
class Part:
    """Requested rows of a list."""

    limit: int | None = None
    offset: int = 0

    def of(self, query: sa.Select[Any]) -> sa.Select[Any]:
        """The query of these rows alone."""
        return query if self.limit is None else query.limit(self.limit).offset(self.offset)


WHOLE = Part()


def _image_terms(
    mission: str | None, stop: str | None, sol: int | None
) -> list[sa.ColumnElement[bool]]:
    conditions = ((IMAGES.c.mission, mission), (IMAGES.c.stop, stop), (IMAGES.c.sol, sol))
    return [column == value for column, value in conditions if value is not None]


def _latest(
    query: sa.Select[Any],
    mission: str | None,
    kinds: Collection[ProductKind] | None = None,
    types: Collection[str] | None = None,
) -> sa.Select[Any]:
    """A query of the latest versions of layers."""
    query = query.select_from(LAYERS).join(
        LATEST,
        (LATEST.c.scope == LAYERS.c.scope)
        & (LATEST.c.kind == LAYERS.c.kind)
        & (LATEST.c.digest == LAYERS.c.digest),
    )
    if mission is not None:  # not by its index: rows come in the order of the key, unsorted
        query = query.where(LAYERS.c.mission.concat("") == mission)
    if kinds is not None:
        query = query.where(LAYERS.c.kind.in_([str(kind) for kind in kinds]))
    if types is not None:
        query = query.where(LAYERS.c.document["type"].as_string().in_(types))
    return query


@dataclass(frozen=True, slots=True, eq=False)
class Catalogue:
    """The database of what has been published."""

    engine: sa.Engine

    @classmethod
    def open(cls, root: Path, url: str | None = None) -> Catalogue:
        """Open or create the catalogue of the store at `root`, or at a database URL.

        An older one is migrated first; where writing is not permitted, it is read unchanged.

        Raises:
            ProductError: the URL cannot be used, its database does not answer, or the store is of
                a newer version.
        """
        engine = engine_of(root / schema.CATALOGUE, url)
        schema.prepare(root, engine)
        return cls(engine)

    def missions(self) -> list[MissionEntry]:
        """All missions, by name."""
        rows = self._documents(sa.select(MISSIONS.c.document).order_by(MISSIONS.c.mission))
        return [mission_entry(row) for row in rows]

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
        self,
        mission: str | None = None,
        stop: str | None = None,
        sol: int | None = None,
        part: Part = WHOLE,
    ) -> list[ImageEntry]:
        """Images, by identifier; all, or those of a mission, stop or sol."""
        query = part.of(sa.select(IMAGES.c.document).order_by(IMAGES.c.id))
        query = query.where(*_image_terms(mission, stop, sol))
        return [image_entry(row) for row in self._documents(query)]

    def image_count(self, mission: str, stop: str | None = None, sol: int | None = None) -> int:
        """How many images `images` lists."""
        query = sa.select(sa.func.count()).select_from(IMAGES)
        with self.engine.connect() as connection:
            terms = _image_terms(mission, stop, sol)
            return int(connection.execute(query.where(*terms)).scalar_one())

    def image(self, image_id: str) -> ImageEntry:
        """One image.

        Raises:
            ProductNotFoundError: no such image has been ingested.
        """
        query = sa.select(IMAGES.c.document).where(IMAGES.c.id == image_id)
        for row in self._documents(query):
            return image_entry(row)
        raise ProductNotFoundError(f"no image {image_id!r} has been ingested")

    def maps_of(self, mission: str) -> list[str]:
        """The names of all maps of a mission with images, by name."""
        query = sa.select(IMAGES.c.mission).distinct().order_by(IMAGES.c.mission)
        with self.engine.connect() as connection:
            names = connection.execute(query).scalars()
            return [name for name in names if mission_of(name) == mission]

    def images_version(self, mission: str) -> str:
        """Changes whenever an image on a map is ingested, again or for the first time."""
        query = sa.select(sa.func.count()).select_from(IMAGES).where(IMAGES.c.mission == mission)
        with self.engine.connect() as connection:
            count = connection.execute(query).scalar_one()
            return f"{count}-{times_ingested(connection, mission)}"

    def layers(
        self,
        mission: str | None = None,
        kinds: Collection[ProductKind] | None = None,
        types: Collection[str] | None = None,
        part: Part = WHOLE,
    ) -> list[Layer]:
        """The latest layer of every scope and kind; all, or those of a mission, kinds or types."""
        query = _latest(sa.select(LAYERS.c.document), mission, kinds, types)
        query = part.of(query.order_by(LATEST.c.scope, LATEST.c.kind))
        return [layer_of(row) for row in self._documents(query)]

    def layer_count(self, mission: str, types: Collection[str] | None = None) -> int:
        """How many layers of a mission `layers` lists."""
        query = _latest(sa.select(sa.func.count()), mission, None, types)
        with self.engine.connect() as connection:
            return int(connection.execute(query).scalar_one())

    def extent(self, mission: str) -> Bounds | None:
        """(west, south, east, north) of all latest layers, metres; None where there are none."""
        west, south, east, north = (
            LAYERS.c.document["bounds"][side].as_float() for side in range(4)
        )
        low, high = sa.func.min, sa.func.max
        query = _latest(sa.select(low(west), low(south), high(east), high(north)), mission)
        # a layer without features is published as 0 0 0 0
        query = query.where(sa.or_(west != 0, south != 0, east != 0, north != 0))
        with self.engine.connect() as connection:
            sides = connection.execute(query).one()
        return None if sides[0] is None else (sides[0], sides[1], sides[2], sides[3])

    def layer(self, scope: str, kind: ProductKind, digest: str | None = None) -> Layer:
        """One layer: the version with `digest`, or the latest.

        Raises:
            ProductNotFoundError: no such layer has been published.
        """
        query = sa.select(LAYERS.c.document).where(
            LAYERS.c.scope == scope, LAYERS.c.kind == str(kind)
        )
        if digest is None:
            newest = sa.select(LATEST.c.digest).where(
                LATEST.c.scope == scope, LATEST.c.kind == str(kind)
            )
            query = query.where(LAYERS.c.digest == newest.scalar_subquery())
        else:
            query = query.where(LAYERS.c.digest == digest)
        for row in self._documents(query):
            return layer_of(row)
        version = f" with digest {digest}" if digest else ""
        raise ProductNotFoundError(f"no {kind} of {scope}{version} has been published")

    def latest(self, scope: str, kind: ProductKind) -> str | None:
        """The digest of the latest product of a scope and kind, published as a layer or not."""
        query = sa.select(LATEST.c.digest).where(
            LATEST.c.scope == scope, LATEST.c.kind == str(kind)
        )
        with self.engine.connect() as connection:
            return connection.execute(query).scalar_one_or_none()

    def pointers(self, kind: ProductKind) -> list[ProductRef]:
        """The latest products of a kind, by scope: inputs and stages that are not layers.

        Raises:
            ProductError: products of this kind are layers.
        """
        query = sa.select(LATEST).where(LATEST.c.kind == str(kind)).order_by(LATEST.c.scope)
        if kind.level is None:
            raise ProductError(f"{kind} is published as layers; use these")
        with self.engine.connect() as connection:
            return [
                ProductRef(kind, Scope(kind.level, row.scope), row.digest)
                for row in connection.execute(query)
            ]

    def outcomes(self) -> list[Outcome]:
        """Outcome of the last processing of every file and sol, by subject."""
        rows = self._documents(sa.select(OUTCOMES.c.document).order_by(OUTCOMES.c.subject))
        return [outcome_of(row) for row in rows]

    def events_since(self, event_id: int) -> list[Event]:
        """Events after `event_id`, oldest first."""
        with self.engine.connect() as connection:
            return events_since(connection, event_id)

    def version(self) -> int:
        """The number of the last event: published content changes only when it does."""
        with self.engine.connect() as connection:
            return last_event(connection)

    def published_version(self) -> int:
        """Like `version`, but unchanged by the progress of runs and by edits."""
        # progress events may be deleted, so only newer events of other kinds are counted
        with self.engine.connect() as connection:
            return last_event(connection, PUBLICATIONS) or last_event(connection)

    def append_event(self, kind: str, document: dict[str, Any]) -> None:
        """Append an event that belongs to no other change of the catalogue."""
        with write_transaction(self.engine) as connection:
            append(connection, kind, document)

    def publish(
        self,
        *,
        missions: Iterable[MissionEntry] = (),
        images: Iterable[ImageEntry] = (),
        layers: Sequence[Layer] = (),
        pointers: Iterable[ProductRef] = (),
        outcomes: Iterable[Outcome] = (),
    ) -> None:
        """Publish all in one transaction; `pointers` are products that are not map layers."""
        with write_transaction(self.engine) as connection:
            for entry in missions:
                if put_document(
                    connection, MISSIONS, {"mission": entry.mission}, document_of(entry)
                ):
                    append(connection, MISSION_CHANGED, {"mission": entry.mission})
            _put_images(connection, list(images))
            _put_layers(connection, layers)
            for ref in pointers:
                move_pointer(connection, ref)
            for outcome in outcomes:
                put_document(
                    connection, OUTCOMES, {"subject": outcome.subject}, document_of(outcome)
                )

    def withdraw(self, layers: Sequence[Layer], pointers: Sequence[ProductRef] = ()) -> None:
        """Remove layers from the map, all at once; their versions stay known.

        `pointers` are products that are not layers, and no longer the latest of their kind.
        """
        with write_transaction(self.engine) as connection:
            _withdraw(connection, layers)
            for ref in pointers:
                connection.execute(LATEST.delete().where(_is_latest(ref)))

    def forget_sols(self, name: str, kept: Collection[str]) -> None:
        """Forget how sols went that are no longer on a map: when they are again, they are made.

        `kept` are the names of those on the map.
        """
        with write_transaction(self.engine) as connection:
            for table, column in ((FINISHED, FINISHED.c.scope), (OUTCOMES, OUTCOMES.c.subject)):
                of_map = column.startswith(f"{name.lower()}-sol", autoescape=True)
                connection.execute(table.delete().where(of_map & column.not_in(kept)))

    def forget_map(self, name: str) -> None:
        """Delete a map without images."""
        self.forget_sols(name, kept=())
        with write_transaction(self.engine) as connection:
            if connection.execute(MISSIONS.delete().where(MISSIONS.c.mission == name)).rowcount:
                append(connection, MISSION_CHANGED, {"mission": name})

    def _documents(self, query: sa.Select[Any]) -> list[dict[str, Any]]:
        with self.engine.connect() as connection:
            return [row[0] for row in connection.execute(query)]


def _put_images(connection: sa.Connection, images: Sequence[ImageEntry]) -> None:
    counts: dict[str, int] = {}
    for image in images:
        columns = {"mission": image.mission, "stop": image.stop, "sol": image.sol}
        if put_document(connection, IMAGES, {"id": image.id}, document_of(image), **columns):
            counts[image.mission] = counts.get(image.mission, 0) + 1
    for mission, count in counts.items():
        count_ingested(connection, mission, count)
        append(connection, IMAGES_INGESTED, {"mission": mission, "images": count})


def _put_layers(connection: sa.Connection, layers: Sequence[Layer]) -> None:
    fresh: dict[str, list[str]] = {}
    for layer in layers:
        has_moved = move_pointer(connection, layer.ref)
        keys = pointer_keys(layer.ref) | {"digest": layer.ref.digest}
        is_new = put_document(connection, LAYERS, keys, document_of(layer), mission=layer.mission)
        if has_moved or is_new:
            fresh.setdefault(layer.mission, []).append(layer.id)
    for mission, ids in fresh.items():
        append(connection, LAYERS_PUBLISHED, {"mission": mission, "layers": ids})


def _withdraw(connection: sa.Connection, layers: Sequence[Layer]) -> None:
    gone: dict[str, list[str]] = {}
    for layer in layers:
        if connection.execute(LATEST.delete().where(_is_latest(layer.ref))).rowcount:
            gone.setdefault(layer.mission, []).append(layer.id)
    for mission, ids in gone.items():
        append(connection, LAYERS_PUBLISHED, {"mission": mission, "layers": ids})


def _is_latest(ref: ProductRef) -> sa.ColumnElement[bool]:
    keys = pointer_keys(ref)
    return sa.and_(
        LATEST.c.scope == keys["scope"],
        LATEST.c.kind == keys["kind"],
        LATEST.c.digest == ref.digest,
    )


def published_networks(mission: str, catalogue: Catalogue) -> list[ProductRef]:
    """The published networks of a mission, the latest last.

    Names sort by sol, an overall adjustment after that of its sol.
    """
    prefix = f"{mission.lower()}-sol"
    refs = [r for r in catalogue.pointers(ProductKind.NETWORK) if r.scope.name.startswith(prefix)]
    return sorted(refs, key=lambda ref: ref.scope.name)


def latest_network(mission: str, catalogue: Catalogue) -> ProductRef:
    """The network of a mission that was published last.

    Raises:
        ProductNotFoundError: there is none.
    """
    refs = published_networks(mission, catalogue)
    if not refs:
        raise ProductNotFoundError(
            f"no network of {mission} has been adjusted yet, so no image has a position; run a sol"
        )
    return refs[-1]
