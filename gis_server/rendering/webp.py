"""Map tiles as WebP: shades of grey and photographs lossy, colours of a legend exact.

Two or three shades of 255 more or less, below the noise of a photograph, halve the bytes of a PNG;
values and classes are read from colours, so colours of a palette stay exact.
Transparency is exact in both. An orthophoto's tile takes 1.5 ms to encode and 12 kB, where PNG
takes 0.1 ms and 24 kB (`python -m tests.support.tile_forms STORE`).
"""

from __future__ import annotations

from io import BytesIO

import numpy as np
from PIL import Image

_QUALITY = 90
"""Root mean square of the change: 2 to 3 shades."""
_METHOD = 0
"""The fastest search; the next takes a third longer for 7 % fewer bytes."""
_EXACT_EFFORT, _EXACT_METHOD = 20, 2
"""Lossless: higher ones gain nothing on tiles, lower ones take more bytes than PNG."""
_OPAQUE = 255


def indexed_webp(indices: np.ndarray, palette: np.ndarray, opacity: bytes = b"\x00") -> bytes:
    """Encode an image of palette indices, like `png.indexed_png`."""
    colours = np.full((256, 4), _OPAQUE, np.uint8)
    colours[:, :3] = palette
    colours[: len(opacity), 3] = np.frombuffer(opacity, np.uint8)
    is_grey = bool((palette == palette[:, :1]).all())
    return _webp(colours[indices], is_exact=not is_grey)


def colour_webp(pixels: np.ndarray) -> bytes:
    """Encode an image of red, green and blue, like `png.colour_png`."""
    cover = np.where(pixels.any(axis=-1, keepdims=True), np.uint8(_OPAQUE), np.uint8(0))
    return _webp(np.concatenate((pixels, cover), axis=-1), is_exact=False)


def _webp(pixels: np.ndarray, *, is_exact: bool) -> bytes:
    """An image of red, green, blue and opacity."""
    if (pixels[..., 3] == _OPAQUE).all():
        pixels = np.ascontiguousarray(pixels[..., :3])
    body = BytesIO()
    quality, method = (_EXACT_EFFORT, _EXACT_METHOD) if is_exact else (_QUALITY, _METHOD)
    image = Image.fromarray(pixels)
    image.save(body, "WEBP", lossless=is_exact, quality=quality, method=method)
    return body.getvalue()
