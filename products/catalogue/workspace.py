"""A store and its catalogue, opened together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.product_store import ProductStore


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """Where products are kept, and what says which there are."""

    store: ProductStore
    catalogue: Catalogue

    @classmethod
    def open(
        cls,
        root: Path,
        catalogue_url: str | None = None,
        object_storage: ObjectStorage | None = None,
    ) -> Workspace:
        """Open or found the workspace at `root`; catalogue and products may lie elsewhere."""
        store = ProductStore.open(root, object_storage)
        return cls(store, Catalogue.open(store.root, catalogue_url))
