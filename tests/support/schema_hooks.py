"""Hooks of schemathesis: places that exist, in place of most that were drawn at random.

A random scope, kind and digest names no product, and every question would end as 404. Here some
questions keep what was drawn and the others are given the names of things that are in the store, as
`SOLMAP_NAMES` lists them (a file of JSON: a list of sets of path parameters).
"""

from __future__ import annotations

import json
import os
import zlib
from pathlib import Path
from typing import Any

import schemathesis

KEPT_OF = 5
"""One request out of this many keeps the path that was drawn."""


def _names() -> list[dict[str, Any]]:
    return json.loads(Path(os.environ["SOLMAP_NAMES"]).read_text())


def places(drawn: dict[str, Any], names: list[dict[str, Any]]) -> dict[str, Any]:
    """The parameters of a path, some of them replaced by those of one thing that exists."""
    number = zlib.crc32(repr(sorted(drawn.items())).encode("utf-8", "replace"))
    if number % KEPT_OF == 0:
        return drawn
    fitting = [row for row in names if drawn.keys() & row.keys()]
    for_all = [row for row in fitting if drawn.keys() <= row.keys()] or fitting
    if not for_all:
        return drawn
    chosen = for_all[number // KEPT_OF % len(for_all)]
    return {key: chosen.get(key, value) for key, value in drawn.items()}


@schemathesis.hook
def map_path_parameters(_context: Any, path_parameters: dict[str, Any]) -> dict[str, Any]:
    return places(path_parameters, _names()) if path_parameters else path_parameters
