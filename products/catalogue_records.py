"""The records of the catalogue, and the documents that they are kept as."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from solmap.photogrammetry.imagery import StopId
from solmap.products.crs import LandingPoint
from solmap.products.model import Layer, ProductKind, ProductRef, Scope, ScopeLevel


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
    created: str | None = None
    """When its file was made on Earth, as its label says."""

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
