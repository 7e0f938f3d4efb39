"""Landing pages: of all missions together, and of each one.

At `/ogc` the features of all missions are collections named `MISSION:COLLECTION`, for clients that
are given no mission. Coordinates, tiles and WMTS belong to a mission and have its landing page.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import JSONResponse

from solmap.gis_server.ogc import features, tiles, wmts
from solmap.gis_server.ogc.crs import Crs, crs_named
from solmap.gis_server.ogc.documents import (
    HTML,
    JSON,
    Link,
    link,
    link_list,
    page,
    paragraph,
    table,
)
from solmap.gis_server.ogc.features import Known, form_of
from solmap.gis_server.ogc.formats import Format
from solmap.gis_server.ogc.tiles import raster_named
from solmap.gis_server.ogc.tilesets import collection_document, collection_id
from solmap.gis_server.parameters import REVALIDATE, BaseOf, MissionName, base_of
from solmap.gis_server.services import ServicesOf
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.crs import MARS, local_crs
from solmap.products.errors import ProductNotFoundError
from solmap.products.features.collections import BY_ID

router = APIRouter(prefix="/ogc", tags=["ogc"])
_COMMON = "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf"
CONFORMANCE = (f"{_COMMON}/core", f"{_COMMON}/json", f"{_COMMON}/html")
_PARTS = (features, tiles, wmts)
"""Each has `CONFORMANCE` and `landing_links`."""
_OPENAPI = "application/vnd.oai.openapi+json;version=3.1"
_MAPS = "Collections of rasters"
AsFormat = Annotated[str | None, Query(description="json or html")]


@router.get("", response_class=JSONResponse)
def missions(services: ServicesOf, request: Request, f: AsFormat = None) -> Response:
    """All missions: collections of their features, and the OGC API that each has of its own."""
    root = str(request.base_url).rstrip("/")
    links = [
        link("self", f"{root}/ogc", JSON, "This document"),
        link("alternate", f"{root}/ogc?f=html", HTML, "This document as a page"),
        link("service-desc", f"{root}/openapi.json", _OPENAPI, "The API, for programs"),
        link("service-doc", f"{root}/docs", HTML, "The API, for people"),
        link("conformance", f"{root}/ogc/conformance", JSON, "Conformance classes"),
        link("data", f"{root}/ogc/collections", JSON, "Collections of features of all missions"),
        *(
            link("child", f"{root}/ogc/{entry.mission}", JSON, entry.title)
            for entry in services.catalogue.missions()
        ),
        *(
            one
            for entry in services.catalogue.missions()
            for one in _services_of(f"{root}/ogc/{entry.mission}", entry.title)
        ),
        link("related", f"{root}/stac/catalog.json", JSON, "STAC catalogue"),
    ]
    title = "OGC API of solmap"
    description = (
        "GIS programs list the features of all missions from this address, and those of a mission "
        "with its tiles and coordinate systems from the address of the mission."
    )
    if form_of(request, f) is Format.HTML:
        return _page(page(title, paragraph(description), link_list(links)))
    return _json({"title": title, "description": description, "links": links})


@router.get("/conformance", response_class=JSONResponse)
def conformance_of_all(request: Request, f: AsFormat = None) -> Response:
    """The conformance classes of what is offered of all missions together."""
    return _conformance([*CONFORMANCE, *features.CONFORMANCE], request, f)


@router.get("/collections", response_class=JSONResponse)
def collections_of_all(services: ServicesOf, request: Request, f: AsFormat = None) -> Response:
    """The collections of features of all missions."""
    root = str(request.base_url).rstrip("/")
    listed = [
        of_all(one, entry)
        for entry in services.catalogue.missions()
        for one in features.collections(entry, services, base_of(request, entry.mission))
    ]
    return _listed(
        "Collections of all missions", _links(f"{root}/ogc/collections"), listed, request, f
    )


@router.get("/collections/{mission}:{collection}", response_class=JSONResponse)
def collection_of_all(
    known: Known,
    mission: MissionName,
    services: ServicesOf,
    base: BaseOf,
    request: Request,
    f: AsFormat = None,
) -> Response:
    """One collection of a mission, among those of all missions."""
    entry = services.catalogue.mission(mission)
    return _collection(of_all(features.collection(known, entry, services, base), entry), request, f)


def of_all(collection: dict[str, Any], mission: MissionEntry) -> dict[str, Any]:
    """The description of a mission's collection, named as among those of all missions."""
    return {
        **collection,
        "id": f"{mission.mission}:{collection['id']}",
        "title": f"{mission.title}: {collection['title']}",
    }


def _services_of(base: str, title: str) -> list[Link]:
    """All services of a mission, identified by its title."""
    named = (
        (one, one.get("title", one["rel"])) for part in _PARTS for one in part.landing_links(base)
    )
    return [{**one, "rel": "related", "title": f"{title}: {name}"} for one, name in named]


