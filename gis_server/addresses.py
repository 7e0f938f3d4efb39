"""URL paths below the prefix at which a reverse proxy serves the map, if not at a host's root."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Annotated

from pydantic import PlainSerializer

ROOT_PATH: ContextVar[str] = ContextVar("root_path", default="")
"""Path prefix of the public URL, without a trailing slash; set by `PublicAddress` per request."""


def _below_root(path: str) -> str:
    return ROOT_PATH.get() + path


ServerPath = Annotated[str, PlainSerializer(_below_root)]
"""A path of this server such as `/api/start`; in JSON it begins with the public path prefix."""
