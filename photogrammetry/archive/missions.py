"""Differences between missions: names of instruments, frames and groups, stereo filters.

A new mission is one more record here: no reader of labels contains a mission's name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from solmap.photogrammetry.imagery import Eye

_EYES = {"LEFT": Eye.LEFT, "RIGHT": Eye.RIGHT}
_PRODUCTS = frozenset(
    # edr and inverse look-up table, full frame, sub-frame, down-sampled
    {"EFF", "ESF", "EDN", "ILF", "FFL", "ISF", "SFL", "INN", "DNL"}
    # radiometric, operations
    | {"RAD", "RAL", "MRD", "MRL", "RSD", "RSL"}
    # radiometric and I/F, science
    | {"RFD", "RFL", "IOF", "IOL", "IFF", "IFL", "CCD", "CCL", "CFD", "CFL"}
)
"""Product types of MER whose pixels are grey values, of the camera SIS."""


@dataclass(frozen=True, slots=True)
class Mission:
    """The peculiarities of one mission's labels."""

    hosts: tuple[str, ...]
    """INSTRUMENT_HOST_ID of its spacecraft."""
    instruments: Mapping[str, tuple[str, Eye]]
    """INSTRUMENT_ID -> instrument without the eye, and the eye."""
    mast_group: str
    """Group of the mast's frame in the rover: its x axis is the pointing direction in the label."""
    stereo_filters: Mapping[str, frozenset[tuple[int, int]]]
    """Instruments with filter wheels -> (left, right) filters of the same band."""
    mapping_products: frozenset[str] | None
    """Product types whose pixels are grey values of the scene; None: DERIVED_IMAGE_TYPE decides."""
    edr_types: tuple[str, ...] = ()
    """Product types of the archive's EDRs that are mapped; of several the first is fetched."""
    leaves_out_half_pixel: bool = False
    """Whether labels of averaged images scale H and V about a pixel's corner."""


MER = Mission(
    hosts=("MER1", "MER2"),
    instruments={
        **{
            f"{instrument}_{word}": (instrument, eye)
            for instrument in ("NAVCAM", "PANCAM", "FRONT_HAZCAM", "REAR_HAZCAM")
            for word, eye in _EYES.items()
        },
        "MI": ("MI", Eye.MONO),
        "DESCAM": ("DESCAM", Eye.MONO),
    },
    mast_group="PMA_COORDINATE_SYSTEM",
    stereo_filters={"PANCAM": frozenset({(2, 2), (7, 1)})},
    mapping_products=_PRODUCTS,
    edr_types=("EFF", "ESF", "EDN"),
    leaves_out_half_pixel=True,
)
"""Spirit (MER2) and Opportunity (MER1); product types from the camera SIS."""

MSL = Mission(
    hosts=("MSL",),
    instruments={
        **{
            f"{label}_{word}{string}": (instrument, eye)
            for label, instrument in (
                ("NAV", "NAVCAM"),
                ("FHAZ", "FRONT_HAZCAM"),
                ("RHAZ", "REAR_HAZCAM"),
                ("MAST", "MASTCAM"),
            )
            for word, eye in _EYES.items()
            for string in ("", "_A", "_B")
        },
        "CHEMCAM_RMI": ("CHEMCAM_RMI", Eye.MONO),
    },
    mast_group="RSM_COORDINATE_SYSTEM",
    # The eyes of Mastcam have focal lengths of 34 and 100 mm: not a pair for one matching window.
    stereo_filters={"MASTCAM": frozenset()},
    mapping_products=None,
    edr_types=("EDR",),
)
"""Curiosity; A and B are its two sets of engineering cameras, never used together."""

M2020 = Mission(
    hosts=("M20", "M2020"),
    instruments={
        **{
            f"{label}_{word}{string}": (instrument, eye)
            for label, instrument, strings in (
                ("NAVCAM", "NAVCAM", ("",)),
                ("FRONT_HAZCAM", "FRONT_HAZCAM", ("", "_A", "_B")),
                ("REAR_HAZCAM", "REAR_HAZCAM", ("",)),
                ("MCZ", "MASTCAM", ("",)),
            )
            for word, eye in _EYES.items()
            for string in strings
        },
        "SUPERCAM_RMI": ("SUPERCAM_RMI", Eye.MONO),
    },
    mast_group="RSM_COORDINATE_SYSTEM",
    stereo_filters={"MASTCAM": frozenset({(0, 0), (1, 1)})},
    mapping_products=None,
    edr_types=("ECM", "EDR"),
)
"""Perseverance; Mastcam-Z zooms both eyes together, and its narrow bands differ beyond filter 1."""

MISSIONS: tuple[Mission, ...] = (MER, MSL, M2020)


_OTHER_NAMES = {
    "SPIRIT": "MER2",
    "MERA": "MER2",
    "OPPORTUNITY": "MER1",
    "MERB": "MER1",
    "CURIOSITY": "MSL",
    "PERSEVERANCE": "M20",
    "M2020": "M20",
    "MARS2020": "M20",
}
"""Common names of a spacecraft, capital letters and digits only -> its identifier."""


def mission_id(name: str) -> str:
    """The identifier of a mission from any of its names: MER2 for `mer2`, `Spirit` and `MER-A`.

    Any other name becomes an identifier: its letters as capitals.
    """
    letters = re.sub(r"[^A-Z0-9]", "", name.upper())
    return _OTHER_NAMES.get(letters, name.strip().upper())


def mission_of_host(host: str, missions: Sequence[Mission] = MISSIONS) -> Mission | None:
    """The mission of a spacecraft, or None if it is not described here."""
    return next((mission for mission in missions if host in mission.hosts), None)
