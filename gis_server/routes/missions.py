"""Missions, their layers and images, values at a point, and all data of the first view.

Answers that are long and the same for everybody until something is published are cached, plain and
compressed.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Path, Query, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, TypeAdapter

from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.analysis.layer_values import (
    Place,
    identify,
)
from solmap.gis_server.paging import PAGE, Page, PageOf
from solmap.gis_server.parameters import AGAIN, LAST_SOL, Metres, MissionName
from solmap.gis_server.routes.layers import MapLayer, layer_body
from solmap.gis_server.services import ON_THE_MAP, Services, ServicesOf, map_layers
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, Bounds
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry, Part
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import local_crs, local_proj4
from solmap.products.formats.raster.tiling import CELL_SIZES, EXTENT
from solmap.products.reports.sol_report import sol_report

router = APIRouter(prefix="/api", tags=["missions"])
_NO_LAYERS: Bounds = (-50.0, -50.0, 50.0, 50.0)
"""Size of the map of a mission without layers, metres."""
_FAST = 5
"""Level of gzip: twice as fast as 9, and hardly longer."""
_CACHED_LISTS = 40
"""Cached pages of layers and of images; a page of 500 has 0.4 and 0.2 MB, compressed a tenth."""
LAST_EVENT = "Last-Event-ID"
_CACHED_STARTS = 2
"""Cached first answers; one of 96 layers has 50 kB."""


class Landing(BaseModel):
    """Whether the map is tied to Mars, and else its approximate place."""

    name: str
    origin: str
    """Origin of a map that is not tied to the lander; else empty."""
    longitude: float
    latitude: float
    radius_m: float
    source: str
    sigma_m: float
    """Standard deviation of its place on Mars, of each coordinate."""


class LocalCrs(BaseModel):
    """The map's coordinate system, as WKT2 and for proj4js."""

    wkt: str
    proj4: str | None
    """PROJ string; null for a map that is not tied to the lander."""


class TileMatrixSet(BaseModel):
    """The tile matrix set of the map."""

    extent: Bounds
    cell_sizes: tuple[float, ...]
    tile_size: int


class Mission(BaseModel):
    """A mission and its map; `bounds` hold all its layers, metres."""

    mission: str
    title: str
    landing: Landing
    crs: LocalCrs
    lsl_note: str | None
    tile_matrix_set: TileMatrixSet
    bounds: Bounds


class Image(BaseModel):
    """An image of the rover and the addresses of its files."""

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
    browse: ServerPath
    original: ServerPath


def mission_body(entry: MissionEntry, extent: Bounds | None) -> Mission:
    """A mission and the extent of its layers."""
    landing = entry.landing
    return Mission(
        mission=entry.mission,
        title=entry.title,
        landing=Landing.model_validate(landing, from_attributes=True),
        crs=LocalCrs(wkt=local_crs(landing).to_wkt(), proj4=local_proj4(landing)),
        lsl_note=entry.lsl_note,
        tile_matrix_set=TileMatrixSet(extent=EXTENT, cell_sizes=CELL_SIZES, tile_size=BLOCK),
        bounds=extent or _NO_LAYERS,
    )


def image_body(entry: ImageEntry) -> Image:
    """An image and its addresses."""
    known = {name: getattr(entry, name) for name in Image.model_fields if hasattr(entry, name)}
    known["browse"] = f"/images/{entry.id}/browse.png"
    known["original"] = f"/images/{entry.id}/original"
    return Image.model_validate(known)


@dataclass(frozen=True, slots=True)
class CachedResponse:
    """JSON, plain and compressed, with an ETag of its content."""

    plain: bytes
    compressed: bytes
    tag: str

    @classmethod
    def of(cls, body: bytes) -> CachedResponse:
        """The response of a body."""
        tag = f'W/"{blake2b(body, digest_size=8).hexdigest()}"'
        return cls(body, gzip.compress(body, _FAST, mtime=0), tag)


@dataclass(frozen=True, slots=True)
class CacheState:
    """ETag in the browser's cache, and its accepted encodings."""

    known: str
    has_gzip: bool

    def respond(self, cached: CachedResponse) -> Response:
        """The answer, or status 304 if the browser has it."""
        headers = {**AGAIN, "ETag": cached.tag, "Vary": "Accept-Encoding"}
        if cached.tag in self.known:
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
        if self.has_gzip:
            headers["Content-Encoding"] = "gzip"
        body = cached.compressed if self.has_gzip else cached.plain
        return Response(body, media_type="application/json", headers=headers)


async def _cache_state(
    known: Annotated[str, Header(alias="If-None-Match", max_length=1000)] = "",
    encodings: Annotated[str, Header(alias="Accept-Encoding", max_length=1000)] = "",
) -> CacheState:
    return CacheState(known, "gzip" in encodings)


CacheStateOf = Annotated[CacheState, Depends(_cache_state)]
"""ETag in the client's cache, and its accepted encodings."""
_IMAGES, _LAYERS = TypeAdapter(list[Image]), TypeAdapter(list[MapLayer])


