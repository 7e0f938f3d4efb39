"""Pixels of an image file, and masks of measured, lost and saturated ones.

The pixels start at byte RECORD_BYTES (^IMAGE - 1) and are stored line by line, most flight images
as 16-bit big-endian integers. Packets lost in transmission are filled with zeros, and so is the
outside of a linearised image; MISSING_CONSTANT and INVALID_CONSTANT state this or may be absent.
But zero can also be the clipped value of a dark pixel of a radiance image. Pixels are lost in runs,
so for integer images a zero counts as missing where its patch of zeros contains a block of 3 x 3 or
a run of 9 along a line or column, and as dark otherwise. Any other constant, and zero in
floating-point rasters, always counts as missing.

Rovers compress images in rectangles (ICER: up to 32 segments). The label lists the first pixel and
the size of each, in lines and samples of the stored image from 1,

    INST_CMPRS_SEG_FIRST_LINE, INST_CMPRS_SEG_FIRST_LINE_SAMP, INST_CMPRS_SEG_LINES, ..._SAMPLES,

and its INST_CMPRS_SEGMENT_STATUS: 0 where it was received and decoded completely. The meaning of
the other codes is not documented here, so such a segment counts as lost.
INST_CMPRS_SEG_MISSING_PIXELS, where given, also marks segments that are missing completely.
Segments refer to the raw frame and cannot be used for a linearised image.

A pixel is saturated where the converter reached its maximum: 2^b - 1 for the b bits of
SAMPLE_BIT_MASK, 12 for a raw frame (4095) and 8 for one coded in 8 bits (255). It cannot be
detected in radiance images, which are scaled, and only approximately in linearised and averaged
ones.

Public raw images are eight-bit JPEG and PNG files without a label of their own. Their sizes are
read from the header before decoding, so that a small file cannot cause a large allocation. Black
runs count as missing.

Grey values of a colour image are the mean of its bands. A Bayer frame has one value per pixel,
behind red, green, green and blue filters (RGGB) in every square of two by two; red, green and blue
of all pixels are interpolated (`cv2.demosaicing`, bilinear), so that its grey values show no
checkerboard pattern.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.archive.labels.label import Label, Quantity, Value, number_of
from solmap.photogrammetry.archive.labels.vicar import vicar_label_end
from solmap.photogrammetry.arrays import Float32, GreyImage, Mask
from solmap.photogrammetry.errors import LabelError, PixelError
from solmap.photogrammetry.imagery import MAX_PIXELS

RUN = 9
"""Length of a run of zeros that occurs in lost segments but not in dark scenes."""
MAX_BANDS = 3
Colours = Float32[np.ndarray, "3 lines samples"]
"""Red, green and blue."""
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
"""SAMPLE_TYPE -> byte order and type of number."""

_SIZES = {"i": (8, 16, 32), "u": (8, 16, 32), "f": (32, 64)}
COMPRESSION = "COMPRESSION_PARMS"
WHOLE = frozenset({"0", "0X0", "OK"})
"""Codes of a segment that was received completely; VICAR's hexadecimal form, too."""
MAX_SEGMENTS = 4096
CONVERTER = 0xFFF
"""Largest count of the 12-bit converters of these cameras."""
EDGES = (
    "INST_CMPRS_SEG_FIRST_LINE",
    "INST_CMPRS_SEG_FIRST_LINE_SAMP",
    "INST_CMPRS_SEG_LINES",
    "INST_CMPRS_SEG_SAMPLES",
)
PNG = b"\x89PNG\r\n\x1a\n"
PNG_BITS = 24
"""Offset of the byte that gives the bits per colour."""
JPEG = b"\xff\xd8\xff"
JPEG_SCAN = b"\xff\xda"
"""First bytes of a scan; they do not occur within its data."""
MAX_SCANS = 32
"""Most scans of a JPEG, each of which decodes the whole image; progressive ones have about ten."""
SIZE_MARKERS = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
"""JPEG markers of the segments that hold lines and samples."""


