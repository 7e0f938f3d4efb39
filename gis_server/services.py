"""What the endpoints work with: the store's catalogue and products, and open rasters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request

from solmap.gis_server.live import EventTail
from solmap.gis_server.read_ahead import ReadAhead
from solmap.gis_server.rendering.readers import RasterPool
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.edits import EditLog, RequestBook
from solmap.products.catalogue.runs import RunBook
from solmap.products.catalogue.tokens import TokenBook
from solmap.products.features.mission_features import MissionFeatures
from solmap.products.model import Layer, ProductKind
from solmap.products.store.backends import Elsewhere
from solmap.products.store.product_store import ProductStore

_LAYERS = 1024
_OPEN = 64
"""Rasters kept open: to identify a place asks some fifty layers, and opening one takes 10 ms."""


@dataclass(frozen=True, slots=True, eq=False)
class Services:
    """One set for a server. The catalogue is asked anew each time, so publishing shows at once."""

    store: ProductStore
    catalogue: Catalogue
    pool: RasterPool
    layer: Callable[[str, ProductKind, str], Layer]
    """A layer by scope, kind and digest, remembered: it never changes, and a view of the map asks
    for dozens of its tiles."""
    features: MissionFeatures
    """All features of a mission, out of an index."""
    tail: EventTail
    """What happens in the store, for those who listen."""
    ahead: ReadAhead
    tokens: TokenBook
    edits: EditLog
    runs: RunBook
    requests: RequestBook


def open_services(
    root: Path, catalogue_url: str | None = None, elsewhere: Elsewhere | None = None
) -> Services:
    """Open the store at `root` for reading; catalogue and products may lie elsewhere."""
    store, catalogue = ProductStore.open(root, elsewhere), Catalogue.open(root, catalogue_url)
    remembered = lru_cache(maxsize=_LAYERS)(catalogue.layer)
    features, ahead = MissionFeatures.open(store, catalogue), ReadAhead(store, catalogue)
    return Services(
        store=store,
        catalogue=catalogue,
        pool=RasterPool(idle=_OPEN),
        layer=remembered,
        features=features,
        tail=EventTail(catalogue.engine, before=ahead.published),
        ahead=ahead,
        tokens=TokenBook.of(store.root),
        edits=EditLog.of(store.root),
        runs=RunBook(catalogue.engine),
        requests=RequestBook.of(store.root),
    )


def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


ServicesOf = Annotated[Services, Depends(_services)]
"""The services of the app that a request came to."""
