"""Radiometric corrections that a label says were not made: companding and the flat field.

Before compression the flight software may squeeze the 4096 counts v of the converter into 256 codes
c by a table that follows the square root, because the noise of photons does. The label names the
table, SAMPLE_BIT_MODE_ID = LUT1, LUT2 ...; NONE is linear. The inverse tables lie in the archive's
calib folder and can be given (`config/instruments`). Without one the codes may be stretched by

    v = 4095 (c / 255)^2,

which is an approximation and says so. How good it is for LUT3 can be seen on an archived frame that
was inverted with the true table (Pancam, sol 4090): its 59 neighbouring values between 1284 and
2534 counts come out within 11 counts, where one step of the code is 18 to 25.

Codes left as they are do no harm to matching, which needs no photometry. They must not be mixed
with counts: a mosaic would show the seam, and radiance would be wrong.

A flat field F is the image of an even source, scaled to 1 in the middle; where the label says that
it was not taken out (FLAT_FIELD_CORRECTION_FLAG = FALSE and no radiometric correction), a pixel is
divided by it. Without a measured F the fall of light towards the edge may be modelled by

    F(r) = 1 + k1 r^2 + k2 r^4 + k3 r^6,        r in pixels from (x0, y0) divided by the half width,

whose coefficients are those of one camera. Flight values stand in the archive's calib folder and
were not at hand, so nothing is evened out unless a model or flat field is given. Matching compares
windows by correlation and does not need it; orthophotos and mosaics show the difference.

Flat fields belong to the full detector: those of sub-frames are cut out of it by FIRST_LINE and
FIRST_LINE_SAMPLE, those of averaged images averaged alike.

Tables and flat fields are those of a mission; an image needs few of them or none. What it needs,
`Radiometry.needed_by`, decides how its pixels are read: two sets of tables that need the same for
an image give the same pixels.
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
"""Name of the approximation, in what is reported."""
FlatField: TypeAlias = Float32[np.ndarray, "detector_lines detector_samples"]
"""Share of the light that reaches each pixel of a full frame, 1 in the middle."""
DETECTOR = 1024
"""Lines and samples of the full frame that a model of the fall of light is meant for."""
LEAST = 0.05
"""A lens that lets less than this through at the edge is no lens, but a fault of the model."""
NO_TABLE = "no inverse table was given"
NOT_PROPORTIONAL = "the flat field was not taken out: codes are not proportional to light"


@dataclass(frozen=True, slots=True, eq=False)
class InverseTable:
    """Counts of every code from 0 to 255."""

    name: str
    """SAMPLE_BIT_MODE_ID that it belongs to."""
    counts: Float32[np.ndarray, " codes"]
    source: str
    is_approximation: bool = False

    def __post_init__(self) -> None:
        counts = np.array(self.counts, dtype=np.float32)
        rising = counts.shape == (CODES,) and np.isfinite(counts).all() and counts[0] >= 0
        if not rising or (np.diff(counts) < 0).any():
            raise PixelError(
                f"inverse table {self.name}: expected {CODES} counts that do not fall, "
                f"found {counts.shape} from {self.source}"
            )
        counts.flags.writeable = False
        object.__setattr__(self, "counts", counts)


@dataclass(frozen=True, slots=True, eq=False)
class Companding:
    """The inverse tables at hand, and whether the approximation may stand in."""

    tables: Mapping[str, InverseTable] = field(default_factory=dict)
    approximate: bool = False

    def table(self, name: str) -> InverseTable | None:
        """The table of a SAMPLE_BIT_MODE_ID, the approximation where that is allowed, or None."""
        return self.tables.get(name) or (square_root_table(name) if self.approximate else None)


def square_root_table(name: str) -> InverseTable:
    """The approximation of the module's docstring."""
    codes = np.arange(CODES) / (CODES - 1)
    counts = (FULL_SCALE * codes**2).astype(np.float32)
    return InverseTable(name, counts, SQUARE_ROOT, is_approximation=True)