@dataclass(frozen=True, slots=True)
class PixelLayout:
    """Offset of the pixels in the file, and their storage."""

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
        """Lines in the order of the file."""
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
        PixelError: the file is shorter than by its label, or its storage is not supported.
        LabelError: the label lacks what is needed to find the pixels.
    """
    values, measured = _stored_bands(data, label, source)
    return _finite(values[0] if len(values) == 1 else values.mean(0, np.float64), measured)


def read_colour_pixels(data: bytes, label: Label, source: str) -> tuple[Colours, Mask] | None:
    """Red, green and blue (DN) and the mask of measured pixels; None of an image of one band.

    Raises:
        PixelError: the file is shorter than by its label, or its storage is not supported.
        LabelError: the label lacks what is needed to find the pixels.
    """
    if pixel_layout(label).bands == 1:
        return None
    values, measured = _stored_bands(data, label, source)
    bands = [_finite(band, measured) for band in values]
    return np.stack([band for band, _ in bands]), np.logical_and.reduce([seen for _, seen in bands])


def _stored_bands(data: bytes, label: Label, source: str) -> tuple[np.ndarray, Mask]:
    layout = pixel_layout(label)
    if layout.end > len(data):
        raise PixelError(truncation_message(data, layout, source))
    values = stored_values(data, layout)
    missing = missing_constants(label)
    return values, np.logical_and.reduce([_measured_mask(band, missing) for band in values])


def _finite(values: np.ndarray, measured: Mask) -> tuple[GreyImage, Mask]:
    """Single precision, 0 where not measured or not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        pixels = values.astype(np.float32)
    if values.dtype.kind == "f":
        measured = measured & np.isfinite(pixels)
    pixels[~measured] = 0
    return pixels, measured


def demosaiced(mosaic: GreyImage, mask: Mask) -> Colours:
    """Red, green and blue of every pixel of a Bayer frame (RGGB), by its measured neighbours."""
    odd_line, odd_sample = (index % 2 for index in np.indices(mosaic.shape))
    weight = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], dtype=np.float32)

    def spread(values: np.ndarray) -> np.ndarray:
        return cv2.filter2D(
            values.astype(np.float32), -1, weight, borderType=cv2.BORDER_REFLECT_101
        )

    bands = []
    for colour in range(3):  # red has no odd index, green one, blue two
        own = mask & (odd_line + odd_sample == colour)
        total = np.maximum(spread(own), np.float32(1))
        bands.append(np.where(own, mosaic, spread(np.where(own, mosaic, 0)) / total))
    return np.stack(bands).astype(np.float32)


def pixel_layout(label: Label, *, most_bands: int | None = None) -> PixelLayout:
    """Location of the pixels by the label; of an image, unless `most_bands` is given.

    Raises:
        LabelError: a keyword is missing or impossible.
        PixelError: the storage of the pixels is not supported.
    """
    sizes = {keyword: label.require("IMAGE", keyword, int) for keyword in ("LINES", "LINE_SAMPLES")}
    bands = label.optional("IMAGE", "BANDS", int) or 1
    prefix = label.optional("IMAGE", "LINE_PREFIX_BYTES", int) or 0
    suffix = label.optional("IMAGE", "LINE_SUFFIX_BYTES", int) or 0
    for keyword, size in sizes.items():
        if size < 1:
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
    """Conversion of DN to radiance, where the label gives it."""
    factor = label.optional("DERIVED_IMAGE_PARMS", "RADIANCE_SCALING_FACTOR", float)
    if factor is None:
        return None
    offset = label.optional("DERIVED_IMAGE_PARMS", "RADIANCE_OFFSET", float)
    return RadianceScale(factor, offset or 0.0)


def truncation_message(data: bytes, layout: PixelLayout, source: str) -> str:
    """Message about a file that ends before its pixels do."""
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
        kind = "u"  # labels name MSB_INTEGER for bytes, too, but no camera has negative counts
    return np.dtype(f"{order}{kind}{bits // 8}")


def _storage(label: Label) -> str:
    storage = label.require("IMAGE", "BAND_STORAGE_TYPE", str).upper()
    if storage not in {"BAND_SEQUENTIAL", "LINE_INTERLEAVED", "SAMPLE_INTERLEAVED"}:
        raise PixelError(f"{label.source}: IMAGE/BAND_STORAGE_TYPE {storage[:40]!a} is not read")
    return storage


