"""OGC API Features: collections of a mission's features, page by page or as files.

Part 1 (core, GeoJSON, HTML) and Part 2 (CRS by reference), with two departures that Mars makes
necessary: the default CRS, also of extents, is longitude and latitude of Mars, not of the Earth.
Parameters that are unknown or wrong are answered with 400.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, HTTPException, Path, Query, Request, Response
from fastapi.responses import JSONResponse

from solmap.gis_server.ogc.crs import (
    Crs,
    area_of,
    bbox_of,
    crs_named,
    crs_on,
    spatial_extent,
    uri_of,
)
from solmap.gis_server.ogc.documents import (
    GEOJSON,
    HTML,
    JSON,
    Link,
    feature_page,
    items_page,
    link,
)
from solmap.gis_server.ogc.formats import (
    FILES,
    MEDIA_TYPES,
    FeaturePage,
    Format,
    as_csv,
    as_file,
    feature_text,
    geojson,
)
from solmap.gis_server.parameters import REVALIDATE, BaseOf, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.crs import LandingPoint
from solmap.products.errors import ProductNotFoundError
from solmap.products.features.collections import BY_ID, COLLECTIONS, CollectionDefinition
from solmap.products.features.index import Extent, IndexedFeature, Selection
from solmap.products.features.mission_features import moment

DEFAULT_LIMIT, MOST = 100, 10_000
"""Features of a page."""
MOST_IN_FILE = 1_000_000
_OPEN = ("", "..")
_KNOWN = {"f", "crs", "bbox", "bbox-crs", "datetime", "sol", "limit", "offset"}
_LONGEST = 256
"""Characters of the value of a property."""
router = APIRouter(prefix="/ogc/{mission}", tags=["ogc features"])
of_all = APIRouter(prefix="/ogc/collections/{mission}:{collection}", tags=["ogc features"])
"""Path among the collections of all missions."""
_PART_1 = "http://www.opengis.net/spec/ogcapi-features-1/1.0/conf"
CONFORMANCE = (
    f"{_PART_1}/core",
    f"{_PART_1}/geojson",
    f"{_PART_1}/html",
    "http://www.opengis.net/spec/ogcapi-features-2/1.0/conf/crs",
)
QUERYABLES = "http://www.opengis.net/def/rel/ogc/1.0/queryables"
CollectionId = Annotated[str, Path(pattern=r"^[a-z-]{1,64}$", examples=["tie-points"])]
FeatureId = Annotated[str, Path(pattern=r"^[A-Za-z0-9_.-]{1,160}$")]


@dataclass(frozen=True, slots=True)
class FeatureRequest:
    """Parameters of a request for features."""

    form: Format
    crs: Crs
    box: Bounds | None
    box_crs: Crs
    times: tuple[str | None, str | None] | None
    sols: tuple[int | None, int | None] | None
    limit: int
    offset: int
    equal: Mapping[str, str]

    def on(self, landing: LandingPoint) -> FeatureRequest:
        """The query of a map: in its metres if it is not tied to the lander.

        Raises:
            HTTPException: 400, such a map is requested in degrees.
        """
        crs, box_crs = crs_on(landing, self.crs), crs_on(landing, self.box_crs)
        return replace(self, crs=crs, box_crs=box_crs)

    def selection(
        self, keys: list[str], landing: LandingPoint, extent: Extent, *, all_placed: bool
    ) -> Selection | None:
        """The requested features; None where there cannot be any.

        If all features have a place and the area contains them all, no search by area is needed.
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
    """The format: of `f`, else a page for browsers and GeoJSON for others."""
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
        """Other parameters are names of properties, which features must have."""
        self.request = request
        self._given = (f, bbox, bbox_crs, crs, datetime, sol, limit, offset)

    def read(self, base: str, fields: Callable[[], Mapping[str, str]]) -> FeatureRequest:
        """Check all parameters against the supported formats and existing properties."""
        f, bbox, bbox_crs, crs, datetime, sol, limit, offset = self._given
        form = form_of(self.request, f)
        box_crs = crs_named(bbox_crs, "bbox-crs", base)
        usual = MOST_IN_FILE if form in FILES else DEFAULT_LIMIT
        most = MOST_IN_FILE if form in FILES else MOST
        return FeatureRequest(
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
    conditions = {}
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
        conditions[name] = as_number.get(value, value)
    return conditions


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


async def _collection(collection: CollectionId) -> CollectionDefinition:
    if collection not in BY_ID:
        raise ProductNotFoundError(
            f"no collection {collection!r} of features; there are {', '.join(BY_ID)}"
        )
    return BY_ID[collection]


Known = Annotated[CollectionDefinition, Depends(_collection)]


def landing_links(base: str) -> list[Link]:
    """Links to features on the landing page."""
    return [link("data", f"{base}/collections", JSON, "Collections of features")]


def collections(mission: MissionEntry, services: Services, base: str) -> list[dict[str, Any]]:
    """The collections that hold anything."""
    described = (collection(one, mission, services, base) for one in COLLECTIONS)
    return [one for one in described if "extent" in one]


def collection(
    known: CollectionDefinition, mission: MissionEntry, services: Services, base: str
) -> dict[str, Any]:
    """Description, extent in space and time, and links of a collection."""
    here = f"{base}/collections/{known.id}"
    extent = services.features.index.extent(services.features.keys(known, mission.mission))
    parts: dict[str, Any] = {}
    if extent.bounds:
        parts["spatial"] = spatial_extent(extent.bounds, mission.landing, base)
    if extent.times:
        parts["temporal"] = {"interval": [list(extent.times)]}
    files = (link("items", f"{here}/items?f={f}", MEDIA_TYPES[f], f"All as {f}") for f in FILES)
    return {
        "id": known.id,
        "title": known.title,
        "description": known.description,
        "itemType": "feature",
        **({"extent": parts} if parts else {}),
        "crs": [uri_of(crs, base) for crs in ([Crs.LOCAL] if mission.landing.origin else Crs)],
        "storageCrs": uri_of(Crs.LOCAL if mission.landing.origin else Crs.MARS, base),
        "solmap:geometry": known.geometry,
        "solmap:count": extent.count,
        "links": [
            link("self", here, JSON, "This collection"),
            link("items", f"{here}/items", GEOJSON, known.title),
            link("items", f"{here}/items?f=html", HTML, "As a page"),
            *files,
            link(QUERYABLES, f"{here}/queryables", "application/schema+json", "Properties"),
        ],
    }


@router.get("/collections/{collection}/queryables")
@of_all.get("/queryables", name="queryables_of_all")
def queryables(
    known: Known, mission: MissionName, services: ServicesOf, base: BaseOf
) -> JSONResponse:
    """The properties of the features of a collection, usable by name in queries."""
    fields = _fields(known, mission, services)
    body = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"{base}/collections/{known.id}/queryables",
        "type": "object",
        "title": known.title,
        "properties": {name: {"title": name, "type": kind} for name, kind in fields.items()},
    }
    return JSONResponse(body, headers=REVALIDATE, media_type="application/schema+json")


