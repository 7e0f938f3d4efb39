"""Evening out what the lens darkens: a flat field, or a radial model of it.

A flat field F is the image of an even source, scaled to 1 in the middle; where the label says that
it was not taken out (FLAT_FIELD_CORRECTION_FLAG = FALSE and no radiometric correction), a pixel is
divided by it. Without a measured F the fall of light towards the edge may be modelled by

    F(r) = 1 + k1 r^2 + k2 r^4 + k3 r^6,        r in pixels from (x0, y0) divided by the half width,

whose coefficients are those of one camera. Flight values stand in the archive's calib folder and
were not at hand, so nothing is evened out unless a model or flat field is given. Matching compares
windows by correlation and does not need it; orthophotos and mosaics show the difference.

Flat fields belong to the full detector: those of sub-frames are cut out of it by FIRST_LINE and
FIRST_LINE_SAMPLE, those of averaged images averaged alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from solmap.photogrammetry.archive.image import pixel_averaging
from solmap.photogrammetry.archive.label import Label
from solmap.photogrammetry.arrays import Float32, GreyImage
from solmap.photogrammetry.errors import PixelError

FlatField: TypeAlias = Float32[np.ndarray, "detector_lines detector_samples"]
"""Share of the light that reaches each pixel of a full frame, 1 in the middle."""

LEAST = 0.05
"""A lens that lets less than this through at the edge is no lens, but a fault of the model."""


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


def evened_out(
    pixels: GreyImage, label: Label, flat: FlatField | RadialVignetting, detector: int = 1024
) -> GreyImage:
    """Pixels divided by the part of a full frame's flat field that they saw.

    Args:
        pixels: grey values as stored.
        label: says which part of the detector that is.
        flat: a flat field of the full frame, or its model.
        detector: lines and samples of the full frame, for a model.

    Raises:
        PixelError: the image is not within the flat field, or the field holds no transmission.
    """
    full = flat.flat_field(detector, detector) if isinstance(flat, RadialVignetting) else flat
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
