"""Resources of the endpoints: catalogue, products, open rasters, and cached features.

Layers that grow with the mission are read before a page requests them: reading ten thousand
footprints takes a third of a second. The server reads them when it starts, and when a new version
is published, before it sends that event.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from anyio import CapacityLimiter, to_thread
from cachetools import LRUCache
from fastapi import Depends, Request

from solmap.gis_server.live import EventTail
from solmap.gis_server.rendering.reading import RasterPool
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.edits import EditLog, RunRequests
from solmap.products.catalogue.events import LAYERS_PUBLISHED, Event
from solmap.products.catalogue.runs import RunRecords
from solmap.products.catalogue.tokens import Tokens
from solmap.products.features.mission_features import MissionFeatures
from solmap.products.features.texts import feature_texts
from solmap.products.model import Layer, ProductKind
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.product_store import ProductStore

log = logging.getLogger(__name__)
GROWING = (ProductKind.FOOTPRINTS, ProductKind.POINTING, ProductKind.TIE_POINTS)
_LAYERS = 1024
_HEALTH_S = 1.0
"""Age in seconds above which the cached state of the catalogue is read again."""
_SMALL_TILES = 32 << 20
"""Bytes; a first view has 0.5 MB of them."""
_ENTRY = 512
"""Bytes that an entry of a cache takes beside its value."""
_DRAWING = 1
"""Threads that draw tiles at a time.

With two, one waits for the other most of the time, and answers at the 95th percentile take twice as
long. Many users are served by several processes.
"""


@dataclass(frozen=True, slots=True)
class ReadAhead:
    """Reads ahead what will be requested. Unreadable files are left to the request."""

    store: ProductStore
    catalogue: Catalogue

    def on_events(self, events: Collection[Event]) -> None:
        """Read the layers of some events."""
        if any(event.kind == LAYERS_PUBLISHED for event in events):
            self.read()

    def read(self) -> None:
        """Read the latest version of every growing layer; cached ones take no time."""
        try:
            for layer in self.catalogue.layers(kinds=GROWING):
                feature_texts(self.store.path(layer.ref))
        except Exception as error:  # noqa: BLE001 - pages must get the event nevertheless
            log.warning("layers were not read ahead: %r", error)


@dataclass(slots=True, eq=False)
class CatalogueHealth:
    """Whether the catalogue can be read; it is read at most every second."""

    catalogue: Catalogue
    _read_at: float = -math.inf
    _thread: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(1))
    """Does not wait for other threads."""

    async def check(self) -> None:
        """Raise the error of the last reading."""
        if time.monotonic() - self._read_at > _HEALTH_S:
            await to_thread.run_sync(self.catalogue.missions, limiter=self._thread)
            self._read_at = time.monotonic()


@dataclass(frozen=True, slots=True, eq=False)
class Services:
    """One set for a server. The catalogue is read each time, so publications show at once."""

    store: ProductStore
    catalogue: Catalogue
    pool: RasterPool
    layer: Callable[[str, ProductKind, str], Layer]
    """A layer by scope, kind and digest, cached: it never changes, and a view of the map requests
    dozens of its tiles."""
    features: MissionFeatures
    """Index of all features of a mission."""
    tail: EventTail
    """Events of the store, for listeners."""
    ahead: ReadAhead
    tokens: Tokens
    edits: EditLog
    runs: RunRecords
    requests: RunRequests
    health: CatalogueHealth
    drawing: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(_DRAWING))
    """Limiter of the threads that draw tiles."""
    small_tiles: LRUCache[tuple[str, bytes], bytes] = field(
        default_factory=lambda: LRUCache(_SMALL_TILES, lambda body: _ENTRY + len(body))
    )
    """Tiles as WebP by path and query, empty where nothing was measured: to encode one takes ten
    times as long as to draw it."""


def open_services(
    root: Path, catalogue_url: str | None = None, object_storage: ObjectStorage | None = None
) -> Services:
    """Open the store at `root` for reading; catalogue and products may lie elsewhere."""
    store, catalogue = ProductStore.open(root, object_storage), Catalogue.open(root, catalogue_url)
    remembered = lru_cache(maxsize=_LAYERS)(catalogue.layer)
    features, ahead = MissionFeatures.open(store, catalogue), ReadAhead(store, catalogue)
    return Services(
        store=store,
        catalogue=catalogue,
        pool=RasterPool(),
        layer=remembered,
        features=features,
        tail=EventTail(catalogue.engine, before=ahead.on_events),
        ahead=ahead,
        tokens=Tokens.of(store.root),
        edits=EditLog.of(store.root),
        runs=RunRecords(catalogue.engine),
        requests=RunRequests.of(store.root),
        health=CatalogueHealth(catalogue),
    )


async def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


ServicesOf = Annotated[Services, Depends(_services)]
"""The services of the app that a request came to."""


ON_THE_MAP = ("raster", "vector")
"""Types of map layers; models and panoramas have other viewers."""


def map_layers(mission: str, services: Services) -> list[Layer]:
    """The latest layers that are on the map."""
    return services.catalogue.layers(mission, types=ON_THE_MAP)
