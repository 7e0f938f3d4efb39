"""Products of control: a frame, and where it shows stops."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from solmap.photogrammetry.adjustment.control_documents import (
    control_document,
    control_of_document,
    frame_document,
    frame_of_document,
)
from solmap.photogrammetry.adjustment.model.network import ControlFrame, StopControl
from solmap.products.errors import ProductError
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore

FORMAT = "solmap control 1"


def read_control(ref: ProductRef, store: ProductStore) -> tuple[ControlFrame, list[StopControl]]:
    """A control frame, and where it shows stops."""
    document = _read(ref, store)
    found = [control_of_document(row) for row in document["control"]]
    return frame_of_document(document["frame"]), found


def refused_stops(ref: ProductRef, store: ProductStore) -> dict[str, str]:
    """Stops that could not be found in an image, with the reason."""
    refused: dict[str, str] = _read(ref, store)["refused"]
    return refused


def _read(ref: ProductRef, store: ProductStore) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(store.path(ref).read_text())
    if document.get("format") != FORMAT:
        raise ProductError(
            f"{ref.scope.name}: {FORMAT!r} is expected, not {document.get('format')!r}; add the "
            "image or the file again with this version"
        )
    return document


def control_product(
    frame: ControlFrame, control: Sequence[StopControl], refused: dict[str, str]
) -> dict[str, Any]:
    """A product of control for JSON; `refused` are stops that were looked for in vain, and why."""
    return {
        "format": FORMAT,
        "frame": frame_document(frame),
        "control": [control_document(one) for one in control],
        "refused": refused,
    }