@router.get("/collections/{collection}/items", response_class=Response)
@of_all.get("/items", name="items_of_all", response_class=Response)
def items(
    known: Known,
    mission: MissionName,
    services: ServicesOf,
    base: BaseOf,
    query: Annotated[FeaturesQuery, Depends()],
) -> Response:
    """The features of a collection: a page of them, or as a file all that meet the conditions."""
    entry = services.catalogue.mission(mission)
    features_request = query.read(base, lambda: _fields(known, mission, services)).on(entry.landing)
    found, matched = _select(known, entry, services, features_request)
    page = _page(found, known, entry, features_request.crs, query.request)
    headers = {**REVALIDATE, "Content-Crs": f"<{uri_of(features_request.crs, base)}>"}
    media_type = MEDIA_TYPES[features_request.form]
    if features_request.form in FILES:
        name = f"{mission}_{known.id}.{features_request.form}"
        headers["content-disposition"] = f'attachment; filename="{name}"'
        is_csv = features_request.form is Format.CSV
        body = as_csv(page) if is_csv else as_file(page, features_request.form, known.id)
        return Response(body, headers=headers, media_type=media_type)
    links = _page_links(query.request, base, known, features_request, (len(found), matched))
    counts = {"numberMatched": matched, "numberReturned": len(found)}
    if features_request.form is Format.HTML:
        return Response(items_page(known, page, links, counts), headers=headers, media_type=HTML)
    now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    text = geojson(page, {"timeStamp": now, **counts, "links": links})
    return Response(text, headers=headers, media_type=GEOJSON)


