"""The memory of a sequential adjustment as a plain document, and back bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import Memory
from solmap.photogrammetry.imagery import StopId

Document = dict[str, Any]


def memory_document(memory: Memory) -> Document:
    """A memory for JSON."""
    names = ("rotations", "centres", "pointings", "root", "right")
    return {
        "window": [_name(stop) for stop in memory.window],
        "stops": [_name(stop) for stop in memory.stops],
        "pairs": list(memory.pair_ids),
        **{name: getattr(memory, name).tolist() for name in names},
        "spent": memory.spent,
        "surplus": memory.surplus,
        "grounded": list(memory.grounded),
        "frames": list(memory.frames),
        "frame_places": memory.frame_places.tolist(),
    }


def memory_of_document(document: Document) -> Memory:
    """The memory that `memory_document` wrote."""
    stops, right = document["stops"], np.array(document["right"], dtype=np.float64)
    pairs, frames = document["pairs"], document.get("frames", [])
    return Memory(
        tuple(StopId(**stop) for stop in document["window"]),
        tuple(StopId(**stop) for stop in stops),
        tuple(pairs),
        _array(document, "rotations", -1, 3, 3),
        _array(document, "centres", -1, 3),
        _array(document, "pointings", -1, 3),
        _array(document, "root", len(right), 6 * len(stops) + 3 * len(pairs) + 5 * len(frames)),
        right,
        document["spent"],
        document["surplus"],
        tuple(document["grounded"]),
        tuple(frames),
        _array(document, "frame_places", -1, 5) if frames else np.zeros((0, 5)),
    )


def _name(stop: StopId) -> Document:
    return {"mission": stop.mission, "site": stop.site, "drive": stop.drive}


def _array(document: Document, name: str, *shape: int) -> np.ndarray:
    return np.array(document[name], dtype=np.float64).reshape(shape)
