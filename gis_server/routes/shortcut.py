"""The shortest way from the address of a tile to its bytes.

A view of the map asks for dozens of tiles, and the ordinary way through routes, dependencies and
validation takes several times as long as to draw one. A well-formed address is read here by one
regular expression, its query once for all tiles that have the same; whatever is wrong with it is
left to the ordinary way, which says so.
"""

from __future__ import annotations

import re
from functools import lru_cache
from urllib.parse import parse_qsl

from anyio import CapacityLimiter, to_thread
from fastapi import Response
from pydantic import ValidationError
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from solmap.gis_server.metrics import Metrics
from solmap.gis_server.rendering.styles import StyleQuery, UnknownStyleError
from solmap.gis_server.routes.tiles import picture_of, values_of
from solmap.gis_server.services import Services
from solmap.products.errors import ProductError
from solmap.products.formats.raster.tiling import TileAddress
from solmap.products.model import ProductKind

_TILE = re.compile(
    r"/tiles/([a-z0-9][a-z0-9_.-]{0,127})/([a-z-]{1,32})/([0-9a-f]{16})"
    r"/([0-9]{1,2})/([0-9]{1,7})/([0-9]{1,7})\.(png|values)",
    re.ASCII,
)
_LONGEST_QUERY = 256
_THREADS = 1
"""That draw tiles at a time: of two, one waits for the other most of the time, and answers at the
95th percentile take twice as long. Many users are served by several processes."""


class TileShortcut:
    """Answers well-formed addresses of tiles by itself and passes everything else on."""

    def __init__(self, app: ASGIApp, services: Services, metrics: Metrics) -> None:
        self.app, self.services, self.metrics = app, services, metrics
        self.limiter = CapacityLimiter(_THREADS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with a tile, or pass the request on."""
        answer = None
        if scope["type"] == "http" and scope["method"] == "GET":
            found = _TILE.fullmatch(scope["path"])
            if found and len(scope["query_string"]) <= _LONGEST_QUERY:
                answer = await to_thread.run_sync(self._draw, found, scope, limiter=self.limiter)
        await (answer or self.app)(scope, receive, send)

    def _draw(self, found: re.Match[str], scope: Scope) -> Response | None:
        name, kind, digest, zoom, column, row, form = found.groups()
        query: bytes = scope["query_string"]
        if form == "values" and query:
            return None
        try:
            layer = self.services.layer(name, ProductKind(kind), digest)
            address = TileAddress(int(zoom), int(column), int(row))
            with self.metrics.drawing(form):
                if form == "values":
                    encoding = Headers(scope=scope).get("accept-encoding", "")
                    return values_of(layer, address, self.services, encoding)
                return picture_of(layer, address, self.services, _style_query(query))
        except (ProductError, UnknownStyleError, ValidationError, ValueError):
            return None


@lru_cache(maxsize=256)
def _style_query(query: bytes) -> StyleQuery:
    """The style that a query asks for.

    Raises:
        ValidationError: it is none.
    """
    asked = dict(parse_qsl(query.decode("ascii", "replace"), keep_blank_values=True))
    return StyleQuery.model_validate(asked)
