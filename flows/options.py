"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.config.settings import Settings

StoreOption = Annotated[
    Path | None, typer.Option("--store", help="Folder of products. [env: SOLMAP_STORE]")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]


def store_of(given: Path | None) -> Path:
    """The store that is named, or else the one of the settings."""
    return given or Settings().store
