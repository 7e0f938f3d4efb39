"""The store and catalogue that the settings name."""

from __future__ import annotations

from pathlib import Path

from config.settings import Settings
from products.catalogue import Catalogue
from products.workspace import Workspace


def open_workspace(root: Path) -> Workspace:
    """Open or found the store at `root`, with its catalogue where `SOLMAP_CATALOGUE_URL` says.

    Raises:
        ProductError: the folder cannot be written, or the catalogue's database does not answer.
    """
    return Workspace.open(root, Settings().catalogue_url)


def open_catalogue(root: Path) -> Catalogue:
    """The catalogue alone."""
    return Catalogue.open(root, Settings().catalogue_url)