def _offset(label: Label) -> int:
    """First byte of the pixels, from ^IMAGE = 21, 40961 <BYTES>, or ("FILE.IMG", 21)."""
    pointer = label.get("", "^IMAGE")
    if pointer is None:
        raise LabelError(
            f"{label.source}: ^IMAGE, the position of the pixels, is missing from the label"
        )
    if isinstance(pointer, tuple):
        pointer = pointer[-1] if pointer else None
    if isinstance(pointer, str):
        return 0  # a separate file, from its first byte
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


def missing_constants(label: Label) -> tuple[float, ...]:
    """Values that mark missing pixels; zero is always one of them."""
    found = {0.0}
    for keyword in ("MISSING_CONSTANT", "INVALID_CONSTANT"):
        value = label.get("IMAGE", keyword)
        for item in value if isinstance(value, tuple) else (value,):
            bare = item.value if isinstance(item, Quantity) else item
            if isinstance(bare, int | float):
                found.add(float(bare))
    return tuple(sorted(found))


def _measured_mask(values: np.ndarray, missing: tuple[float, ...]) -> np.ndarray:
    """True where a pixel holds a measurement."""
    measured = np.isfinite(values) if values.dtype.kind == "f" else np.ones(values.shape, bool)
    for constant in missing:
        lost = values == constant
        if constant == 0 and values.dtype.kind != "f":
            lost = zeros_in_runs(lost)
        measured &= ~lost
    return measured


def zeros_in_runs(zero: np.ndarray) -> np.ndarray:
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


def received_mask(label: Label, lines: int, samples: int) -> Mask:
    """True where the segment of a pixel was received completely, or segments are not listed.

    Raises:
        LabelError: a segment is marked as lost, but its rectangle is not given by whole numbers.
    """
    mask = np.ones((lines, samples), dtype=bool)
    if label.optional("", "GEOMETRY_PROJECTION_TYPE", str) == "LINEARIZED":
        return mask
    statuses = _entries(label, "INST_CMPRS_SEGMENT_STATUS")
    missing = _entries(label, "INST_CMPRS_SEG_MISSING_PIXELS")
    for number in range(max(len(statuses), len(missing))):
        status = statuses[number] if number < len(statuses) else None
        gone = missing[number] if number < len(missing) else None
        if not _is_lost(status) and not _counts(gone):
            continue
        first_line, first_sample, height, width = _rectangle(label, number)
        if _is_lost(status) or _counts(gone) >= height * width:
            mask[first_line : first_line + height, first_sample : first_sample + width] = False
    return mask


def saturated_mask(pixels: GreyImage, label: Label) -> Mask:
    """True where the converter reached its maximum, as far as the label gives it."""
    limit = full_scale(label)
    return np.zeros(pixels.shape, dtype=bool) if limit is None else pixels >= limit


def full_scale(label: Label) -> int | None:
    """The largest count of the converter, or None where pixels are not counts."""
    if label.get("DERIVED_IMAGE_PARMS", "RADIANCE_SCALING_FACTOR") is not None:
        return None
    if label.optional("IMAGE", "BANDS", int) not in {None, 1}:
        return None
    mask = label.get("IMAGE", "SAMPLE_BIT_MASK")
    if isinstance(mask, str):  # VICAR writes only the digits
        mask = number_of(f"2#{mask.removeprefix('2#').removesuffix('#')}#")
    elif isinstance(mask, int) and set(str(mask)) <= {"0", "1"} and mask > 1:
        mask = int(str(mask), 2)
    if not isinstance(mask, int) or mask < 1 or mask & (mask + 1) or mask > CONVERTER:
        return None
    return mask


