"""What a label says was not done to its pixels yet, and doing it with what is at hand.

Two things may be undone: 12-bit counts may still be coded in 8 bits (`companding`), and the fall of
light towards the edge may still be in them (`vignetting`). Tables and flat fields are those of a
mission; an image needs few of them or none. What it needs, `Radiometry.needed_by`, decides how its
pixels are read: two sets of tables that need the same for an image give the same pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from solmap.photogrammetry.archive.companding import Companding, coded_by, expanded
from solmap.photogrammetry.archive.label import Label
from solmap.photogrammetry.archive.vignetting import (
    FlatField,
    RadialVignetting,
    evened_out,
    needs_flat_field,
)
from solmap.photogrammetry.arrays import GreyImage

NO_TABLE = "no inverse table was given"
NOT_PROPORTIONAL = "the flat field was not taken out: codes are not proportional to light"


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
        return cls(coded_by(label), camera if needs_flat_field(label) else None)


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


def radiometric(
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
            pixels = expanded(pixels, table)
            if table.is_approximation:
                notes.append(
                    f"pixels are counts by the {table.source} approximation of {table.name}"
                )
    for flat in needed.flat_fields.values():
        pixels = evened_out(pixels, label, flat)
    return pixels, tuple(notes)