@router.get("/{mission}", response_class=JSONResponse)
def landing(
    mission: MissionName, services: ServicesOf, base: BaseOf, request: Request, f: AsFormat = None
) -> Response:
    """Links to all resources of a mission."""
    entry = services.catalogue.mission(mission)
    root = str(request.base_url).rstrip("/")
    links = [
        link("self", base, JSON, "This document"),
        link("alternate", f"{base}?f=html", HTML, "This document as a page"),
        link("service-desc", f"{root}/openapi.json", _OPENAPI, "The API, for programs"),
        link("service-doc", f"{root}/docs", HTML, "The API, for people"),
        link("conformance", f"{base}/conformance", JSON, "Conformance classes"),
        *(one for part in _PARTS for one in part.landing_links(base)),
    ]
    where = " on Mars," if entry.landing.is_on_mars else ""
    description = (
        f"Maps made from the stereo images of {entry.title}. Places are{where} relative to "
        f"{entry.landing.name}: {entry.landing.source}."
    )
    if entry.landing.is_on_mars and not entry.landing.origin:
        description += (
            " GDAL 3.12 reads the coordinate system; GDAL 3.6 reads the same longitudes and "
            f"latitudes and calls them WGS 84: use -a_srs {MARS}."
        )
    if form_of(request, f) is Format.HTML:
        return _page(page(entry.title, paragraph(description), link_list(links)))
    return _json({"title": entry.title, "description": description, "links": links})


@router.get("/{mission}/conformance", response_class=JSONResponse)
def conformance(
    mission: MissionName, services: ServicesOf, request: Request, f: AsFormat = None
) -> Response:
    """The conformance classes that the server aims at."""
    services.catalogue.mission(mission)
    classes = [*CONFORMANCE, *(one for part in _PARTS for one in part.CONFORMANCE)]
    return _conformance(classes, request, f)


def _conformance(classes: list[str], request: Request, f: str | None) -> Response:
    if form_of(request, f) is Format.HTML:
        return _page(page("Conformance", table({"class": one} for one in classes)))
    return _json({"conformsTo": classes})


@router.get("/{mission}/collections", response_class=JSONResponse)
def collections(
    mission: MissionName, services: ServicesOf, base: BaseOf, request: Request, f: AsFormat = None
) -> Response:
    """The collections of features. Rasters are linked: they are collections under `/maps`."""
    entry = services.catalogue.mission(mission)
    maps = (
        link("item", f"{base}/collections/{collection_id(one)}", JSON, one.full_title)
        for one in tiles.rasters(mission, services)
    )
    links = [*_links(f"{base}/collections"), link("related", f"{base}/maps", JSON, _MAPS), *maps]
    listed = features.collections(entry, services, base)
    return _listed(f"{entry.title}: collections", links, listed, request, f)


@router.get("/{mission}/maps", response_class=JSONResponse)
def maps(
    mission: MissionName, services: ServicesOf, base: BaseOf, request: Request, f: AsFormat = None
) -> Response:
    """The rasters of a mission, as collections of tiles of maps.

    They are apart from the collections of features, because clients of OGC API Features such as
    GDAL 3.6 take every collection for one of features.
    """
    entry = services.catalogue.mission(mission)
    links = [
        *_links(f"{base}/maps"),
        link("related", f"{base}/collections", JSON, "Collections of features"),
    ]
    listed = tiles.collections(entry, services, base)
    return _listed(f"{entry.title}: maps", links, listed, request, f)


def _links(here: str) -> list[Link]:
    return [
        link("self", here, JSON),
        link("alternate", f"{here}?f=html", HTML, "This document as a page"),
    ]


def _listed(
    title: str, links: list[Link], listed: list[dict[str, Any]], request: Request, f: str | None
) -> Response:
    if form_of(request, f) is Format.HTML:
        rows = (
            {
                "title": one["title"],
                "features": one.get("solmap:count"),
                "description": one.get("description"),
                "address": f"{one['links'][0]['href']}?f=html",
            }
            for one in listed
        )
        return _page(page(title, link_list(links), table(rows)))
    return _json({"links": links, "collections": listed})


@router.get("/{mission}/collections/{collection}", response_class=JSONResponse)
def collection(
    mission: MissionName,
    collection: Annotated[str, Path(pattern=r"^[a-z0-9][a-z0-9_.-]{0,191}$")],
    services: ServicesOf,
    base: BaseOf,
    request: Request,
    f: AsFormat = None,
) -> Response:
    """One collection."""
    entry = services.catalogue.mission(mission)
    if collection in BY_ID:
        body = features.collection(BY_ID[collection], entry, services, base)
    elif "." in collection:
        body = collection_document(raster_named(collection, mission, services), entry, base)
    else:
        raise ProductNotFoundError(f"no collection {collection!r}; there are {', '.join(BY_ID)}")
    return _collection(body, request, f)


def _collection(body: dict[str, Any], request: Request, f: str | None) -> Response:
    if form_of(request, f) is Format.HTML:
        text = paragraph(body.get("description", ""))
        return _page(page(body["title"], text, link_list(body["links"])))
    return _json(body)


@router.get("/{mission}/crs/{name}")
def crs(
    mission: MissionName, name: str, services: ServicesOf, base: BaseOf, f: AsFormat = None
) -> Response:
    """A coordinate system as WKT2 (`f=json`: as PROJJSON)."""
    entry = services.catalogue.mission(mission)
    known = crs_named(f"{base}/crs/{name}", "crs", base)
    if known is Crs.LON_LAT:
        raise ProductNotFoundError(
            f"{name} is {MARS} with longitude before latitude, as GeoJSON has them"
        )
    crs = local_crs(entry.landing)
    if f == Format.JSON:
        return _json(crs.to_json_dict())
    return Response(crs.to_wkt(), headers=REVALIDATE, media_type="text/plain; charset=utf-8")


def _json(body: dict[str, Any]) -> JSONResponse:
    return JSONResponse(body, headers=REVALIDATE)


def _page(text: str) -> Response:
    return Response(text, headers=REVALIDATE, media_type=f"{HTML}; charset=utf-8")