@router.get("/collections/{collection}/items/{feature}", response_class=Response)
@of_all.get("/items/{feature}", name="item_of_all", response_class=Response)
def item(
    known: Known,
    feature: FeatureId,
    mission: MissionName,
    services: ServicesOf,
    base: BaseOf,
    query: Annotated[FeaturesQuery, Depends()],
) -> Response:
    """One feature."""
    entry = services.catalogue.mission(mission)
    features_request = query.read(base, dict).on(entry.landing)
    keys = services.features.keys(known, mission)
    one = services.features.index.find(keys, feature)
    if one is None:
        raise ProductNotFoundError(f"no feature {feature!r} is in {known.id}")
    page = _page([one], known, entry, features_request.crs, query.request)
    here = f"{base}/collections/{known.id}"
    links = [
        link("self", f"{here}/items/{feature}", GEOJSON),
        link("alternate", f"{here}/items/{feature}?f=html", HTML, "As a page"),
        link("collection", here, JSON, known.title),
    ]
    headers = {**REVALIDATE, "Content-Crs": f"<{uri_of(features_request.crs, base)}>"}
    if form_of(query.request, query.request.query_params.get("f")) is Format.HTML:
        return Response(feature_page(known, page, links), headers=headers, media_type=HTML)
    linked = json.dumps({"links": links})
    text = f"{feature_text(page)[0][:-1]},{linked[1:]}"
    return Response(text, headers=headers, media_type=GEOJSON)


def _fields(known: CollectionDefinition, mission: str, services: Services) -> Mapping[str, str]:
    return services.features.index.fields(services.features.keys(known, mission))


def _select(
    known: CollectionDefinition,
    entry: MissionEntry,
    services: Services,
    features_request: FeatureRequest,
) -> tuple[list[IndexedFeature], int]:
    """The features of the page, and how many there are on all pages."""
    index, keys = services.features.index, services.features.keys(known, entry.mission)
    extent = index.extent(keys)
    selection = features_request.selection(
        keys, entry.landing, extent, all_placed=not known.all_images
    )
    if selection is None:
        return [], 0
    return index.page(selection, features_request.limit, features_request.offset), index.count(
        selection
    )


def _page(
    found: Sequence[IndexedFeature],
    known: CollectionDefinition,
    entry: MissionEntry,
    crs: Crs,
    request: Request,
) -> FeaturePage:
    root = str(request.base_url).rstrip("/") if known.shows_images else None
    return FeaturePage(found, crs, entry.landing, root)


def _page_links(
    request: Request,
    base: str,
    known: CollectionDefinition,
    features_request: FeatureRequest,
    counts: tuple[int, int],
) -> list[Link]:
    """This page, the next and the one before, and the same features in other formats."""
    returned, matched = counts
    here = request.url_for("items", mission=base.rsplit("/", 1)[1], collection=known.id)
    url = here.replace_query_params(**dict(request.query_params))
    links = [
        link("self", str(url), MEDIA_TYPES[features_request.form]),
        link("collection", f"{base}/collections/{known.id}", JSON, known.title),
    ]
    if features_request.offset + returned < matched:
        after = url.include_query_params(
            offset=features_request.offset + returned, limit=features_request.limit
        )
        links.append(link("next", str(after), MEDIA_TYPES[features_request.form], "Next page"))
    if features_request.offset:
        before = url.include_query_params(
            offset=max(0, features_request.offset - features_request.limit),
            limit=features_request.limit,
        )
        links.append(link("prev", str(before), MEDIA_TYPES[features_request.form], "Page before"))
    others = [form for form in Format if MEDIA_TYPES[form] != MEDIA_TYPES[features_request.form]]
    whole = url.remove_query_params(["offset", "limit"])
    for form in others:
        target = (whole if form in FILES else url).include_query_params(f=str(form))
        links.append(link("alternate", str(target), MEDIA_TYPES[form], f"As {form}"))
    return links
