"""The one entrance for image files: bytes and a name in, record and pixels out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from photogrammetry.arrays import GreyImage, Mask
from photogrammetry.errors import FrameError, LabelError
from photogrammetry.imagery import RoverImage
from photogrammetry.pds3.companding import Companding, coded_by, expanded
from photogrammetry.pds3.image import rover_image
from photogrammetry.pds3.label import Label, label_text, parse_label
from photogrammetry.pds3.missions import MISSIONS, Mission
from photogrammetry.pds3.pds4 import parse_pds4_label
from photogrammetry.pds3.pixels import read_pixels
from photogrammetry.pds3.usability import received, saturated
from photogrammetry.pds3.vicar import START, parse_vicar_label
from photogrammetry.pds3.vignetting import FlatField, RadialVignetting, evened_out, needs_flat_field

BEGINNINGS = (b"PDS_VERSION_ID", b"ODL_VERSION_ID", b"CCSD")
"""What an attached label starts with; CCSD is the wrapper some volumes put before it."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadImage:
    """An image as it was read."""

    image: RoverImage
    pixels: GreyImage
    mask: Mask
    saturated: Mask = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    """True where the detector could not count further; such pixels are still in `mask`."""
    notes: tuple[str, ...] = ()
    """What is peculiar about the pixels, a line each: lost segments, codes in place of counts."""


@dataclass(frozen=True, slots=True, eq=False)
class Radiometry:
    """What is done to pixels that the label says are coded or darkened; nothing unless given."""

    companding: Companding = field(default_factory=Companding)
    flat_fields: Mapping[str, FlatField | RadialVignetting] = field(default_factory=dict)
    """By INSTRUMENT_ID, for the full frame."""


def read_image(
    data: bytes,
    name: str,
    missions: Sequence[Mission] = MISSIONS,
    *,
    detached_label: str | None = None,
    correct_half_pixel: bool = True,
    radiometry: Radiometry | None = None,
) -> ReadImage:
    """Record, grey values and mask of an image file.

    Args:
        data: the whole file.
        name: its name; says the product type and stands in every complaint.
        missions: whose labels are understood.
        detached_label: the text of a label in a file of its own, PDS3 or PDS4, if there is one.
        correct_half_pixel: put the camera model of averaged images right (see `image`).
        radiometry: tables of coded pixels and flat fields, where there are any.

    Raises:
        LabelError: the file has no label, or one that describes no mapping image.
        PixelError: the pixels are not what the label says.
    """
    label = _label(data, name, detached_label)
    image = _image(label, name, missions, correct_half_pixel=correct_half_pixel)
    pixels, mask = read_pixels(data, label, name)
    is_saturated = saturated(pixels, label)
    came_down = received(label, *pixels.shape)
    pixels, notes = _radiometric(pixels, label, radiometry or Radiometry())
    lost = int(np.count_nonzero(mask & ~came_down))
    if lost:
        notes = (f"{lost} pixels are masked: the label calls their segments lost", *notes)
    return ReadImage(image, pixels, mask & came_down, is_saturated & mask, notes)


def _radiometric(
    pixels: GreyImage, label: Label, radiometry: Radiometry
) -> tuple[GreyImage, tuple[str, ...]]:
    """Pixels with codes turned into counts and vignetting taken out, and what was done or not."""
    notes = []
    code = coded_by(label)
    if code is not None:
        table = radiometry.companding.table(code)
        if table is None:
            notes.append(f"pixels are 8-bit codes of {code}, no counts: no inverse table was given")
        else:
            pixels = expanded(pixels, table)
            if table.is_approximation:
                notes.append(f"pixels are counts by the {table.source} approximation of {code}")
    flat = radiometry.flat_fields.get(label.optional("", "INSTRUMENT_ID", str) or "")
    if flat is not None and needs_flat_field(label):
        if code is not None and notes and "no inverse" in notes[-1]:
            notes.append("the flat field was not taken out: codes are not proportional to light")
        else:
            pixels = evened_out(pixels, label, flat)
    return pixels, tuple(notes)


def read_image_record(
    data: bytes,
    name: str,
    missions: Sequence[Mission] = MISSIONS,
    *,
    detached_label: str | None = None,
    correct_half_pixel: bool = True,
) -> RoverImage:
    """The record alone; the first megabyte of the file is enough.

    Raises:
        LabelError: the file has no label, or one that describes no mapping image.
    """
    label = _label(data, name, detached_label)
    return _image(label, name, missions, correct_half_pixel=correct_half_pixel)


def read_label(data: bytes, name: str) -> Label:
    """The label at the start of a file, PDS3 or VICAR.

    Raises:
        LabelError: there is none, or it is broken.
    """
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


def has_attached_label(data: bytes) -> bool:
    """Whether a file starts like one that carries its label, PDS3 or VICAR."""
    return data.startswith(START) or data[:256].lstrip().upper().startswith(BEGINNINGS)


def _label(data: bytes, name: str, detached_label: str | None) -> Label:
    if detached_label is None:
        return read_label(data, name)
    if detached_label.lstrip("\ufeff \t\r\n").startswith("<"):
        return parse_pds4_label(detached_label, name)
    return parse_label(detached_label, name)


def _image(
    label: Label, name: str, missions: Sequence[Mission], *, correct_half_pixel: bool
) -> RoverImage:
    try:
        return rover_image(label, name, missions, correct_half_pixel=correct_half_pixel)
    except FrameError as error:
        raise LabelError(f"{name}: {error}") from error
