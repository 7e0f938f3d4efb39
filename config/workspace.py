"""The store and catalogue of the settings."""

from __future__ import annotations

from pathlib import Path

from solmap.config.settings import Settings
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.workspace import Workspace


def open_workspace(root: Path) -> Workspace:
    """Open or create the store at `root`.

    `SOLMAP_CATALOGUE_URL` sets the location of its catalogue, `SOLMAP_STORE_URL` that of its
    products.

    Raises:
        ProductError: the folder cannot be written, or the catalogue's database or the object
            store does not respond.
    """
    settings = Settings()
    return Workspace.open(root, settings.catalogue_url, settings.object_storage)


def open_catalogue(root: Path) -> Catalogue:
    """Open only the catalogue."""
    return Catalogue.open(root, Settings().catalogue_url)
