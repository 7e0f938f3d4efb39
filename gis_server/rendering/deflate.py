"""Deflate, the compression of PNG and of HTTP's gzip.

Intel's ISA-L compresses a tile of noisy ground six times faster than zlib and to fewer bytes:
0.26 ms and 43 kB against 1.6 ms and 46 kB for an orthophoto. It searches in memory that nobody
cleared: equal data gives streams that differ by a byte or two at times.
"""

from __future__ import annotations

from isal import isal_zlib

_FAST = 1
_ZLIB_BITS, _GZIP_BITS = 15, 31


def zlib_stream(data: bytes) -> bytes:
    """Compress to a zlib stream."""
    return isal_zlib.compress(data, _FAST, _ZLIB_BITS)


def gzip_stream(data: bytes) -> bytes:
    """Compress to a gzip stream, without the time."""
    return isal_zlib.compress(data, _FAST, _GZIP_BITS)


def gunzipped(stream: bytes) -> bytes:
    """What a gzip stream holds."""
    return isal_zlib.decompress(stream, _GZIP_BITS)
