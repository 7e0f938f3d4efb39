"""A store and its catalogue, opened together."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from solmap.products.catalogue import turns
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.model import mission_of
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.product_store import ProductStore


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """A store of products with its catalogue."""

    store: ProductStore
    catalogue: Catalogue

    @classmethod
    def open(
        cls,
        root: Path,
        catalogue_url: str | None = None,
        object_storage: ObjectStorage | None = None,
    ) -> Workspace:
        """Open or create the workspace at `root`; catalogue and products may be elsewhere."""
        store = ProductStore.open(root, object_storage)
        return cls(store, Catalogue.open(store.root, catalogue_url))

    def run_turn(self, on_wait: Callable[[], None] = lambda: None) -> AbstractContextManager[None]:
        """Use it beside other runs: nothing is pruned, repaired or restored meanwhile."""
        return turns.run_turn(self.store.root, self.catalogue.engine, on_wait)

    def exclusive_mission(
        self, mission: str, on_wait: Callable[[], None] = lambda: None
    ) -> AbstractContextManager[None]:
        """Change a mission, all of its maps, alone; `on_wait` is called where another run does."""
        name = mission_of(mission)
        return turns.exclusive_mission(self.store.root, self.catalogue.engine, name, on_wait)

    def maintenance_turn(self, what: str) -> AbstractContextManager[None]:
        """Use it exclusively; `what` names the action to repeat later if others use it.

        Raises:
            StoreBusyError: they do.
        """
        return turns.maintenance_turn(self.store.root, self.catalogue.engine, what)
