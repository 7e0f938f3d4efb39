"""Which pixels a label says are lost, and which ones the detector could not count further.

Rovers compress images in rectangles (ICER: up to 32 segments). The label lists where each starts
and how large it is, in lines and samples of the stored image from 1,

    INST_CMPRS_SEG_FIRST_LINE, INST_CMPRS_SEG_FIRST_LINE_SAMP, INST_CMPRS_SEG_LINES, ..._SAMPLES,

and its INST_CMPRS_SEGMENT_STATUS: 0 where it came down and was decoded whole. What another code
means bit by bit stands in documents that were not at hand, so such a segment is taken as lost.
A wholly missing one is named by INST_CMPRS_SEG_MISSING_PIXELS, too, where that is given. The
segments are those of the raw frame: for a linearised image they say nothing about where a pixel is.

A pixel is saturated where the converter reached its end: 2^b - 1 for the b bits that
SAMPLE_BIT_MASK has, of 12 for a raw frame (4095) and of 8 for one coded in 8 bits (255). Radiance
images are scaled and do not tell; linearised and averaged ones blur the limit.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.archive.label import Label, Quantity, Value, number_of
from solmap.photogrammetry.arrays import GreyImage, Mask
from solmap.photogrammetry.errors import LabelError

COMPRESSION = "COMPRESSION_PARMS"
WHOLE = frozenset({"0", "0X0", "OK"})
"""Codes of a segment that came down complete; VICAR's hexadecimal, too."""
MAX_SEGMENTS = 4096
CONVERTER = 0xFFF
"""Largest count of the 12-bit converters of these cameras."""
EDGES = (
    "INST_CMPRS_SEG_FIRST_LINE",
    "INST_CMPRS_SEG_FIRST_LINE_SAMP",
    "INST_CMPRS_SEG_LINES",
    "INST_CMPRS_SEG_SAMPLES",
)


def received(label: Label, lines: int, samples: int) -> Mask:
    """True where the segment of a pixel came down whole, or nothing is said of segments.

    Raises:
        LabelError: a segment is called lost, but its place is no rectangle of whole numbers.
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


def saturated(pixels: GreyImage, label: Label) -> Mask:
    """True where the converter reached its end, as far as the label tells where that is."""
    limit = full_scale(label)
    return np.zeros(pixels.shape, dtype=bool) if limit is None else pixels >= limit


def full_scale(label: Label) -> int | None:
    """The largest count of the converter, or None where pixels are not counts."""
    if label.get("DERIVED_IMAGE_PARMS", "RADIANCE_SCALING_FACTOR") is not None:
        return None
    if label.optional("IMAGE", "BANDS", int) not in {None, 1}:
        return None
    mask = label.get("IMAGE", "SAMPLE_BIT_MASK")
    if isinstance(mask, str):  # VICAR writes the digits alone
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
        edge = _bare(entries[number]) if number < len(entries) else None
        if not isinstance(edge, int) or edge < 1:
            raise LabelError(
                f"{label.source}: {COMPRESSION}/{keyword} should have a whole number above zero "
                f"for segment {number + 1}, which is called lost, but has {edge!a:.40}"
            )
        edges.append(edge)
    return edges[0] - 1, edges[1] - 1, edges[2], edges[3]


def _entries(label: Label, keyword: str) -> tuple[Value, ...]:
    value = label.get(COMPRESSION, keyword)
    if value is None:
        return ()
    return (value if isinstance(value, tuple) else (value,))[:MAX_SEGMENTS]


def _is_lost(status: Value) -> bool:
    """Whether a status is given and is not that of a whole segment."""
    bare = _bare(status)
    return bare is not None and str(bare).strip().upper() not in WHOLE


def _counts(gone: Value) -> int:
    bare = _bare(gone)
    return bare if isinstance(bare, int) and bare > 0 else 0


def _bare(value: Value) -> Value:
    bare = value.value if isinstance(value, Quantity) else value
    if isinstance(bare, str):
        number = number_of(bare)
        return bare if number is None else number
    return bare
