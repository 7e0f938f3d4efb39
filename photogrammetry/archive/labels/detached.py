"""A detached label and its data, joined into one file.

An image is stored as one file with its original bytes. If label and data were two files, a first
line gives the length of the label, and both follow unchanged:

    SOLMAP_DETACHED_LABEL = 0000026976   ...the label file...   ...the data file...

The label may be PDS3 (.lbl), PDS4 (.xml) or the metadata of a raw image of Mars 2020 (.json); its
first character identifies it.
"""

from __future__ import annotations

import re
from enum import StrEnum

from solmap.photogrammetry.archive.labels.label import MAX_LABEL_BYTES
from solmap.photogrammetry.errors import LabelError

FRONT = "SOLMAP_DETACHED_LABEL = {size:010d}\r\n"
MAX_DETACHED_BYTES = MAX_LABEL_BYTES - len(FRONT.format(size=0))
"""Limit such that the first megabyte of the joined file holds the whole label."""
_FRONT = re.compile(rb"SOLMAP_DETACHED_LABEL = (\d{10})\r\n")


class LabelKind(StrEnum):
    """Format of a detached label."""

    PDS3 = "PDS3"
    PDS4 = "PDS4"
    METADATA = "JSON metadata"


def join_label(label: bytes, data: bytes, name: str) -> bytes:
    """Label and data as one file.

    Raises:
        LabelError: the label is too long.
    """
    if len(label) > MAX_DETACHED_BYTES:
        raise LabelError(f"{name}: {len(label)} bytes are too many for a label")
    return FRONT.format(size=len(label)).encode("ascii") + label + data


def split_label(file: bytes, name: str) -> tuple[bytes | None, bytes]:
    """Label and data of `join_label`; for any other file None and the file unchanged.

    Raises:
        LabelError: the file ends before its label does.
    """
    front = _FRONT.match(file)
    if front is None:
        return None, file
    start, size = front.end(), int(front[1])
    if size > MAX_DETACHED_BYTES or start + size > len(file):
        raise LabelError(
            f"{name}: its detached label should be {size} bytes, but the file ends after "
            f"{len(file) - start}"
        )
    return file[start : start + size], file[start + size :]


def kind_of_label(text: str) -> LabelKind:
    """Format of a label."""
    start = text.lstrip("\ufeff \t\r\n")[:1]
    return {"<": LabelKind.PDS4, "{": LabelKind.METADATA}.get(start, LabelKind.PDS3)


def decode_label(label: bytes) -> str:
    """The characters of a label file: UTF-8 where valid, otherwise one per byte."""
    try:
        return label.decode("utf-8-sig")
    except UnicodeDecodeError:
        return label.decode("latin-1")
