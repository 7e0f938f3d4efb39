"""Map tiles as PNG: indexed, 256 colours of which the first is transparent, or in true colour.

Most map tiles show one quantity, so one byte per pixel and a palette are equivalent to three
colours and alpha, in a fifth of the time and less than half the bytes. Rows contain the difference
to the row above (PNG filter 2), which suits a palette whose order is that of the quantity.

Deflate, the compression of PNG and of HTTP's gzip, is Intel's ISA-L: it compresses a tile of noisy
ground six times faster than zlib and to fewer bytes, 0.26 ms and 43 kB against 1.6 ms and 46 kB
for an orthophoto. It searches in uninitialised memory: equal data may give streams that differ by
a byte or two.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from isal import isal_zlib

_FAST = 1
_ZLIB_BITS, _GZIP_BITS = 15, 31
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_UP = 2
_INDEXED, _TRUE_COLOUR = 3, 2


def zlib_stream(data: bytes) -> bytes:
    """Compress to a zlib stream."""
    return isal_zlib.compress(data, _FAST, _ZLIB_BITS)


def gzip_stream(data: bytes) -> bytes:
    """Compress to a gzip stream, without the time."""
    return isal_zlib.compress(data, _FAST, _GZIP_BITS)


def gunzip(stream: bytes) -> bytes:
    """Uncompressed content of a gzip stream."""
    return isal_zlib.decompress(stream, _GZIP_BITS)


def indexed_png(indices: np.ndarray, palette: np.ndarray, opacity: bytes = b"\x00") -> bytes:
    """Encode an image of palette indices; index 0 is transparent.

    Args:
        indices: uint8, rows by columns.
        palette: uint8, 256 rows of red, green and blue.
        opacity: Of the first indices, 0 to 255; those that follow are opaque.
    """
    transparent = _chunk(b"tRNS", opacity)
    return _png(indices[:, :, None], _INDEXED, _chunk(b"PLTE", palette.tobytes()) + transparent)


def colour_png(pixels: np.ndarray) -> bytes:
    """Encode an image of red, green and blue; black, 0 0 0, is transparent.

    Args:
        pixels: uint8, rows by columns by 3.
    """
    return _png(pixels, _TRUE_COLOUR, _chunk(b"tRNS", bytes(6)))


def _png(pixels: np.ndarray, colour_type: int, notes: bytes) -> bytes:
    """An image of bytes, rows by columns by bands; `notes` are the chunks before the data."""
    rows, columns, bands = pixels.shape
    flat = pixels.reshape(rows, columns * bands)
    lines = np.empty((rows, columns * bands + 1), np.uint8)
    lines[:, 0] = _UP
    lines[0, 1:] = flat[0]
    np.subtract(flat[1:], flat[:-1], out=lines[1:, 1:])  # modulo 256, as the format requires
    header = struct.pack(">IIBBBBB", columns, rows, 8, colour_type, 0, 0, 0)
    end = (_chunk(b"IDAT", zlib_stream(lines.tobytes())), _chunk(b"IEND", b""))
    return b"".join((_SIGNATURE, _chunk(b"IHDR", header), notes, *end))


def _chunk(name: bytes, data: bytes) -> bytes:
    return b"".join(
        (
            struct.pack(">I", len(data)),
            name,
            data,
            struct.pack(">I", zlib.crc32(data, zlib.crc32(name))),
        )
    )
