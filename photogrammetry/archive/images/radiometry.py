"""Radiometric corrections still to be made by the label: companding and the flat field.

Before compression the flight software may map the 4096 counts v of the converter to 256 codes c by
a table that follows the square root, as photon noise does. The label names the table,
SAMPLE_BIT_MODE_ID = LUT1, LUT2 ...; NONE is linear. The inverse tables are in the archive's calib
folder and can be configured (`config/instruments`). Without one the codes may be expanded by

    v = 4095 (c / 255)^2,

which is an approximation and reported as such. For LUT3 it was compared with an archived frame that
was inverted with the true table (Pancam, sol 4090): 59 neighbouring values between 1284 and 2534
counts agree within 11 counts, where one step of the code is 18 to 25.

Codes do not affect matching, which needs no photometry. They must not be mixed with counts: a
mosaic would show a seam, and radiance would be wrong.

A flat field F is the image of an even source, scaled to 1 in the middle; where the label states
that it was not corrected (FLAT_FIELD_CORRECTION_FLAG = FALSE and no radiometric correction), a
pixel is divided by it. Without a measured F the vignetting may be modelled by

    F(r) = 1 + k1 r^2 + k2 r^4 + k3 r^6,        r in pixels from (x0, y0) divided by the half width,

with coefficients for one camera. Flight values are in the archive's calib folder and not part of
solmap, so vignetting is corrected only if a model or flat field is given. Matching compares windows
by correlation and does not need it; orthophotos and mosaics show the difference.

Flat fields cover the full detector: those of sub-frames are cut out by FIRST_LINE and
FIRST_LINE_SAMPLE, those of averaged images are averaged in the same way.

Tables and flat fields are given for a mission; an image needs few of them or none. Its pixels
depend only on the part that it needs, `Radiometry.needed_by`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from solmap.photogrammetry.archive.images.pixels import full_scale
from solmap.photogrammetry.archive.images.rover_image import pixel_averaging
from solmap.photogrammetry.archive.labels.label import Label
from solmap.photogrammetry.arrays import Float32, GreyImage
from solmap.photogrammetry.errors import PixelError

STATE = "INSTRUMENT_STATE_PARMS"
BITS = 8
CODES = 1 << BITS
FULL_SCALE = 4095.0
SQUARE_ROOT = "square root"
"""Name of the approximation in reports."""
FlatField: TypeAlias = Float32[np.ndarray, "detector_lines detector_samples"]
"""Fraction of the light that reaches each pixel of a full frame, 1 in the middle."""
DETECTOR = 1024
"""Lines and samples of the full frame to which a vignetting model applies."""
LEAST = 0.05
"""Least transmission at the edge; less shows an error of the model."""
NO_TABLE = "no inverse table was given"
NOT_PROPORTIONAL = "the flat field was not corrected: codes are not proportional to light"


@dataclass(frozen=True, slots=True, eq=False)
class InverseTable:
    """Counts for every code from 0 to 255."""

    name: str
    """Its SAMPLE_BIT_MODE_ID."""
    counts: Float32[np.ndarray, " codes"]
    source: str
    is_approximation: bool = False

    def __post_init__(self) -> None:
        counts = np.array(self.counts, dtype=np.float32)
        rising = counts.shape == (CODES,) and np.isfinite(counts).all() and counts[0] >= 0
        if not rising or (np.diff(counts) < 0).any():
            raise PixelError(
                f"inverse table {self.name}: expected {CODES} non-decreasing counts, found "
                f"{counts.shape} from {self.source}"
            )
        counts.flags.writeable = False
        object.__setattr__(self, "counts", counts)


@dataclass(frozen=True, slots=True, eq=False)
class Companding:
    """The available inverse tables, and whether the approximation may be used instead."""

    tables: Mapping[str, InverseTable] = field(default_factory=dict)
    approximate: bool = False

    def table(self, name: str) -> InverseTable | None:
        """The table of a SAMPLE_BIT_MODE_ID, the approximation where allowed, or None."""
        return self.tables.get(name) or (square_root_table(name) if self.approximate else None)


def square_root_table(name: str) -> InverseTable:
    """The approximation of the module's docstring."""
    codes = np.arange(CODES) / (CODES - 1)
    counts = (FULL_SCALE * codes**2).astype(np.float32)
    return InverseTable(name, counts, SQUARE_ROOT, is_approximation=True)