def _rectangle(label: Label, number: int) -> tuple[int, int, int, int]:
    """First line and sample from 0, lines and samples of a segment."""
    edges = []
    for keyword in EDGES:
        entries = _entries(label, keyword)
        edge = _bare_value(entries[number]) if number < len(entries) else None
        if not isinstance(edge, int) or edge < 1:
            raise LabelError(
                f"{label.source}: {COMPRESSION}/{keyword} should have a whole number above zero "
                f"for segment {number + 1}, which is marked as lost, but has {edge!a:.40}"
            )
        edges.append(edge)
    return edges[0] - 1, edges[1] - 1, edges[2], edges[3]


def _entries(label: Label, keyword: str) -> tuple[Value, ...]:
    value = label.get(COMPRESSION, keyword)
    if value is None:
        return ()
    return (value if isinstance(value, tuple) else (value,))[:MAX_SEGMENTS]


def _is_lost(status: Value) -> bool:
    """Whether a status is given and is not that of a complete segment."""
    bare = _bare_value(status)
    return bare is not None and str(bare).strip().upper() not in WHOLE


def _counts(gone: Value) -> int:
    bare = _bare_value(gone)
    return bare if isinstance(bare, int) and bare > 0 else 0


def _bare_value(value: Value) -> Value:
    bare = value.value if isinstance(value, Quantity) else value
    if isinstance(bare, str):
        number = number_of(bare)
        return bare if number is None else number
    return bare


def is_image_file(data: bytes) -> bool:
    """Whether a file starts like a PNG or JPEG."""
    return data.startswith((PNG, JPEG))


def read_image_file(data: bytes, name: str) -> tuple[GreyImage, Mask]:
    """Grey values and mask of a JPEG or PNG file.

    Raises:
        PixelError: it is neither, too large, or broken.
    """
    colours, mask = _unpacked(data, name)
    return colours.mean(axis=2, dtype=np.float32), mask


def read_colour_image_file(data: bytes, name: str) -> tuple[Colours, Mask] | None:
    """Red, green and blue and the mask of a JPEG or PNG file; None if it is grey.

    Raises:
        PixelError: it is neither, too large, or broken.
    """
    colours, mask = _unpacked(data, name)
    if (colours == colours[:, :, :1]).all():
        return None
    return colours[:, :, ::-1].transpose(2, 0, 1).astype(np.float32), mask


def _unpacked(data: bytes, name: str) -> tuple[np.ndarray, Mask]:
    """(lines, samples, 1 or 3) in 8 bits, blue first, and the mask."""
    samples, lines = image_file_size(data, name)
    if not 1 <= samples * lines <= MAX_PIXELS:
        raise PixelError(f"{name}: {samples} x {lines} pixels: no rover image is that large")
    bits = data[PNG_BITS] if data.startswith(PNG) else 8
    if bits > 8 or data.count(JPEG_SCAN) > MAX_SCANS:  # noqa: PLR2004 - one byte a colour
        raise PixelError(f"{name}: not an image of 8 bits in at most {MAX_SCANS} scans")
    try:
        values = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise PixelError(f"{name}: cannot be decoded: {error.err}") from error
    if values is None or values.shape[:2] != (lines, samples) or values.dtype != np.uint8:
        raise PixelError(f"{name}: cannot be decoded as {samples} x {lines} pixels of 8 bits")
    colours = values.reshape(lines, samples, -1)[:, :, :3]
    lost = zeros_in_runs((colours == 0).all(axis=2))
    return colours, ~lost


def image_file_size(data: bytes, name: str) -> tuple[int, int]:
    """(samples, lines) of a JPEG or PNG file, from its header.

    Raises:
        PixelError: it is neither, or its header is broken.
    """
    if data.startswith(PNG) and data[12:16] == b"IHDR" and len(data) > PNG_BITS:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    position = 2 if data.startswith(JPEG) else len(data)
    while position + 9 <= len(data) and data[position] == 0xFF:  # noqa: PLR2004 - every marker
        if data[position + 1] in SIZE_MARKERS:
            return (
                int.from_bytes(data[position + 7 : position + 9], "big"),
                int.from_bytes(data[position + 5 : position + 7], "big"),
            )
        position += 2 + max(2, int.from_bytes(data[position + 2 : position + 4], "big"))
    raise PixelError(f"{name}: neither a PNG nor a JPEG image with lines and samples")
