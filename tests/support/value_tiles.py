"""Tiles of values, read back: inverse of `rendering.tiles.encode_values`, as the viewer has it."""

from __future__ import annotations

import struct

import numpy as np

_HEADER = struct.Struct("<4sHHdd")
_MAGIC = b"SMV1"


def decode_values(body: bytes) -> np.ndarray:
    """Values of a tile, float32 with NaN where nothing was measured.

    Raises:
        ValueError: the body is none of a tile of values.
    """
    if len(body) < _HEADER.size or body[:4] != _MAGIC:
        raise ValueError(f"a tile of values starts with {_MAGIC!r}, not with {body[:4]!r}")
    _, columns, rows, offset, step = _HEADER.unpack_from(body)
    if len(body) != _HEADER.size + 2 * rows * columns:
        raise ValueError(f"{len(body)} bytes are not a tile of {rows} x {columns} values")
    low, high = np.frombuffer(body, np.uint8, offset=_HEADER.size).reshape(2, rows, columns)
    change = low.astype(np.uint16) | (high.astype(np.uint16) << 8)
    steps = np.cumsum(change, axis=1, dtype=np.uint16)
    return np.where(steps > 0, offset + step * steps, np.nan).astype(np.float32)