def companding_name(label: Label) -> str | None:
    """The table by which the pixels are still coded, or None where they are counts."""
    name = (label.optional(STATE, "SAMPLE_BIT_MODE_ID", str) or "NONE").upper()
    method = (label.optional(STATE, "SAMPLE_BIT_METHOD", str) or "").upper()
    in_bytes = label.optional("IMAGE", "SAMPLE_BITS", int) == BITS or full_scale(label) == CODES - 1
    return name if name.startswith("LUT") and "INVERTED" not in method and in_bytes else None


def expand_codes(codes: GreyImage, table: InverseTable) -> GreyImage:
    """Counts of coded pixels.

    Raises:
        PixelError: a pixel is above 255, so the pixels are not codes.
    """
    highest = float(codes.max(initial=0))
    if highest > CODES - 1:
        raise PixelError(
            f"pixels up to {highest:.0f} are not 8-bit codes of {table.name}; expected at most 255"
        )
    return table.counts[codes.astype(np.uint8)]


@dataclass(frozen=True, slots=True)
class RadialVignetting:
    """Vignetting model from the middle of a full frame to its edge."""

    k1: float
    k2: float = 0.0
    k3: float = 0.0
    centre: tuple[float, float] | None = None
    """(sample, line) of the brightest point; None: the middle of the frame."""
    source: str = "given"

    def flat_field(self, lines: int, samples: int) -> FlatField:
        """F on a full frame.

        Raises:
            PixelError: F falls below `LEAST` inside the frame.
        """
        x0, y0 = self.centre or ((samples - 1) / 2, (lines - 1) / 2)
        half = max(lines, samples) / 2
        x, y = (np.arange(samples) - x0) / half, (np.arange(lines) - y0) / half
        square = y[:, None] ** 2 + x[None, :] ** 2
        flat = 1 + square * (self.k1 + square * (self.k2 + square * self.k3))
        if not flat.min() > LEAST:
            raise PixelError(
                f"the vignetting model ({self.k1:g}, {self.k2:g}, {self.k3:g}) transmits "
                f"{flat.min():.3g} at the edge; expected more than {LEAST}"
            )
        return flat.astype(np.float32)


def needs_flat_field(label: Label) -> bool:
    """Whether vignetting is still in the pixels, according to the label."""
    groups = ("INSTRUMENT_STATE_PARMS", "OBSERVATION_REQUEST_PARMS")
    flags = [label.optional(group, "FLAT_FIELD_CORRECTION_FLAG", str) for group in groups]
    on_board = any((flag or "").upper() == "TRUE" for flag in flags[:1])
    on_ground = label.get("DERIVED_IMAGE_PARMS", "RADIOMETRIC_CORRECTION_TYPE") is not None
    linearised = label.optional("", "GEOMETRY_PROJECTION_TYPE", str) == "LINEARIZED"
    return not (on_board or on_ground or linearised) and any(flag is not None for flag in flags)


def divide_by_flat_field(
    pixels: GreyImage, label: Label, flat: FlatField | RadialVignetting
) -> GreyImage:
    """Pixels divided by their part of a full frame's flat field.

    Args:
        pixels: grey values as stored.
        label: gives their part of the detector.
        flat: a flat field of the full frame, or its model.

    Raises:
        PixelError: the image is not within the flat field, or the field holds no transmission.
    """
    full = flat.flat_field(DETECTOR, DETECTOR) if isinstance(flat, RadialVignetting) else flat
    part = _part(full, label, *pixels.shape)
    if not (np.isfinite(part).all() and part.min() > 0):
        raise PixelError(f"{label.source}: the flat field holds values that are not above zero")
    return pixels / part


