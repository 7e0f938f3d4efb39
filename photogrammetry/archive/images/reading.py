"""Read any image file: bytes and a name in, record and pixels out.

A file has an attached label (PDS3, VICAR), or it is joined to a detached one (`detached`): PDS3,
PDS4, the JSON metadata of a raw image of Mars 2020, or the record made when an image of an own
stereo rig was ingested. Its pixels are stored as described in the label, or as PNG or JPEG.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.archive.images.json_metadata import rover_image_of_metadata
from solmap.photogrammetry.archive.images.pixels import (
    Colours,
    demosaiced,
    image_file_size,
    is_image_file,
    read_colour_image_file,
    read_colour_pixels,
    read_image_file,
    read_pixels,
    received_mask,
    saturated_mask,
)
from solmap.photogrammetry.archive.images.radiometry import (
    PixelState,
    Radiometry,
    correct_radiometry,
)
from solmap.photogrammetry.archive.images.record_json import START as RECORD
from solmap.photogrammetry.archive.images.record_json import label_of_text
from solmap.photogrammetry.archive.images.rover_image import rover_image
from solmap.photogrammetry.archive.labels.detached import (
    LabelKind,
    decode_label,
    kind_of_label,
    split_label,
)
from solmap.photogrammetry.archive.labels.label import Label, label_text, parse_label
from solmap.photogrammetry.archive.labels.pds4 import parse_pds4_label
from solmap.photogrammetry.archive.labels.vicar import START, parse_vicar_label
from solmap.photogrammetry.arrays import GreyImage, Mask
from solmap.photogrammetry.errors import FrameError, LabelError, PixelError
from solmap.photogrammetry.imagery import RoverImage

BEGINNINGS = (b"PDS_VERSION_ID", b"ODL_VERSION_ID", b"CCSD")
"""First bytes of an attached label; CCSD is the wrapper that some volumes put before it."""
_ENCODED = re.compile(r"[NFRZ][LR](?:E_\d{4}_|._\d{4}_\d{10}_\d{3}EBY)", re.ASCII)


@dataclass(frozen=True, slots=True, eq=False)
class ReadImage:
    """An image as read."""

    image: RoverImage
    pixels: GreyImage
    mask: Mask
    saturated: Mask = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    """True where the detector was saturated; such pixels are still in `mask`."""
    notes: tuple[str, ...] = ()
    """Notes on the pixels, one per line: lost segments, codes in place of counts."""


@dataclass(frozen=True, slots=True, eq=False)
class DescribedImage:
    """An image file whose label was read, but not its pixels."""

    image: RoverImage
    label: Label | None
    """The label; None if JSON replaces it: metadata, or the record of an own stereo rig's image."""
    data: bytes
    """The file with the pixels."""

    @property
    def is_mosaic(self) -> bool:
        """Whether the image is a Bayer frame, by the label or the name of the product.

        Names of Mars 2020 have E (encoded) for the colour, or EBY for the product type; a file with
        several colours is not a Bayer frame.
        """
        label = self.label
        if label is not None and (label.optional("IMAGE", "BANDS", int) or 1) > 1:
            return False
        state = None if label is None else label.get("IMAGE", "COLOR_FILTER_ARRAY_STATE")
        if state is not None:
            return state == "ENCODED"
        return _ENCODED.match(self.image.id) is not None and not (
            is_image_file(self.data) and read_colour_image_file(self.data, self.image.id)
        )

    @property
    def state(self) -> PixelState:
        """Corrections not yet made to the pixels; JSON metadata do not state any."""
        return PixelState() if self.label is None else PixelState.of(self.label)


def read_image(
    data: bytes,
    name: str,
    *,
    detached_label: str | None = None,
    radiometry: Radiometry | None = None,
) -> ReadImage:
    """Record, grey values and mask of an image file.

    Args:
        data: the whole file.
        name: its name; gives the product type and is part of every message.
        detached_label: the text of a label in a file of its own, if there is one beside `data`.
        radiometry: tables of coded pixels and flat fields, where there are any.

    Raises:
        LabelError: the file has no label, or one that does not describe a mapping image.
        PixelError: the pixels contradict the label.
    """
    described = describe_image(data, name, detached_label=detached_label)
    return read_described_image(described, name, radiometry=radiometry)


