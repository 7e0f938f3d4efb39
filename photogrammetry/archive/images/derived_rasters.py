"""Derived rasters of JPL's stereo pipeline: disparity, XYZ, range, normals, slopes, with masks.

    DIS, DIL   2 bands, line and sample: where the partner image shows the same point, as absolute
               1-based coordinates (not as a difference); (0, 0) where it was not found
    DSS, DLS   the sample or the line band alone
    XYZ, XYL   3 bands: x north, y east, z down in metres, in the frame named in the label;
               XXX, YYY, ZZZ one of them; (0, 0, 0) where nothing was found
    RNG, RNL   metres from the centre C of the camera; 0 where nothing was found
    UVW, UVL   3 bands: unit normal of the ground, in the frame named in the label
    SLP, SLL   slope in degrees; SHP its heading, SMP its magnitude sqrt(u^2 + v^2), SNL its tilt to
               the north, SRD its part in the direction of the rover
    SEP, RUF   fraction of the sun's energy from 0 to 1; roughness in metres

as IEEE floats in the byte order of SAMPLE_TYPE. Disparities are returned 0-based, as (sample, line)
like every image point here. In a raster of one band a true 0 cannot be distinguished from a missing
value and counts as missing; with three bands a pixel is missing only if all three are 0.

`solmap inspect` prints the content of such a file. XYZ with mask and frame are the input for
importing archived products as dense points.

Source: VICAR's help of marscor3, marsxyz, marsuvw and marsslope, and the data set descriptions. The
reader was tested on bytes written in this layout, not on an archived product.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.archive.file_names import parse_file_name
from solmap.photogrammetry.archive.images.pixels import (
    missing_constants,
    pixel_layout,
    stored_values,
    truncation_message,
)
from solmap.photogrammetry.archive.images.reading import read_label
from solmap.photogrammetry.archive.labels.detached import split_label
from solmap.photogrammetry.archive.labels.label import Label
from solmap.photogrammetry.arrays import Float32, Mask
from solmap.photogrammetry.errors import LabelError, PixelError
from solmap.photogrammetry.frames import Frame, FrameKind, rover_frame, site_frame

DERIVED = "DERIVED_IMAGE_PARMS"


class RasterKind(StrEnum):
    """Content of the bands."""

    DISPARITY = "disparity"
    DISPARITY_SAMPLE = "disparity, sample"
    DISPARITY_LINE = "disparity, line"
    XYZ = "xyz"
    X = "x"
    Y = "y"
    Z = "z"
    RANGE = "range"
    NORMAL = "surface normal"
    SLOPE = "slope"
    SLOPE_HEADING = "slope heading"
    SLOPE_MAGNITUDE = "slope magnitude"
    NORTHERLY_TILT = "northerly tilt"
    ROVER_SLOPE = "slope in the rover's direction"
    SOLAR_ENERGY = "solar energy"
    ROUGHNESS = "roughness"


_ALIKE: Mapping[RasterKind, tuple[str, ...]] = {
    RasterKind.DISPARITY: ("DIS", "DIL", "DISPARITY_MAP"),
    RasterKind.DISPARITY_SAMPLE: ("DSS", "DSL", "DISPARITY_SAMPLE_MAP"),
    RasterKind.DISPARITY_LINE: ("DLS", "DLL", "DISPARITY_LINE_MAP"),
    RasterKind.XYZ: ("XYZ", "XYL", "XYZ_MAP"),
    RasterKind.X: ("XXX", "XXL", "X_MAP"),
    RasterKind.Y: ("YYY", "YYL", "Y_MAP"),
    RasterKind.Z: ("ZZZ", "ZZL", "Z_MAP"),
    RasterKind.RANGE: ("RNG", "RNL", "RANGE_MAP"),
    RasterKind.NORMAL: ("UVW", "UVL", "UVW_MAP"),
    RasterKind.SLOPE: ("SLP", "SLL", "SLOPE_MAP"),
    RasterKind.SLOPE_HEADING: ("SHP", "SHL"),
    RasterKind.SLOPE_MAGNITUDE: ("SMP", "SML"),
    RasterKind.NORTHERLY_TILT: ("SNL",),
    RasterKind.ROVER_SLOPE: ("SRD", "SRL"),
    RasterKind.SOLAR_ENERGY: ("SEP", "SEL"),
    RasterKind.ROUGHNESS: ("RUF", "RUL", "ROUGHNESS_MAP"),
}
KINDS = {name: kind for kind, names in _ALIKE.items() for name in names}
"""Product type of the file name, or DERIVED_IMAGE_TYPE of the label -> kind."""

BANDS = {
    RasterKind.DISPARITY: ("sample", "line"),
    RasterKind.XYZ: ("x", "y", "z"),
    RasterKind.NORMAL: ("u", "v", "w"),
}
"""Names of the bands; those of any other kind have the kind's own."""
UNITS = {
    **dict.fromkeys(
        (RasterKind.DISPARITY, RasterKind.DISPARITY_SAMPLE, RasterKind.DISPARITY_LINE), "px"
    ),
    **dict.fromkeys(
        (RasterKind.XYZ, RasterKind.X, RasterKind.Y, RasterKind.Z, RasterKind.RANGE), "m"
    ),
    **dict.fromkeys(
        (
            RasterKind.SLOPE,
            RasterKind.SLOPE_HEADING,
            RasterKind.NORTHERLY_TILT,
            RasterKind.ROVER_SLOPE,
        ),
        "degree",
    ),
    RasterKind.ROUGHNESS: "m",
}
"""Units of kinds that have one."""
IN_FRAME = frozenset({RasterKind.XYZ, RasterKind.X, RasterKind.Y, RasterKind.Z, RasterKind.NORMAL})
"""Kinds whose values refer to the frame named in the label."""


