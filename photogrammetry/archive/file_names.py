"""Parse archive file names: spacecraft, instrument, spacecraft clock, product, site and drive.

MER names have 27 characters, e.g. 2N292280938EFFB100P0703L0M1: spacecraft, instrument, clock (9),
product type (3), site (2), drive (2), sequence (5), eye, filter, producer, version. Site and drive
are coded, with A = 0:

    00-99
    A0-ZZ = 100 + 36 x first letter + second character (digit, or 10 + letter)
    0A-9Z = 1036 + 26 x digit + letter

## and __ mean 1296 or more; the exact number is only in the label.

MSL names have 36 characters, e.g. NLB_517261274EDR_F0541610CCAM15900M1: camera, eye, computer
string (A or B), clock, product type, geometry (L linearised), frame type (full, sub-frame,
thumbnail ...), site (3), drive (4), sequence (9), producer, version.

Mars 2020 names have 54 characters, e.g. NLF_0629_0722782785_631ECM_N0301344NCAM00427_06_095J01:
camera, eye, colour, sol, clock with its thousandths, product type, geometry (L linearised), frame
type, site, drive, sequence, four characters with a meaning for each camera (Navcam and Hazcam: tile
and averaging, Mastcam-Z: focal length in millimetres and averaging), compression, producer,
version. Names on the public image website and PDS4 identifiers omit the version.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from solmap.photogrammetry.errors import LabelError

_CODE = r"(?:\d\d|[A-Z][A-Z0-9]|\d[A-Z]|##|__)"
_MER = re.compile(
    r"(?P<spacecraft>[1-4])(?P<instrument>[NPFRMEABDT])(?P<clock>\d{9})(?P<product>[A-Z0-9]{3})"
    rf"(?P<site>{_CODE})(?P<drive>{_CODE})(?P<sequence>[A-Z]\d{{4}})(?P<eye>[LRMN])"
    r"(?P<filter>\d)(?P<producer>[A-Z])(?P<version>[0-9A-Z])\Z",
    re.ASCII,
)
_MSL = re.compile(
    r"(?P<instrument>[A-Z])(?P<eye>[LR])(?P<string>[AB_])_(?P<clock>\d{9})(?P<product>[A-Z0-9]{3})"
    r"(?P<geometry>[L_])(?P<frame>[A-Z])(?P<site>\d{3})(?P<drive>\d{4})(?P<sequence>[A-Z0-9_]{9})"
    r"(?P<producer>[A-Z_])(?P<version>[0-9A-Z_])\Z",
    re.ASCII,
)

_M2020 = re.compile(
    r"(?P<instrument>[NFRZ])(?P<eye>[LR])(?P<colour>[A-Z0-9_])_(?P<sol>\d{4})_(?P<clock>\d{10})_\d{3}"
    r"(?P<product>[A-Z0-9]{3})(?P<geometry>[A-Z_])(?P<frame>[A-Z])(?P<site>[A-Z0-9]{3})"
    r"(?P<drive>[A-Z0-9]{4})(?P<sequence>[A-Z0-9_]{9})_(?P<tile_or_zoom>[A-Z0-9_]{3})"
    r"(?P<averaging>[A-Z0-9_])[A-Z0-9_]{2}"
    r"(?P<producer>[A-Z_])(?P<version>[A-Z0-9_]{2}|)\Z",
    re.ASCII,
)

SOL_S = 88775.42064
"""Length of a sol, seconds."""
SOL_ZERO = {"MER1": 128141132, "MER2": 126322960, "MSL": 397446400}
"""Spacecraft clock at the beginning of sol 0, seconds (MER: public AI4Mars scripts, checked on
labels; MSL: derived from five labels)."""

SPACECRAFT = {"1": "MER1", "2": "MER2", "3": "MER1-TEST", "4": "MER2-TEST"}
MER_INSTRUMENTS = {
    "N": "NAVCAM",
    "P": "PANCAM",
    "F": "FRONT_HAZCAM",
    "R": "REAR_HAZCAM",
    "M": "MI",
    "E": "DESCAM",
    "A": "APXS",
    "B": "MOESSBAUER",
    "D": "RAT",
    "T": "MINI-TES",
}
M2020_INSTRUMENTS = {
    "N": "NAVCAM",
    "F": "FRONT_HAZCAM",
    "R": "REAR_HAZCAM",
    "Z": "MASTCAM",
}
MSL_INSTRUMENTS = {"N": "NAVCAM", "F": "FRONT_HAZCAM", "R": "REAR_HAZCAM"}


@dataclass(frozen=True, slots=True)
class FileName:
    """The parts of a file name."""

    product_id: str
    """The name without folder and extension, upper case."""
    mission: str
    instrument: str
    clock: int
    product_type: str
    site: int | None
    """None for 1296 or more, which the name does not encode."""
    drive: int | None
    sequence: str
    """Lower case, as in labels."""
    eye: str
    """L left, R right, M monoscopic, N not an imaging instrument."""
    filter_number: int
    """0 if the camera has no filter wheel, or the name gives no filter."""
    producer: str
    version: str
    """Version; empty if the name omits it."""
    frame: str = ""
    """Image type (MSL, Mars 2020): F or N whole frame, T thumbnail, S sub-frame, D down-sampled;
    empty for MER."""
    sol: int | None = None
    """Sol from the name (Mars 2020), or from its clock; None for test rovers."""
    tile_or_zoom: str = ""
    """Mars 2020: detector tile or focal length, and averaging; else empty."""


def parse_file_name(name: str) -> FileName:
    """Parse the name of an image file; folder, extension and case are ignored.

    Raises:
        LabelError: the name matches no mission's pattern.
    """
    product_id = _stem(name)
    if match := _MER.match(product_id):
        return FileName(
            product_id=product_id,
            mission=SPACECRAFT[match["spacecraft"]],
            instrument=MER_INSTRUMENTS[match["instrument"]],
            clock=int(match["clock"]),
            product_type=match["product"],
            site=decode_counter(match["site"]),
            drive=decode_counter(match["drive"]),
            sequence=match["sequence"].lower(),
            eye=match["eye"],
            filter_number=int(match["filter"]),
            producer=match["producer"],
            version=match["version"],
            sol=_sol(SPACECRAFT[match["spacecraft"]], int(match["clock"])),
        )
    if (match := _MSL.match(product_id)) and match["instrument"] in MSL_INSTRUMENTS:
        return FileName(
            product_id=product_id,
            mission="MSL",
            instrument=MSL_INSTRUMENTS[match["instrument"]],
            clock=int(match["clock"]),
            product_type=match["product"],
            site=int(match["site"]),
            drive=int(match["drive"]),
            sequence=match["sequence"].lower(),
            eye=match["eye"],
            filter_number=0,
            producer=match["producer"],
            version=match["version"],
            frame=match["frame"],
            sol=_sol("MSL", int(match["clock"])),
        )
    if match := _M2020.match(product_id):
        return FileName(
            product_id=product_id,
            mission="M20",
            instrument=M2020_INSTRUMENTS[match["instrument"]],
            clock=int(match["clock"]),
            product_type=match["product"],
            site=_plain_counter(match["site"]),
            drive=_plain_counter(match["drive"]),
            sequence=match["sequence"].lower(),
            eye=match["eye"],
            filter_number=int(match["colour"]) if match["colour"].isdigit() else 0,
            producer=match["producer"],
            version=match["version"],
            frame=match["frame"],
            sol=int(match["sol"]),
            tile_or_zoom=match["tile_or_zoom"] + match["averaging"],
        )
    raise LabelError(
        f"{name[:100]!a} matches no known pattern of image names; expected one like "
        "2N292280938EFFB100P0703L0M1.IMG"
    )


def _sol(mission: str, clock: int) -> int | None:
    """The sol of a spacecraft clock, correct to about an hour."""
    zero = SOL_ZERO.get(mission)
    return None if zero is None else int((clock - zero) // SOL_S)


def camera_string(product_id: str) -> str:
    """Code that distinguishes the stereo rigs of one instrument; empty if there is only one.

    A or B of Curiosity's two sets of engineering cameras; for Mastcam-Z the focal length in
    millimetres (026 to 110), because each focal length has its own interior
    orientation.
    """
    stem = _stem(product_id)
    if (zoom := _M2020.match(stem)) and zoom["instrument"] == "Z":
        return zoom["tile_or_zoom"]
    match = re.match(r"[NFR][LR]([AB])_\d{9}", stem, re.ASCII)
    return match[1] if match else ""


def tile_number(product_id: str) -> int:
    """Number (from 1) of the detector tile in a Perseverance Navcam or Hazcam image.

    0 for whole frames and other cameras.
    """
    match = _M2020.match(_stem(product_id))
    if match is None or match["instrument"] == "Z":
        return 0
    digits = match["tile_or_zoom"].strip("_")
    return int(digits) if digits.isdigit() else 0


def decode_counter(code: str) -> int | None:
    """Site or drive from its two-character code; None for 1296 or more (## or __)."""
    code = code.upper()
    if not re.fullmatch(_CODE, code, re.ASCII):
        raise LabelError(
            f"{code!a} is not a site or drive code: expected two characters 0-9 or A-Z, ## or __"
        )
    if code in {"##", "__"}:
        return None
    first, second = code[0], code[1]
    if code.isdigit():
        return int(code)
    if first.isdigit():
        return 1036 + 26 * int(first) + _letter(second)
    return 100 + 36 * _letter(first) + (int(second) if second.isdigit() else 10 + _letter(second))


def encode_counter(counter: int) -> str:
    """Two-character code of a site or drive; the inverse of `decode_counter`."""
    if counter < 0:
        raise LabelError(f"a site or drive counter must not be negative, but is {counter}")
    if counter < 100:  # noqa: PLR2004 - see the module docstring
        return f"{counter:02d}"
    if counter < 1036:  # noqa: PLR2004
        letter, rest = divmod(counter - 100, 36)
        return chr(65 + letter) + (str(rest) if rest < 10 else chr(55 + rest))  # noqa: PLR2004
    if counter < 1296:  # noqa: PLR2004
        digit, letter = divmod(counter - 1036, 26)
        return f"{digit}{chr(65 + letter)}"
    return "##"


def _plain_counter(code: str) -> int | None:
    """The counter if it is written in digits.

    None for letter codes of larger values, which only the label resolves.
    """
    return int(code) if code.isdigit() else None


def _letter(character: str) -> int:
    return ord(character) - ord("A")


def _stem(name: str) -> str:
    last = re.split(r"[/\\]", name)[-1].upper()
    return last.partition(".")[0]
