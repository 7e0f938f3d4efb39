"""Public raw images: eight-bit JPEG and PNG pictures that come without a label of their own.

Their sizes are read from the header before anything is unpacked, so that a small file cannot ask
for much memory. Colour is averaged, as in images of three bands; what is black in runs is missing.
"""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.archive.pixels import in_runs
from solmap.photogrammetry.arrays import GreyImage, Mask
from solmap.photogrammetry.errors import PixelError

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"
MAX_PIXELS = 1 << 25
"""Twice the 5120 x 3840 pixels of the largest rover camera."""
SIZES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
"""JPEG markers of the segments that hold lines and samples."""


def is_picture(data: bytes) -> bool:
    """Whether a file starts like a PNG or JPEG."""
    return data.startswith((PNG, JPEG))


def read_picture(data: bytes, name: str) -> tuple[GreyImage, Mask]:
    """Grey values and mask of a JPEG or PNG file.

    Raises:
        PixelError: it is neither, too large, or broken.
    """
    samples, lines = picture_size(data, name)
    if not 1 <= samples * lines <= MAX_PIXELS:
        raise PixelError(f"{name}: {samples} x {lines} pixels: no rover image is that large")
    try:
        values = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise PixelError(f"{name}: cannot be unpacked: {error.err}") from error
    if values is None or values.shape[:2] != (lines, samples) or values.dtype != np.uint8:
        raise PixelError(f"{name}: cannot be unpacked as {samples} x {lines} pixels of 8 bits")
    colours = values.reshape(lines, samples, -1)[:, :, :3]
    lost = in_runs((colours == 0).all(axis=2))
    return colours.mean(axis=2, dtype=np.float32), ~lost


def picture_size(data: bytes, name: str) -> tuple[int, int]:
    """(samples, lines) of a JPEG or PNG file, of its header.

    Raises:
        PixelError: it is neither, or its header is broken.
    """
    if data.startswith(PNG) and data[12:16] == b"IHDR" and len(data) >= 24:  # noqa: PLR2004
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    position = 2 if data.startswith(JPEG) else len(data)
    while position + 9 <= len(data) and data[position] == 0xFF:  # noqa: PLR2004 - every marker
        if data[position + 1] in SIZES:
            return (
                int.from_bytes(data[position + 7 : position + 9], "big"),
                int.from_bytes(data[position + 5 : position + 7], "big"),
            )
        position += 2 + max(2, int.from_bytes(data[position + 2 : position + 4], "big"))
    raise PixelError(f"{name}: neither a PNG nor a JPEG picture with lines and samples")