@dataclass(frozen=True, slots=True, eq=False)
class DerivedRaster:
    """A derived raster as read."""

    kind: RasterKind
    bands: Float32[np.ndarray, "bands lines samples"]
    """Bands in the order of `band_names`; disparities 0-based. 0 outside the mask."""
    mask: Mask
    """True where there is a value."""
    frame: Frame | None
    """The frame of XYZ and normals; None for other kinds."""
    partner: str | None
    """The target image of a disparity, where the label names its sources."""

    @property
    def band_names(self) -> tuple[str, ...]:
        """Content of each band."""
        return BANDS.get(self.kind, (str(self.kind),))

    @property
    def unit(self) -> str | None:
        """Unit of the values of all bands; None where they have none."""
        return UNITS.get(self.kind)


def read_raster(data: bytes, name: str) -> DerivedRaster:
    """A derived raster from a file with its label attached or joined to it (`detached`).

    Raises:
        LabelError: the file holds no derived raster, or its label lacks what is needed.
        PixelError: the values contradict the label.
    """
    label = read_label(data, name)
    _, data = split_label(data, name)
    kind = raster_kind(label, name)
    if kind is None:
        raise LabelError(
            f"{name}: not a supported derived raster; kinds are {', '.join(RasterKind)}"
        )
    layout = pixel_layout(label, most_bands=3)
    expected = len(BANDS.get(kind, (kind,)))
    if layout.bands != expected or layout.dtype.kind != "f":
        raise PixelError(
            f"{name}: {kind} should be {expected} bands of IEEE reals, but is {layout.bands} of "
            f"{layout.dtype}"
        )
    if layout.end > len(data):
        raise PixelError(truncation_message(data, layout, name))
    with np.errstate(over="ignore", invalid="ignore"):
        bands = stored_values(data, layout).astype(np.float32)
    mask = _value_mask(bands, missing_constants(label))
    frame = _frame(label) if kind in IN_FRAME else None
    if kind is RasterKind.DISPARITY:
        bands = bands[::-1]  # line, sample -> sample, line
    if "disparity" in kind:
        bands = bands - np.float32(1)
    return DerivedRaster(kind, np.where(mask, bands, 0), mask, frame, _partner(label, kind))


def raster_kind(label: Label, name: str) -> RasterKind | None:
    """The kind of a raster by its DERIVED_IMAGE_TYPE or, failing that, its file name.

    None for other kinds.
    """
    stated = label.optional(DERIVED, "DERIVED_IMAGE_TYPE", str) or ""
    try:
        product = parse_file_name(name).product_type
    except LabelError:
        product = ""
    return KINDS.get(stated.upper()) or KINDS.get(product)


def _value_mask(bands: np.ndarray, missing: tuple[float, ...]) -> Mask:
    """True where a value was found: finite, and not a constant in every band."""
    found = np.isfinite(bands).all(axis=0)
    for constant in missing:
        found &= ~(bands == np.float32(constant)).all(axis=0)
    return found


def _frame(label: Label) -> Frame:
    """The frame of XYZ values, with its counters."""
    name = label.require(DERIVED, "REFERENCE_COORD_SYSTEM_NAME", str).upper()
    index = label.require_numbers(DERIVED, "REFERENCE_COORD_SYSTEM_INDEX")
    counter = tuple(int(value) for value in index if float(value).is_integer() and value >= 0)
    if name == "SITE_FRAME" and len(counter) == len(index) >= 1:
        return site_frame(counter[0])
    if name in {"ROVER_FRAME", "ROVER_NAV_FRAME"} and len(counter) == len(index) >= 2:  # noqa: PLR2004 - site, drive
        return rover_frame(counter[0], counter[1])
    if name == "LOCAL_LEVEL_FRAME":
        return Frame(FrameKind.LOCAL_LEVEL, counter)
    raise LabelError(
        f"{label.source}: {DERIVED}/REFERENCE_COORD_SYSTEM_NAME and _INDEX should name a site or "
        f"rover frame and its counters, but are {name[:40]!a} and {index[:10].tolist()}"
    )


def _partner(label: Label, kind: RasterKind) -> str | None:
    """The second of two source products."""
    sources = label.get("", "SOURCE_PRODUCT_ID")
    if "disparity" not in kind or not isinstance(sources, tuple) or len(sources) != 2:  # noqa: PLR2004 - a pair
        return None
    return str(sources[1])
