"""Addresses under the path at which a reverse proxy serves the map, if it is not a host's root."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Annotated

from pydantic import PlainSerializer

ROOT_PATH: ContextVar[str] = ContextVar("root_path", default="")
"""The path of the public address, without a slash at its end; `PublicAddress` sets it."""


def _below_root(path: str) -> str:
    return ROOT_PATH.get() + path


ServerPath = Annotated[str, PlainSerializer(_below_root)]
"""A path of this server such as `/api/start`; JSON has it in the form for clients."""