@router.get("/missions")
def missions(services: ServicesOf, response: Response) -> list[Mission]:
    """All missions, with the place of their maps on Mars and their tile matrix sets."""
    response.headers.update(AGAIN)
    return missions_of(services)


@router.get("/missions/{mission}/layers", response_model=list[MapLayer])
def layers(
    mission: MissionName, services: ServicesOf, cache: CacheStateOf, page: PageOf
) -> Response:
    """The latest layer of every scope and kind, a page at a time."""
    services.catalogue.mission(mission)
    version = services.catalogue.published_version()
    answer = cache.respond(_layers(services, mission, page.limit, page.offset, version))
    answer.headers.update(page.head(_layer_count(services, mission, version)))
    return answer


@lru_cache(maxsize=_CACHED_LISTS)
def _layers(
    services: Services, mission: str, limit: int, offset: int, _version: int
) -> CachedResponse:
    found = _layer_page(mission, services, Page(limit, offset))
    return CachedResponse.of(_LAYERS.dump_json(found))


@lru_cache(maxsize=_CACHED_LISTS)
def _layer_count(services: Services, mission: str, _version: int) -> int:
    return services.catalogue.layer_count(mission, ON_THE_MAP)


def _layer_page(mission: str, services: Services, page: Page) -> list[MapLayer]:
    part = Part(page.limit, page.offset)
    found = services.catalogue.layers(mission, types=ON_THE_MAP, part=part)
    return [layer_body(layer) for layer in found]


@router.get("/missions/{mission}/images", response_model=list[Image])
def images(
    mission: MissionName,
    services: ServicesOf,
    cache: CacheStateOf,
    page: PageOf,
    sol: Annotated[int | None, Query(ge=0, le=LAST_SOL)] = None,
    stop: Annotated[str | None, Query(max_length=128)] = None,
) -> Response:
    """The images of a mission, sol or stop, with partner or why there is none; page by page."""
    services.catalogue.mission(mission)
    version = services.catalogue.images_version(mission)
    part = Part(page.limit, page.offset)
    answer = cache.respond(_images(services, mission, stop, sol, part, version))
    answer.headers.update(page.head(services.catalogue.image_count(mission, stop, sol)))
    return answer


@lru_cache(maxsize=_CACHED_LISTS)
def _images(
    services: Services, mission: str, stop: str | None, sol: int | None, part: Part, _version: str
) -> CachedResponse:
    """A list of images as JSON: writing 500 of them takes 50 ms."""
    found = [image_body(entry) for entry in services.catalogue.images(mission, stop, sol, part)]
    return CachedResponse.of(_IMAGES.dump_json(found))


@router.get("/missions/{mission}/sols/{sol}/report", response_class=HTMLResponse)
def sol_page(
    mission: MissionName, sol: Annotated[int, Path(ge=0, le=LAST_SOL)], services: ServicesOf
) -> HTMLResponse:
    """Report of a sol on one page: images, matches, adjustment, layers, times."""
    workspace = Workspace(services.store, services.catalogue)
    return HTMLResponse(sol_report(mission, sol, workspace), headers=AGAIN)


@router.get("/missions/{mission}/identify")
def identify_place(
    mission: MissionName, east: Metres, north: Metres, services: ServicesOf, response: Response
) -> Place:
    """Values of all layers at a point: coordinates, elevation, values, stops and images."""
    response.headers.update(AGAIN)
    landing = services.catalogue.mission(mission).landing
    layers = map_layers(mission, services)
    return identify(layers, landing, east, north, services.store, services.pool)


def missions_of(services: Services) -> list[Mission]:
    """All missions of the store."""
    return [
        mission_body(entry, services.catalogue.extent(entry.mission))
        for entry in services.catalogue.missions()
    ]


class Start(BaseModel):
    """Where the map begins."""

    missions: list[Mission]
    """All missions of the store."""
    mission: str | None
    """The one whose layers these are: the first; null if there is none."""
    layers: list[MapLayer]
    """The first page of its list; `Link` names the next."""


@router.get("/start", response_model=Start)
def start(services: ServicesOf, cache: CacheStateOf) -> Response:
    """All missions, and the layers of the first; written again only after a publication.

    The header `Last-Event-ID` names the last event included: `/api/events` with this `since` misses
    none.
    """
    seen = services.catalogue.version()  # before all else: later events are sent again
    body, more = _start_body(services, services.catalogue.published_version())
    answer = cache.respond(body)
    answer.headers[LAST_EVENT] = str(seen)
    if more:
        answer.headers["Link"] = more
    return answer


@lru_cache(maxsize=_CACHED_STARTS)
def _start_body(services: Services, version: int) -> tuple[CachedResponse, str]:
    """The response, and its `Link` if there are more layers."""
    found = missions_of(services)
    first = found[0].mission if found else None
    page = Page(PAGE, 0)
    layers = _layer_page(first, services, page) if first else []
    whole = Start(missions=found, mission=first, layers=layers)
    total = _layer_count(services, first, version) if first else 0
    more = page.head(total).get("Link", "").replace("<", f"<missions/{first}/layers")
    return CachedResponse.of(whole.model_dump_json().encode()), more
