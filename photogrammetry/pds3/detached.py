"""A label in a file of its own, put before the data that it describes.

What is kept of an image is one file, so label and data are joined without changing either: in front
comes a line that says where the pixels are now, then the label, then the data file, whole,

    PDS_VERSION_ID = PDS3  ^IMAGE = 123457 <BYTES>   ...the label...   ...the file...

because the first of two equal keywords counts.
"""

from __future__ import annotations

from photogrammetry.errors import LabelError
from photogrammetry.pds3.label import MAX_LABEL_BYTES, parse_label
from photogrammetry.pds3.pixels import pixel_layout

BLOCK = 512
FRONT = "PDS_VERSION_ID = PDS3\r\n^IMAGE = {start:010d} <BYTES>\r\n"


def with_attached_label(data: bytes, label_text: str, name: str) -> bytes:
    """One file that reads like an image with an attached label.

    Raises:
        LabelError: the label is broken, too long, or does not say where its pixels are.
    """
    label = parse_label(label_text, name)
    offset = pixel_layout(label).offset
    text = label_text.encode("latin-1", "replace")
    size = len(FRONT.format(start=0)) + len(text) + 1
    size += -size % BLOCK
    if size > MAX_LABEL_BYTES:
        raise LabelError(f"{name}: the label of {len(text)} bytes is too long to be one")
    front = FRONT.format(start=size + offset + 1).encode("ascii")
    return (front + text + b"\n").ljust(size) + data


def file_of_label(label_text: str, name: str) -> str | None:
    """The data file that a detached label points to, or None where it names none.

    Raises:
        LabelError: the label is broken.
    """
    pointer = parse_label(label_text, name).get("", "^IMAGE")
    first = pointer[0] if isinstance(pointer, tuple) and pointer else pointer
    return first if isinstance(first, str) else None
