"""The store and catalogue that the settings name."""

from __future__ import annotations

from pathlib import Path

from solmap.config.settings import Settings
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.workspace import Workspace


def open_workspace(root: Path) -> Workspace:
    """Open or found the store at `root`.

    Its catalogue lies where `SOLMAP_CATALOGUE_URL` says, its products where `SOLMAP_STORE_URL`.

    Raises:
        ProductError: the folder cannot be written, or the catalogue's database or the object store
            does not answer.
    """
    settings = Settings()
    return Workspace.open(root, settings.catalogue_url, settings.object_storage)


def open_catalogue(root: Path) -> Catalogue:
    """The catalogue alone."""
    return Catalogue.open(root, Settings().catalogue_url)
