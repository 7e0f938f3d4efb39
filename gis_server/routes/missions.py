"""Missions, their layers and images, values at a point, and all data of the first view.

Long responses that change only with a publication are cached, plain and gzipped.
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
from solmap.gis_server.parameters import LAST_SOL, REVALIDATE, Metres, MissionName
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
"""Bounds of the map of a mission without layers, metres."""
_FAST = 5
"""Level of gzip: twice as fast as 9, and its output is hardly larger."""
_CACHED_LISTS = 40
"""Cached pages of layers and of images: 500 layers take 0.4 MB, 500 images 0.2 MB; compressed, a
tenth of that."""
LAST_EVENT = "Last-Event-ID"
_CACHED_STARTS = 2
"""Number of cached `/start` responses; one with 96 layers takes 50 kB."""


class Landing(BaseModel):
    """The landing point.

    If the map is not tied to the lander, `origin` names where it starts and the position is only
    approximate.
    """

    name: str
    origin: str
    """Origin of a map that is not tied to the lander; else empty."""
    longitude: float
    latitude: float
    radius_m: float
    source: str
    sigma_m: float
    """Standard deviation of each coordinate of its position on Mars."""


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
    """A mission and its map; `bounds` enclose all its layers, metres."""

    mission: str
    title: str
    landing: Landing
    crs: LocalCrs
    lsl_note: str | None
    """Reason why the map is not tied to the lander."""
    tile_matrix_set: TileMatrixSet
    bounds: Bounds


class Image(BaseModel):
    """An image taken by the rover, and the addresses of its files."""

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
    """Address of the reduced PNG."""
    original: ServerPath
    """Address of the original file."""


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
        """A cached response with this body."""
        tag = f'W/"{blake2b(body, digest_size=8).hexdigest()}"'
        return cls(body, gzip.compress(body, _FAST, mtime=0), tag)


@dataclass(frozen=True, slots=True)
class CacheState:
    """The client's cached ETags and whether it accepts gzip."""

    known: str
    has_gzip: bool

    def respond(self, cached: CachedResponse) -> Response:
        """The response, or status 304 if the client's copy is current."""
        headers = {**REVALIDATE, "ETag": cached.tag, "Vary": "Accept-Encoding"}
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
"""The client's cached ETags and whether it accepts gzip."""
_IMAGES, _LAYERS = TypeAdapter(list[Image]), TypeAdapter(list[MapLayer])


@router.get("/missions")
def missions(services: ServicesOf, response: Response) -> list[Mission]:
    """All missions, with the place of their maps on Mars and their tile matrix sets."""
    response.headers.update(REVALIDATE)
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
    """The images of a mission, sol or stop, a page at a time.

    Each with the stereo partner, or the reason why there is none.
    """
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
    """A list of images as JSON; cached, because 500 images take 50 ms."""
    found = [image_body(entry) for entry in services.catalogue.images(mission, stop, sol, part)]
    return CachedResponse.of(_IMAGES.dump_json(found))


@router.get("/missions/{mission}/sols/{sol}/report", response_class=HTMLResponse)
def sol_page(
    mission: MissionName, sol: Annotated[int, Path(ge=0, le=LAST_SOL)], services: ServicesOf
) -> HTMLResponse:
    """Report of a sol on one page: images, matches, adjustment, layers, times."""
    workspace = Workspace(services.store, services.catalogue)
    return HTMLResponse(sol_report(mission, sol, workspace), headers=REVALIDATE)


@router.get("/missions/{mission}/identify")
def identify_place(
    mission: MissionName, east: Metres, north: Metres, services: ServicesOf, response: Response
) -> Place:
    """Values of all layers at a point: coordinates, elevation, values, stops and images."""
    response.headers.update(REVALIDATE)
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
    """What the viewer needs to open."""

    missions: list[Mission]
    """All missions of the store."""
    mission: str | None
    """The first mission, to which `layers` belong; null if the store has none."""
    layers: list[MapLayer]
    """First page of that mission's layers; the `Link` header gives the next."""


@router.get("/start", response_model=Start)
def start(services: ServicesOf, cache: CacheStateOf) -> Response:
    """All missions, and the layers of the first; cached until something is published.

    The header `Last-Event-ID` is the number of the last event included; request
    `/api/events?since=` with this number to miss no event.
    """
    # read first, so that events during this request are sent again, not lost
    seen = services.catalogue.version()
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