def _part(full: FlatField, label: Label, lines: int, samples: int) -> GreyImage:
    """The flat field of an image's detector region, averaged as the image was."""
    width, height = pixel_averaging(label)
    first_line = (label.optional("IMAGE", "FIRST_LINE", int) or 1) - 1
    first_sample = (label.optional("IMAGE", "FIRST_LINE_SAMPLE", int) or 1) - 1
    end_line, end_sample = first_line + lines * height, first_sample + samples * width
    if min(first_line, first_sample) < 0 or end_line > full.shape[0] or end_sample > full.shape[1]:
        raise PixelError(
            f"{label.source}: lines {first_line + 1}-{end_line}, samples {first_sample + 1}-"
            f"{end_sample} of the detector are not within the flat field of {full.shape[1]} x "
            f"{full.shape[0]}"
        )
    part = full[first_line:end_line, first_sample:end_sample]
    blocks = part.reshape(lines, height, samples, width)
    return blocks.mean(axis=(1, 3), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class PixelState:
    """Corrections that the label lists as not made yet."""

    code: str | None = None
    """SAMPLE_BIT_MODE_ID of the table by which they are coded; None: they are counts."""
    darkened_by: str | None = None
    """INSTRUMENT_ID of the camera whose vignetting is still in them; None: corrected."""

    @classmethod
    def of(cls, label: Label) -> PixelState:
        """According to the label."""
        camera = label.optional("", "INSTRUMENT_ID", str)
        return cls(companding_name(label), camera if needs_flat_field(label) else None)


@dataclass(frozen=True, slots=True, eq=False)
class Radiometry:
    """Tables for pixels that are coded or not flat-fielded; no correction without them."""

    companding: Companding = field(default_factory=Companding)
    flat_fields: Mapping[str, FlatField | RadialVignetting] = field(default_factory=dict)
    """Flat fields by INSTRUMENT_ID, for the full frame."""

    @property
    def changes_nothing(self) -> bool:
        """Whether no label's pixels would be changed."""
        companding = self.companding
        return not (companding.tables or companding.approximate or self.flat_fields)

    def needed_by(self, state: PixelState) -> Radiometry:
        """The part that changes pixels in this state.

        A flat field cannot be applied to codes without a table: they are not proportional to light.
        """
        table = self.companding.table(state.code) if state.code is not None else None
        flat = self.flat_fields.get(state.darkened_by or "")
        is_proportional = state.code is None or table is not None
        return Radiometry(
            Companding({} if table is None else {table.name: table}),
            {str(state.darkened_by): flat} if flat is not None and is_proportional else {},
        )


def correct_radiometry(
    pixels: GreyImage, label: Label, radiometry: Radiometry
) -> tuple[GreyImage, tuple[str, ...]]:
    """Pixels with codes expanded to counts and vignetting corrected, and notes on both.

    Raises:
        PixelError: the pixels are not codes of the table, or not within the flat field.
    """
    state = PixelState.of(label)
    needed = radiometry.needed_by(state)
    notes = []
    if state.code is not None:
        table = needed.companding.table(state.code)
        if table is None:
            notes.append(f"pixels are 8-bit codes of {state.code}, not counts: {NO_TABLE}")
            if state.darkened_by in radiometry.flat_fields:
                notes.append(NOT_PROPORTIONAL)
        else:
            pixels = expand_codes(pixels, table)
            if table.is_approximation:
                notes.append(
                    f"pixels are counts by the {table.source} approximation of {table.name}"
                )
    for flat in needed.flat_fields.values():
        pixels = divide_by_flat_field(pixels, label, flat)
    return pixels, tuple(notes)
