"""Layers that grow with the mission are read before a page asks for them.

To read ten thousand footprints takes a third of a second. The server reads them when it starts, and
when a new version is published, before the pages hear of it.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import dataclass

from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.events import LAYERS_PUBLISHED, Event
from solmap.products.features.texts import texts_of
from solmap.products.model import ProductKind
from solmap.products.store.product_store import ProductStore

log = logging.getLogger(__name__)
GROWING = (ProductKind.FOOTPRINTS, ProductKind.POINTING, ProductKind.TIE_POINTS)


@dataclass(frozen=True, slots=True)
class ReadAhead:
    """Reads what is asked for next. What cannot be read is left to who asks for it."""

    store: ProductStore
    catalogue: Catalogue

    def published(self, events: Collection[Event]) -> None:
        """Read what some events tell of."""
        if any(event.kind == LAYERS_PUBLISHED for event in events):
            self.read()

    def read(self) -> None:
        """Read the latest version of every layer that grows; those that are known take no time."""
        try:
            for layer in self.catalogue.layers(kinds=GROWING):
                texts_of(self.store.path(layer.ref))
        except Exception as error:  # noqa: BLE001 - pages must hear of what was published all the same
            log.warning("layers were not read ahead: %r", error)
