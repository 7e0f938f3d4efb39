"""Pixels of a PDS3 image, and the mask of those that were measured.

The pixels start at byte RECORD_BYTES (^IMAGE - 1) and are stored line by line, most flight images
as 16-bit big-endian integers. Packets that were lost on the way down are filled with zeros, and so
is the outside of a linearised image; MISSING_CONSTANT and INVALID_CONSTANT say so or may be absent.
But zero can also be what a dark pixel of a radiance image was cut off at. What was lost is lost in
runs, so for integer images a zero counts as missing where its patch of zeros holds a block of
3 x 3 or a run of 9 along a line or column, and as dark otherwise. Any other constant is taken at
its word, and in floating-point rasters zero is, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.archive.label import Label, Quantity, Value
from solmap.photogrammetry.archive.vicar import vicar_label_end
from solmap.photogrammetry.arrays import GreyImage, Mask
from solmap.photogrammetry.errors import LabelError, PixelError

RUN = 9
"""Zeros in a row that no dark scene makes, but the shortest line of a lost segment does."""
MAX_BANDS = 3
MAX_PIXELS = 1 << 28
_BIG, _LITTLE = ">", "<"

SAMPLE_TYPES: Mapping[str, tuple[str, str]] = {
    **dict.fromkeys(("MSB_INTEGER", "INTEGER", "SUN_INTEGER", "MAC_INTEGER"), (_BIG, "i")),
    **dict.fromkeys(
        ("MSB_UNSIGNED_INTEGER", "UNSIGNED_INTEGER", "SUN_UNSIGNED_INTEGER"), (_BIG, "u")
    ),
    **dict.fromkeys(("LSB_INTEGER", "PC_INTEGER", "VAX_INTEGER"), (_LITTLE, "i")),
    **dict.fromkeys(
        ("LSB_UNSIGNED_INTEGER", "PC_UNSIGNED_INTEGER", "VAX_UNSIGNED_INTEGER"), (_LITTLE, "u")
    ),
    **dict.fromkeys(("IEEE_REAL", "REAL", "FLOAT", "SUN_REAL", "MAC_REAL"), (_BIG, "f")),
    "PC_REAL": (_LITTLE, "f"),
}
"""SAMPLE_TYPE -> byte order and kind of number."""

_SIZES = {"i": (8, 16, 32), "u": (8, 16, 32), "f": (32, 64)}


@dataclass(frozen=True, slots=True)
class PixelLayout:
    """Where the pixels are and how they are stored."""

    offset: int
    """Bytes before the first line."""
    lines: int
    samples: int
    bands: int
    storage: str
    """BAND_SEQUENTIAL, LINE_INTERLEAVED or SAMPLE_INTERLEAVED."""
    dtype: np.dtype
    prefix_bytes: int
    suffix_bytes: int

    @property
    def line_bytes(self) -> int:
        """Bytes of one stored line."""
        across = self.bands if self.storage != "BAND_SEQUENTIAL" else 1
        return self.prefix_bytes + self.samples * across * self.dtype.itemsize + self.suffix_bytes

    @property
    def stored_lines(self) -> int:
        """Lines as they follow each other in the file."""
        return self.lines * (self.bands if self.storage == "BAND_SEQUENTIAL" else 1)

    @property
    def end(self) -> int:
        """First byte after the pixels."""
        return self.offset + self.stored_lines * self.line_bytes


@dataclass(frozen=True, slots=True)
class RadianceScale:
    """Radiance = DN * factor + offset, W m^-2 sr^-1 nm^-1."""

    factor: float
    offset: float


def read_pixels(data: bytes, label: Label, source: str) -> tuple[GreyImage, Mask]:
    """Grey values (DN) and the mask of measured pixels.

    Raises:
        PixelError: the file is shorter than its label says, or stored in a way that is not read.
        LabelError: the label lacks what is needed to find the pixels.
    """
    layout = pixel_layout(label)
    if layout.end > len(data):
        raise PixelError(too_short(data, layout, source))
    values = stored_values(data, layout)
    missing = constants(label)
    measured = _measured(values[0], missing)
    for band in values[1:]:
        measured &= _measured(band, missing)
    grey = values[0] if len(values) == 1 else values.mean(axis=0, dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        pixels = np.where(measured, grey, 0).astype(np.float32)
    finite = np.isfinite(pixels)
    return np.where(finite, pixels, np.float32(0)), measured & finite


def pixel_layout(label: Label, *, most_bands: int | None = None) -> PixelLayout:
    """Where the label says the pixels are; of an image, unless `most_bands` is given.

    Raises:
        LabelError: a keyword is missing or impossible.
        PixelError: the pixels are stored in a way that is not read.
    """
    sizes = {keyword: label.require("IMAGE", keyword, int) for keyword in ("LINES", "LINE_SAMPLES")}
    bands = label.optional("IMAGE", "BANDS", int) or 1
    prefix = label.optional("IMAGE", "LINE_PREFIX_BYTES", int) or 0
    suffix = label.optional("IMAGE", "LINE_SUFFIX_BYTES", int) or 0
    for keyword, size in sizes.items():
        if not 1 <= size <= MAX_PIXELS:
            raise LabelError(f"{label.source}: IMAGE/{keyword} should be above zero, but is {size}")
    if sizes["LINES"] * sizes["LINE_SAMPLES"] > MAX_PIXELS:
        raise LabelError(
            f"{label.source}: IMAGE/LINES x IMAGE/LINE_SAMPLES is {sizes['LINES']} x "
            f"{sizes['LINE_SAMPLES']}: no rover image is that large"
        )
    fitting = {1, MAX_BANDS} if most_bands is None else set(range(1, most_bands + 1))
    if bands not in fitting or prefix < 0 or suffix < 0:
        raise PixelError(
            f"{label.source}: IMAGE has {bands} bands, {prefix} prefix and {suffix} suffix bytes; "
            f"expected {' or '.join(map(str, sorted(fitting)))} bands"
        )
    return PixelLayout(
        offset=_offset(label),
        lines=sizes["LINES"],
        samples=sizes["LINE_SAMPLES"],
        bands=bands,
        storage=_storage(label) if bands > 1 else "BAND_SEQUENTIAL",
        dtype=_dtype(label),
        prefix_bytes=prefix,
        suffix_bytes=suffix,
    )


def radiance_scale(label: Label) -> RadianceScale | None:
    """How DN become radiance, where the label says so."""
    factor = label.optional("DERIVED_IMAGE_PARMS", "RADIANCE_SCALING_FACTOR", float)
    if factor is None:
        return None
    offset = label.optional("DERIVED_IMAGE_PARMS", "RADIANCE_OFFSET", float)
    return RadianceScale(factor, offset or 0.0)


def too_short(data: bytes, layout: PixelLayout, source: str) -> str:
    """What is wrong with a file that ends before its pixels do."""
    text = (
        f"{source}: truncated: needs {layout.end} bytes for {layout.lines} lines of "
        f"{layout.samples} samples from byte {layout.offset} (^IMAGE), has {len(data)}"
    )
    start = vicar_label_end(data)
    if start is not None and start + layout.end - layout.offset <= len(data):
        text += f"; its VICAR label ends at byte {start}, so ^IMAGE was probably altered"
    return text


def stored_values(data: bytes, layout: PixelLayout) -> np.ndarray:
    """Values as (bands, lines, samples), as they are stored."""
    lines = np.ndarray(
        (layout.stored_lines, layout.line_bytes), np.uint8, data, offset=layout.offset
    )
    stop = layout.line_bytes - layout.suffix_bytes
    values = np.ascontiguousarray(lines[:, layout.prefix_bytes : stop]).view(layout.dtype)
    if layout.storage == "SAMPLE_INTERLEAVED":
        return values.reshape(layout.lines, layout.samples, layout.bands).transpose(2, 0, 1)
    if layout.storage == "LINE_INTERLEAVED":
        return values.reshape(layout.lines, layout.bands, layout.samples).transpose(1, 0, 2)
    return values.reshape(layout.bands, layout.lines, layout.samples)


def _dtype(label: Label) -> np.dtype:
    sample_type = label.require("IMAGE", "SAMPLE_TYPE", str).upper()
    bits = label.require("IMAGE", "SAMPLE_BITS", int)
    order, kind = SAMPLE_TYPES.get(sample_type, ("", ""))
    if bits not in _SIZES.get(kind, ()):
        raise PixelError(
            f"{label.source}: IMAGE/SAMPLE_TYPE {sample_type[:40]!a} of {bits} bits is not read; "
            "expected integers of 8, 16 or 32 bits or IEEE reals of 32 or 64"
        )
    if bits == 8:  # noqa: PLR2004 - one byte
        kind = "u"  # labels say MSB_INTEGER of bytes, too, but no camera counts below zero
    return np.dtype(f"{order}{kind}{bits // 8}")


def _storage(label: Label) -> str:
    storage = label.require("IMAGE", "BAND_STORAGE_TYPE", str).upper()
    if storage not in {"BAND_SEQUENTIAL", "LINE_INTERLEAVED", "SAMPLE_INTERLEAVED"}:
        raise PixelError(f"{label.source}: IMAGE/BAND_STORAGE_TYPE {storage[:40]!a} is not read")
    return storage


def _offset(label: Label) -> int:
    """Byte at which the pixels start, of ^IMAGE = 21, 40961 <BYTES>, or ("FILE.IMG", 21)."""
    pointer = label.get("", "^IMAGE")
    if pointer is None:
        raise LabelError(f"{label.source}: ^IMAGE is missing from the label: where are the pixels?")
    if isinstance(pointer, tuple):
        pointer = pointer[-1] if pointer else None
    if isinstance(pointer, str):
        return 0  # a file of its own, from its first byte
    position = _whole(pointer)
    if position is None or position < 1:
        raise LabelError(
            f"{label.source}: ^IMAGE should be a record or byte number, but is {pointer!a:.60}"
        )
    if isinstance(pointer, Quantity) and pointer.unit.upper().startswith("BYTE"):
        return position - 1
    record_bytes = label.require("", "RECORD_BYTES", int)
    if record_bytes < 1:
        raise LabelError(f"{label.source}: RECORD_BYTES should be above zero, not {record_bytes}")
    return (position - 1) * record_bytes


def _whole(value: Value) -> int | None:
    bare = value.value if isinstance(value, Quantity) else value
    return bare if isinstance(bare, int) else None


def constants(label: Label) -> tuple[float, ...]:
    """Values that stand for nothing measured; zero is always one of them."""
    found = {0.0}
    for keyword in ("MISSING_CONSTANT", "INVALID_CONSTANT"):
        value = label.get("IMAGE", keyword)
        for item in value if isinstance(value, tuple) else (value,):
            bare = item.value if isinstance(item, Quantity) else item
            if isinstance(bare, int | float):
                found.add(float(bare))
    return tuple(sorted(found))


def _measured(values: np.ndarray, missing: tuple[float, ...]) -> np.ndarray:
    """True where a pixel holds a measurement."""
    measured = np.isfinite(values) if values.dtype.kind == "f" else np.ones(values.shape, bool)
    for constant in missing:
        lost = values == constant
        if constant == 0 and values.dtype.kind != "f":
            lost = in_runs(lost)
        measured &= ~lost
    return measured


def in_runs(zero: np.ndarray) -> np.ndarray:
    """The patches of `zero` that hold a block of 3 x 3 or a run of `RUN`."""
    if not zero.any():
        return zero
    image = zero.astype(np.uint8)
    core = np.zeros(zero.shape, dtype=bool)
    for rows, cols in ((3, 3), (1, RUN), (RUN, 1)):
        kernel = np.ones((min(rows, zero.shape[0]), min(cols, zero.shape[1])), np.uint8)
        core |= cv2.morphologyEx(image, cv2.MORPH_OPEN, kernel) > 0
    count, patches = cv2.connectedComponents(image, connectivity=8)
    is_lost = np.zeros(count, dtype=bool)
    is_lost[patches[core]] = True
    return is_lost[patches]
