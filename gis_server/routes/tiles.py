"""Map tiles: images and values.

A view of the map requests dozens of tiles, so these routes are lean: each request is checked by one
model for its path and one for its query, from which the API description is written too; only the
drawing runs in a thread; and these routes are the first of the app. They take less than 1.3 times
as long as the same tiles without routing and validation (`tests/benchmarks/test_tiles.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from http import HTTPStatus
from typing import Annotated, Any, TypeVar
from urllib.parse import parse_qsl

from anyio import to_thread
from cachetools import LRUCache
from fastapi import APIRouter, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError

from solmap.gis_server.metrics import Metrics
from solmap.gis_server.parameters import FOREVER, Digest, ScopeName, TileNumber, Zoom
from solmap.gis_server.rendering.painting import PNG, WEBP, ImageFormat
from solmap.gis_server.rendering.png import gunzip
from solmap.gis_server.rendering.styles import StyleQuery
from solmap.gis_server.rendering.tiles import MEDIA_TYPE, draw_tile, empty_tile, render_values
from solmap.gis_server.services import Services
from solmap.products.formats.raster.tiling import TileAddress
from solmap.products.model import ProductKind

router = APIRouter(tags=["tiles"])
_Checked = TypeVar("_Checked", bound=BaseModel)


class TilePath(BaseModel):
    """A tile of a layer, as the path names it."""

    scope: ScopeName
    kind: ProductKind
    digest: Digest
    z: Zoom
    x: TileNumber
    y: TileNumber

    @property
    def address(self) -> TileAddress:
        """The tile in the mission's tile matrix set."""
        return TileAddress(self.z, self.x, self.y)


class ValuesQuery(BaseModel):
    """The band of a raster."""

    band: Annotated[str, Query(pattern=r"^[a-z_]{0,64}$", description="the first by default")] = ""


def _parameters(query: type[BaseModel]) -> dict[str, Any]:
    """Path and query in the description of the API."""
    described = []
    for model, place in ((TilePath, "path"), (query, "query")):
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
        for name, field in schema["properties"].items():
            note = {"description": field["description"]} if "description" in field else {}
            common = {"name": name, "in": place, "required": place == "path"}
            described.append({**common, "schema": field, **note})
    return {"parameters": described}


def _validate(model: type[_Checked], values: Mapping[str, str], place: str) -> _Checked:
    """The values of a path or query, validated.

    Raises:
        RequestValidationError: a value is not allowed, or its name is unknown.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        found = [{**one, "loc": (place, *one["loc"])} for one in error.errors()]
        raise RequestValidationError(found) from error


@lru_cache(maxsize=256)
def _checked_query(model: type[_Checked], query: bytes) -> _Checked:
    """All tiles of a view have the same query."""
    pairs = parse_qsl(query.decode("latin-1"), keep_blank_values=True)
    return _validate(model, dict(pairs), "query")


@router.get(
    "/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.png",
    response_class=Response,
    openapi_extra=_parameters(StyleQuery),
)
async def tile(request: Request) -> Response:
    """One tile of 256 x 256 pixels, transparent where nothing was measured.

    `GET /api/layers/{scope}/{kind}/{digest}/styles` lists the styles of a layer.
    """
    body = await _drawn(request, PNG) or empty_tile()
    return Response(body, media_type=PNG.media_type, headers=FOREVER)


@router.get(
    "/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.webp",
    response_class=Response,
    openapi_extra=_parameters(StyleQuery),
)
async def small_tile(request: Request) -> Response:
    """The same tile in fewer bytes; status 204 where nothing was measured.

    Shades of grey and photographs are lossy; colours of a palette, and what is transparent, exact.
    """
    kept: LRUCache[tuple[str, bytes], bytes] = request.app.state.services.small_tiles
    key = request.scope["path"], request.scope["query_string"]
    body = kept.get(key)
    if body is None:
        body = await _drawn(request, WEBP) or b""
        kept[key] = body
    if not body:
        return Response(status_code=HTTPStatus.NO_CONTENT, headers=FOREVER)
    return Response(body, media_type=WEBP.media_type, headers=FOREVER)


async def _drawn(request: Request, form: ImageFormat) -> bytes | None:
    path = _validate(TilePath, request.path_params, "path")
    query = _checked_query(StyleQuery, request.scope["query_string"])
    services: Services = request.app.state.services
    metrics: Metrics = request.app.state.metrics

    def draw() -> bytes | None:
        layer, address = services.layer(path.scope, path.kind, path.digest), path.address
        with metrics.drawing(form.media_type.removeprefix("image/")):
            return draw_tile(layer, address, services.store, services.pool, query, form)

    return await to_thread.run_sync(draw, limiter=services.drawing)


@router.get(
    "/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.values",
    response_class=Response,
    openapi_extra=_parameters(ValuesQuery),
)
async def values(request: Request) -> Response:
    """The values of a tile and of the pixels around it; status 204 where nothing was measured.

    The format is documented under "HTTP API", Tiles of values.
    """
    path = _validate(TilePath, request.path_params, "path")
    query = _checked_query(ValuesQuery, request.scope["query_string"])
    has_gzip = "gzip" in request.headers.get("accept-encoding", "")
    services: Services = request.app.state.services
    metrics: Metrics = request.app.state.metrics

    def draw() -> bytes | None:
        layer, address = services.layer(path.scope, path.kind, path.digest), path.address
        with metrics.drawing("values"):
            body = render_values(layer, address, services.store, services.pool, query.band)
        return body if body is None or has_gzip else gunzip(body)

    body = await to_thread.run_sync(draw, limiter=services.drawing)
    headers = {**FOREVER, "Vary": "Accept-Encoding"}
    if body is None:
        return Response(status_code=HTTPStatus.NO_CONTENT, headers=headers)
    if has_gzip:
        headers["Content-Encoding"] = "gzip"
    return Response(body, media_type=MEDIA_TYPE, headers=headers)