def read_described_image(
    described: DescribedImage, name: str, *, radiometry: Radiometry | None = None
) -> ReadImage:
    """Record, grey values and mask of an image file whose label was read.

    Args:
        described: the file with its label.
        name: its name; part of every message.
        radiometry: tables of coded pixels and flat fields, where there are any.

    Raises:
        PixelError: the pixels contradict the label.
    """
    image, label = described.image, described.label
    pixels, mask = _stored_pixels(described, name)
    if label is None:
        return ReadImage(image, _grey(pixels, mask, described), mask)
    is_saturated = saturated_mask(pixels, label)
    came_down = received_mask(label, *pixels.shape)
    pixels, notes = correct_radiometry(pixels, label, radiometry or Radiometry())
    lost = int(np.count_nonzero(mask & ~came_down))
    if lost:
        notes = (
            f"{lost} pixels are masked: their segments are marked as lost in the label",
            *notes,
        )
    mask &= came_down
    return ReadImage(image, _grey(pixels, mask, described), mask, is_saturated & mask, notes)


def read_colour(data: bytes, name: str) -> tuple[Colours, Mask] | None:
    """Red, green and blue as stored, and the mask, of an image file; None if it has no colour.

    Raises:
        LabelError: the file has no label, or one that does not describe a mapping image.
        PixelError: the pixels contradict the label.
    """
    described = describe_image(data, name)
    if described.is_mosaic:
        pixels, mask = _stored_pixels(described, name)
        return demosaiced(pixels, mask), mask
    if described.label is None or is_image_file(described.data):
        return read_colour_image_file(described.data, name)
    return read_colour_pixels(described.data, described.label, name)


def _grey(pixels: GreyImage, mask: Mask, described: DescribedImage) -> GreyImage:
    if not described.is_mosaic:
        return pixels
    return np.where(mask, demosaiced(pixels, mask).mean(axis=0), np.float32(0))


def read_image_record(data: bytes, name: str, *, detached_label: str | None = None) -> RoverImage:
    """Only the record; the first megabyte of the file is enough.

    Raises:
        LabelError: the file has no label, or one that does not describe a mapping image.
    """
    return describe_image(data, name, detached_label=detached_label).image


def describe_image(data: bytes, name: str, *, detached_label: str | None = None) -> DescribedImage:
    """The record and the label it was read from.

    Raises:
        LabelError: the file has no label, or one that does not describe a mapping image.
    """
    if detached_label is None:
        detached_label, data = _split_detached(data, name)
    if detached_label is not None and detached_label.startswith(RECORD):
        return DescribedImage(label_of_text(detached_label, name), None, data)
    if detached_label is not None and kind_of_label(detached_label) is LabelKind.METADATA:
        return DescribedImage(rover_image_of_metadata(detached_label, name), None, data)
    label = _label(data, name, detached_label)
    try:
        image = rover_image(label, name)
    except FrameError as error:
        raise LabelError(f"{name}: {error}") from error
    return DescribedImage(image, label, data)


def read_label(data: bytes, name: str) -> Label:
    """The label of a file: PDS3 or VICAR at its start, or the detached one it is joined to.

    Raises:
        LabelError: there is none, or it is broken.
    """
    text, data = _split_detached(data, name)
    return _label(data, name, text)


def has_attached_label(data: bytes) -> bool:
    """Whether a file starts with its label, PDS3 or VICAR."""
    return data.startswith(START) or data[:256].lstrip().upper().startswith(BEGINNINGS)


def _split_detached(data: bytes, name: str) -> tuple[str | None, bytes]:
    label, data = split_label(data, name)
    return None if label is None else decode_label(label), data


def _label(data: bytes, name: str, detached_label: str | None) -> Label:
    if detached_label is None:
        return _attached_label(data, name)
    match kind_of_label(detached_label):
        case LabelKind.PDS4:
            return parse_pds4_label(detached_label, name)
        case LabelKind.PDS3:
            return parse_label(detached_label, name)
        case LabelKind.METADATA:
            raise LabelError(f"{name}: it has JSON metadata instead of a label")


def _attached_label(data: bytes, name: str) -> Label:
    if not data:
        raise LabelError(f"{name}: the file is empty")
    if data.startswith(START):
        return parse_vicar_label(data, name)
    if not has_attached_label(data):
        start = data[:24].decode("latin-1").strip()
        raise LabelError(
            f"{name}: not a PDS3 image: it starts with {start!a}, "
            "where PDS_VERSION_ID or ODL_VERSION_ID was expected"
        )
    return parse_label(label_text(data), name)


def _stored_pixels(described: DescribedImage, name: str) -> tuple[GreyImage, Mask]:
    """Grey values and mask as stored in the file."""
    image, data = described.image, described.data
    if described.label is not None and not is_image_file(data):
        return read_pixels(data, described.label, name)
    samples, lines = image_file_size(data, name)
    if (lines, samples) != (image.lines, image.samples):
        raise PixelError(
            f"{name}: the image is {samples} x {lines} pixels, its label has {image.samples} x "
            f"{image.lines}"
        )
    return read_image_file(data, name)
