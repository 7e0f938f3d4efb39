"""Edits of ties and annotations: a log that is read by all and appended to by analysts."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from solmap.gis_server.collaboration.accounts import Analyst
from solmap.gis_server.parameters import LARGEST_ID, REVALIDATE, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.edits import Edit, EditConflictError, EditKind
from solmap.products.catalogue.events import EDITS_CHANGED
from solmap.products.formats.documents.edit_requests import parse_edit_requests
from solmap.products.formats.raster.tiling import HALF_SIDE_M

router = APIRouter(prefix="/api/missions/{mission}", tags=["edits"])
Number = Annotated[int, Path(ge=1, le=LARGEST_ID)]
Note = Annotated[str, Field(max_length=2000, description="why")]
Pixel = Annotated[float, Field(ge=-1.0, le=1e5, allow_inf_nan=False)]
Name = Annotated[str, Field(max_length=128, pattern=r"^[A-Za-z0-9_.-]*$")]
Metres = Annotated[float, Field(ge=-HALF_SIDE_M, le=HALF_SIDE_M, allow_inf_nan=False)]
Place = tuple[Metres, Metres] | tuple[Metres, Metres, Metres]
_MOST_POINTS = 10_000


class TieEdit(BaseModel):
    """A tie to add, veto or move; the columns of a file of manual ties (`solmap ties`)."""

    model_config = ConfigDict(extra="forbid")

    action: Literal["add", "veto", "move"]
    first_image: Name
    first_sample: Pixel | None = None
    first_line: Pixel | None = None
    first_right_sample: Pixel | None = None
    first_right_line: Pixel | None = None
    second_image: Name = ""
    second_sample: Pixel | None = None
    second_line: Pixel | None = None
    second_right_sample: Pixel | None = None
    second_right_line: Pixel | None = None
    sigma_px: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    tolerance_px: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    note: Note = ""


class Point(BaseModel):
    """A place, metres of the local map: east, north and up if known."""

    type: Literal["Point"]
    coordinates: Place


class Line(BaseModel):
    """A line through places."""

    type: Literal["LineString"]
    coordinates: Annotated[list[Place], Field(min_length=2, max_length=_MOST_POINTS)]


class Ring(BaseModel):
    """An area: closed rings, the outer first."""

    type: Literal["Polygon"]
    coordinates: Annotated[
        list[Annotated[list[Place], Field(min_length=4, max_length=_MOST_POINTS)]],
        Field(min_length=1, max_length=100),
    ]


class Annotation(BaseModel):
    """A place, line or area with a text."""

    model_config = ConfigDict(extra="forbid")

    geometry: Annotated[Point | Line | Ring, Field(discriminator="type")]
    text: Annotated[str, Field(min_length=1, max_length=4000)]
    category: Literal["note", "target", "waypoint", "keep-out", "measurement"] = "note"
    state: Annotated[
        Literal["draft", "published"],
        Field(description="drafts are on the map, not in OGC services and downloads"),
    ] = "published"
    replaces: Annotated[
        int | None, Field(ge=1, le=LARGEST_ID, description="annotation that this one replaces")
    ] = None
    colour: Annotated[str, Field(pattern=r"^#[0-9a-f]{6}$")] | None = None
    note: Note = ""


class Undo(BaseModel):
    """Reason for revoking an edit."""

    model_config = ConfigDict(extra="forbid")

    note: Note = ""


class EditBody(BaseModel):
    """A row of the log."""

    id: int
    kind: EditKind
    document: dict[str, Any]
    author: str
    at: str
    note: str
    undoes: int | None
    counts: bool
    """Whether it has not been undone; edits of ties with effect are applied by the next run."""


@router.get("/edits")
def edits(
    mission: MissionName,
    services: ServicesOf,
    response: Response,
    kind: EditKind | None = None,
    counting: Annotated[bool, Query(description="omit revoked edits")] = False,  # noqa: FBT002
) -> list[EditBody]:
    """All edits, oldest first."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    return [
        _body(edit)
        for edit in services.edits.edits(mission)
        if (kind is None or edit.kind is kind) and (edit.counts or not counting)
    ]


@router.post("/edits/ties", status_code=201)
def edit_tie(mission: MissionName, edit: TieEdit, services: ServicesOf, who: Analyst) -> EditBody:
    """Request that a tie be added, vetoed or moved by the next run."""
    services.catalogue.mission(mission)
    request = edit.model_dump(exclude={"note"}, exclude_none=True)
    document = {"features": [{"properties": request}]}
    (tie,) = parse_edit_requests(json.dumps(document), "edit")  # MatchingError answers 422
    for point in (tie.first, tie.second):
        if point.image:
            _check_known(point.image, mission, services, is_stop=point.is_stop)
    return _announce(
        services.edits.append(mission, EditKind.TIE, request, who.name, edit.note), services
    )


@router.post("/edits/annotations", status_code=201)
def annotate(
    mission: MissionName, annotation: Annotation, services: ServicesOf, who: Analyst
) -> EditBody:
    """Write an annotation, or replace an earlier one."""
    services.catalogue.mission(mission)
    document = annotation.model_dump(exclude={"note"}, exclude_none=True)
    if annotation.replaces is None:
        edit = services.edits.append(
            mission, EditKind.ANNOTATION, document, who.name, annotation.note
        )
    else:
        with _conflicts_answered():
            edit = services.edits.replace(
                mission, annotation.replaces, document, who.name, annotation.note
            )
    return _announce(edit, services)


@router.post("/edits/{number}/undo", status_code=201)
def undo(
    mission: MissionName, number: Number, reason: Undo, services: ServicesOf, who: Analyst
) -> EditBody:
    """Revoke an edit; it stays in the log. Revoking the revocation makes it count again."""
    services.catalogue.mission(mission)
    with _conflicts_answered():
        edit = services.edits.undo(mission, number, who.name, reason.note)
    return _announce(edit, services)


@contextmanager
def _conflicts_answered() -> Iterator[None]:
    try:
        yield
    except EditConflictError as error:
        raise HTTPException(409, str(error)) from error


@router.get("/annotations")
def list_annotations(
    mission: MissionName, services: ServicesOf, response: Response
) -> dict[str, Any]:
    """The valid annotations, as GeoJSON in metres of the local map."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    found = services.edits.effective(EditKind.ANNOTATION, mission)
    return {"type": "FeatureCollection", "features": [_feature(edit) for edit in found]}


def _feature(edit: Edit) -> dict[str, Any]:
    known = {name: value for name, value in edit.document.items() if name != "geometry"}
    known = {"category": "note", "state": "published", **known}  # older ones have neither
    written = {"author": edit.author, "at": edit.at, "note": edit.note}
    return {
        "type": "Feature",
        "id": str(edit.id),
        "geometry": edit.document["geometry"],
        "properties": {**known, **written},
    }


def _check_known(name: str, mission: str, services: Services, *, is_stop: bool) -> None:
    """Refuse unknown images and stops: an edit with a typing error would wait forever."""
    known = (
        bool(services.catalogue.images(mission, stop=name))
        if is_stop
        else services.catalogue.image(name).mission == mission
    )
    if not known:
        raise HTTPException(422, f"{mission} has no {'stop' if is_stop else 'image'} {name}")


def _announce(edit: Edit, services: Services) -> EditBody:
    document = {"mission": edit.mission, "edit": edit.id, "kind": str(edit.kind)}
    services.catalogue.append_event(EDITS_CHANGED, document)
    return _body(edit)


def _body(edit: Edit) -> EditBody:
    return EditBody.model_validate(edit, from_attributes=True)
