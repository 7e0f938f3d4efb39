"""The query of a request for features, read and checked; what is unknown or wrong answers 400."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

from fastapi import HTTPException, Query, Request

from solmap.gis_server.ogc.crs import Crs, area_of, bbox_of, crs_named
from solmap.gis_server.ogc.formats import FILES, Format
from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.products.crs import LandingPoint
from solmap.products.features.index import Extent, Selection
from solmap.products.features.mission_features import moment

DEFAULT_LIMIT, MOST = 100, 10_000
"""Features of a page."""
MOST_IN_FILE = 1_000_000
_OPEN = ("", "..")
_KNOWN = {"f", "crs", "bbox", "bbox-crs", "datetime", "sol", "limit", "offset"}
_LONGEST = 256
"""Characters of the value of a property."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a request for features asks for, before the features are looked at."""

    form: Format
    crs: Crs
    box: Bounds | None
    box_crs: Crs
    times: tuple[str | None, str | None] | None
    sols: tuple[int | None, int | None] | None
    limit: int
    offset: int
    equal: Mapping[str, str]

    def selection(
        self, keys: list[str], landing: LandingPoint, extent: Extent, *, all_placed: bool
    ) -> Selection | None:
        """The features asked for; None where there cannot be any.

        An area that holds all of them, each of which has a place, need not be looked for.
        """
        area = None
        if self.box is not None:
            here = extent.bounds
            area = area_of(self.box, self.box_crs, landing, here) if here else None
            if area is None or here is None:
                return None
            if all_placed and _holds(area.inner, here):
                area = None
        return Selection(keys, area, self.sols, self.times, self.equal)


def _holds(outer: Bounds, inner: Bounds) -> bool:
    return (
        outer[0] <= inner[0]
        and outer[1] <= inner[1]
        and inner[2] <= outer[2]
        and inner[3] <= outer[3]
    )


def form_of(request: Request, f: str | None) -> Format:
    """The format: what `f` says, else a page for browsers and GeoJSON for others."""
    if f:
        if f not in set(Format):
            raise HTTPException(400, f"f={f} is none of {', '.join(Format)}")
        return Format(f)
    return Format.HTML if "text/html" in request.headers.get("accept", "") else Format.JSON


class FeaturesQuery:
    """The parameters of `items`, as FastAPI describes them to users."""

    def __init__(  # noqa: PLR0913, PLR0917 - one for each parameter of the standard
        self,
        request: Request,
        f: Annotated[str | None, Query(description=", ".join(Format))] = None,
        bbox: Annotated[str | None, Query(description="two corners, axes as of bbox-crs")] = None,
        bbox_crs: Annotated[str | None, Query(alias="bbox-crs")] = None,
        crs: Annotated[str | None, Query(description="one of the collection's `crs`")] = None,
        datetime: Annotated[
            str | None, Query(description="a moment, or first/last; `..` leaves an end open")
        ] = None,
        sol: Annotated[str | None, Query(description="a sol, or first/last; likewise")] = None,
        limit: Annotated[str | None, Query(description=f"at most {MOST}")] = None,
        offset: Annotated[str | None, Query(description="how many are left out")] = None,
    ) -> None:
        """Other parameters are taken for names of properties, which features must have."""
        self.request = request
        self._told = (f, bbox, bbox_crs, crs, datetime, sol, limit, offset)

    def read(self, base: str, fields: Callable[[], Mapping[str, str]]) -> Asked:
        """Check them all against what is spoken and what properties there are."""
        f, bbox, bbox_crs, crs, datetime, sol, limit, offset = self._told
        form = form_of(self.request, f)
        box_crs = crs_named(bbox_crs, "bbox-crs", base)
        usual = MOST_IN_FILE if form in FILES else DEFAULT_LIMIT
        most = MOST_IN_FILE if form in FILES else MOST
        return Asked(
            form,
            crs_named(crs, "crs", base),
            bbox_of(bbox, box_crs),
            box_crs,
            _times(datetime) if datetime else None,
            _sols(sol) if sol else None,
            min(_whole("limit", limit, 1, usual), most),
            _whole("offset", offset, 0, 0),
            _equal(self.request, fields),
        )


def _equal(request: Request, known: Callable[[], Mapping[str, str]]) -> dict[str, str]:
    others = {name: value for name, value in request.query_params.items() if name not in _KNOWN}
    fields = known() if others else {}
    wanted = {}
    for name, value in others.items():
        if name not in fields:
            raise HTTPException(
                400,
                f"{name} is neither a parameter nor a property of these features; "
                f"parameters are {', '.join(sorted(_KNOWN))}; properties {', '.join(fields)}",
            )
        if len(value) > _LONGEST:
            raise HTTPException(400, f"{name} is longer than {_LONGEST} characters")
        as_number = {"true": "1", "false": "0"} if fields[name] == "boolean" else {}
        wanted[name] = as_number.get(value, value)
    return wanted


def _whole(name: str, text: str | None, least: int, otherwise: int) -> int:
    if text is None:
        return otherwise
    if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= least):  # noqa: PLR2004
        raise HTTPException(400, f"{name}={text}: a whole number from {least} on is expected")
    return int(text)


def _span(name: str, text: str) -> tuple[str | None, str | None]:
    """The ends of `a`, `a/b`, `../b` or `a/..`."""
    first, slash, last = text.partition("/")
    ends = (None if end in _OPEN else end for end in (first, last if slash else first))
    found = tuple(ends)
    if found == (None, None) or "/" in last:
        raise HTTPException(
            400, f"{name}={text}: one value, or two with a slash between, `..` open"
        )
    return found[0], found[1]


def _times(text: str) -> tuple[str | None, str | None]:
    first, last = _span("datetime", text)
    try:
        ends = tuple(end and moment(end) for end in (first, last))
    except (ValueError, OverflowError):
        raise HTTPException(
            400, f"datetime={text}: 2004-06-11T10:00:00Z or two such with a slash are expected"
        ) from None
    if ends[0] and ends[1] and ends[0] > ends[1]:
        raise HTTPException(400, f"datetime={text}: the first is later than the last")
    return ends[0], ends[1]


def _sols(text: str) -> tuple[int | None, int | None]:
    ends = [None if end is None else _whole("sol", end, 0, 0) for end in _span("sol", text)]
    return ends[0], ends[1]