def companding_name(label: Label) -> str | None:
    """The table that the pixels are still coded by, or None where they are counts."""
    name = (label.optional(STATE, "SAMPLE_BIT_MODE_ID", str) or "NONE").upper()
    method = (label.optional(STATE, "SAMPLE_BIT_METHOD", str) or "").upper()
    in_bytes = label.optional("IMAGE", "SAMPLE_BITS", int) == BITS or full_scale(label) == CODES - 1
    return name if name.startswith("LUT") and "INVERTED" not in method and in_bytes else None


def expand_codes(codes: GreyImage, table: InverseTable) -> GreyImage:
    """Counts of coded pixels.

    Raises:
        PixelError: a pixel is above 255, so the pixels are no codes.
    """
    highest = float(codes.max(initial=0))
    if highest > CODES - 1:
        raise PixelError(
            f"pixels up to {highest:.0f} are no 8-bit codes of {table.name}; expected at most 255"
        )
    return table.counts[codes.astype(np.uint8)]


@dataclass(frozen=True, slots=True)
class RadialVignetting:
    """Fall of light from the middle of a full frame to its edge."""

    k1: float
    k2: float = 0.0
    k3: float = 0.0
    centre: tuple[float, float] | None = None
    """(sample, line) of the brightest place; None: the middle of the frame."""
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
                f"the vignetting model ({self.k1:g}, {self.k2:g}, {self.k3:g}) lets "
                f"{flat.min():.3g} through at the edge; expected more than {LEAST}"
            )
        return flat.astype(np.float32)


def needs_flat_field(label: Label) -> bool:
    """Whether the label says that the fall of light is still in the pixels."""
    groups = ("INSTRUMENT_STATE_PARMS", "OBSERVATION_REQUEST_PARMS")
    flags = [label.optional(group, "FLAT_FIELD_CORRECTION_FLAG", str) for group in groups]
    on_board = any((flag or "").upper() == "TRUE" for flag in flags[:1])
    on_ground = label.get("DERIVED_IMAGE_PARMS", "RADIOMETRIC_CORRECTION_TYPE") is not None
    linearised = label.optional("", "GEOMETRY_PROJECTION_TYPE", str) == "LINEARIZED"
    return not (on_board or on_ground or linearised) and any(flag is not None for flag in flags)


def divide_by_flat_field(
    pixels: GreyImage, label: Label, flat: FlatField | RadialVignetting
) -> GreyImage:
    """Pixels divided by the part of a full frame's flat field that they saw.

    Args:
        pixels: grey values as stored.
        label: says which part of the detector that is.
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
    """The flat field of the detector's part that an image shows, averaged as it was."""
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
    """What a label says was not done to the pixels yet."""

    code: str | None = None
    """SAMPLE_BIT_MODE_ID of the table that they are coded by; None: they are counts."""
    darkened_by: str | None = None
    """INSTRUMENT_ID of the camera whose fall of light is still in them; None: taken out."""

    @classmethod
    def of(cls, label: Label) -> PixelState:
        """As the label says."""
        camera = label.optional("", "INSTRUMENT_ID", str)
        return cls(companding_name(label), camera if needs_flat_field(label) else None)


@dataclass(frozen=True, slots=True, eq=False)
class Radiometry:
    """What is done to pixels that the label says are coded or darkened; nothing unless given."""

    companding: Companding = field(default_factory=Companding)
    flat_fields: Mapping[str, FlatField | RadialVignetting] = field(default_factory=dict)
    """By INSTRUMENT_ID, for the full frame."""

    @property
    def changes_nothing(self) -> bool:
        """Whether pixels stay as they are stored, whatever their label says."""
        companding = self.companding
        return not (companding.tables or companding.approximate or self.flat_fields)

    def needed_by(self, state: PixelState) -> Radiometry:
        """The part that changes pixels in this state.

        A flat field is of no use to codes without a table: they are not proportional to light.
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
    """Pixels with codes turned into counts and vignetting taken out, and what was done or not.

    Raises:
        PixelError: the pixels are no codes of the table, or not within the flat field.
    """
    state = PixelState.of(label)
    needed = radiometry.needed_by(state)
    notes = []
    if state.code is not None:
        table = needed.companding.table(state.code)
        if table is None:
            notes.append(f"pixels are 8-bit codes of {state.code}, no counts: {NO_TABLE}")
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
