"""From 12 bits coded in 8 back to counts: inverse look-up tables, and what stands in for them.

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
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.archive.label import Label
from solmap.photogrammetry.archive.usability import full_scale
from solmap.photogrammetry.arrays import Float32, GreyImage
from solmap.photogrammetry.errors import PixelError

STATE = "INSTRUMENT_STATE_PARMS"
BITS = 8
CODES = 1 << BITS
FULL_SCALE = 4095.0
SQUARE_ROOT = "square root"
"""Name of the approximation, in what is reported."""


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


def coded_by(label: Label) -> str | None:
    """The table that the pixels are still coded by, or None where they are counts."""
    name = (label.optional(STATE, "SAMPLE_BIT_MODE_ID", str) or "NONE").upper()
    method = (label.optional(STATE, "SAMPLE_BIT_METHOD", str) or "").upper()
    in_bytes = label.optional("IMAGE", "SAMPLE_BITS", int) == BITS or full_scale(label) == CODES - 1
    return name if name.startswith("LUT") and "INVERTED" not in method and in_bytes else None


def expanded(codes: GreyImage, table: InverseTable) -> GreyImage:
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
