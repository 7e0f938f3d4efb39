"""What a run is called on its page: what it does, of which mission and sols."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

from httpx import HTTPError
from prefect import runtime
from prefect.client.orchestration import get_client
from prefect.context import FlowRunContext

from solmap.photogrammetry.imagery import RoverImage

log = logging.getLogger(__name__)
_SPANS = 3
"""Spans of sols that are named one by one."""


def folder_name() -> str:
    """Of a downlink before anything is known of it but its folder."""
    return f"downlink {Path(str(runtime.flow_run.parameters['downlink'])).name}"


def mission_name() -> str:
    """Of a flow over one mission or all: its own name and which."""
    return f"{runtime.flow_run.flow_name} {runtime.flow_run.parameters['mission'] or 'of all'}"


def downlink_name(images: Iterable[RoverImage]) -> str:
    """As `downlink MER2 sol 156-160`, for what came."""
    sols: dict[str, set[int]] = {}
    for image in images:
        sols.setdefault(image.stop.mission, set()).add(image.sol)
    return "downlink " + ", ".join(f"{name} sol {sols_text(of)}" for name, of in sols.items())


def sols_text(sols: Iterable[int]) -> str:
    """Sols as spans: `156-160,163`; many spans as one, with their number."""
    known = sorted(set(sols))
    starts = [known[0], *(b for a, b in pairwise(known) if b != a + 1)]
    ends = [*(a for a, b in pairwise(known) if b != a + 1), known[-1]]
    if len(starts) > _SPANS:
        return f"{known[0]}-{known[-1]} ({len(known)} sols)"
    return ",".join(_span(a, b) for a, b in zip(starts, ends, strict=True))


def rename_run(name: str) -> None:
    """Call the run that this is so; nothing depends on it."""
    context = FlowRunContext.get()
    if context is None or context.flow_run is None:
        return
    try:
        with get_client(sync_client=True) as client:
            client.update_flow_run(context.flow_run.id, name=name)
    except HTTPError as error:
        log.warning("the run could not be called %r: %s", name, error)


def _span(first: int, last: int) -> str:
    return str(first) if first == last else f"{first}-{last}"
