"""Parse archive file names: spacecraft, instrument, clock, product, site and drive.

MER names have 27 characters, 2N292280938EFFB100P0703L0M1: spacecraft, instrument, clock (9),
product type (3), site (2), drive (2), sequence (5), eye, filter, producer, version. Site and drive
are coded: 00-99; A0-ZZ = 100 + 36 letter + digit (10 + letter); 0A-9Z = 1036 + 26 digit + letter;
## and __ are 1296 and more, which only the label gives.

MSL names have 36, NLB_517261274EDR_F0541610CCAM15900M1: camera and eye, clock, product type,
geometry (L linearised), frame, site (3), drive (4), sequence (9), producer, version.

Those of Mars 2020 have 54, NLF_0629_0722782785_631ECM_N0301344NCAM00427_06_095J01: camera and eye,
colour, sol, clock with its thousandths, product type, geometry (L linearised), frame, site, drive,
sequence, four characters with a meaning for each camera (Navcam and Hazcam: tile and averaging,
Mastcam-Z: focal length in millimetres and averaging), compression, producer, version. The public
site and PDS4 identifiers omit the version.
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
    r"(?P<drive>[A-Z0-9]{4})(?P<sequence>[A-Z0-9_]{9})_(?P<part>[A-Z0-9_]{3})"
    r"(?P<averaging>[A-Z0-9_])[A-Z0-9_]{2}"
    r"(?P<producer>[A-Z_])(?P<version>[A-Z0-9_]{2}|)\Z",
    re.ASCII,
)

SOL_S = 88775.42064
SOL_ZERO = {"MER1": 128141132, "MER2": 126322960, "MSL": 397446400}
"""Spacecraft clock at the beginning of sol 0, seconds (MER: facts 6.2; MSL: of five labels)."""

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
    """Site; None if only the label gives it: 1296 and more."""
    drive: int | None
    sequence: str
    """Lower case, as in labels."""
    eye: str
    """L, R, M or N."""
    filter_number: int
    """0 where the camera has no filter wheel of its own."""
    producer: str
    version: str
    """Version; empty if the name omits it."""
    frame: str = ""
    """Letter of the frame, as for MER: F or N whole, T thumbnail, S sub-frame, D down-sampled."""
    sol: int | None = None
    """Sol from the name (Mars 2020), or from its clock; None for test rovers."""
    part: str = ""
    """Mars 2020: tile or focal length, and averaging."""


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
            part=match["part"] + match["averaging"],
        )
    raise LabelError(
        f"{name[:100]!a} matches no known pattern of image names; expected one like "
        "2N292280938EFFB100P0703L0M1.IMG"
    )


def _sol(mission: str, clock: int) -> int | None:
    """The sol of a clock, good to an hour."""
    zero = SOL_ZERO.get(mission)
    return None if zero is None else int((clock - zero) // SOL_S)


def camera_string(product_id: str) -> str:
    """Distinguishes the rigs of one instrument; empty where there is only one.

    A or B of Curiosity's two sets of engineering cameras; for Mastcam-Z the focal length in
    millimetres (026 to 110), because each has its own interior orientation.
    """
    stem = _stem(product_id)
    if (zoom := _M2020.match(stem)) and zoom["instrument"] == "Z":
        return zoom["part"]
    match = re.match(r"[NFR][LR]([AB])_\d{9}", stem, re.ASCII)
    return match[1] if match else ""


def tile_number(product_id: str) -> int:
    """Part of the detector in an image of Perseverance's Navcam or Hazcam, from 1.

    0 where the image is the whole frame or of another camera.
    """
    match = _M2020.match(_stem(product_id))
    if match is None or match["instrument"] == "Z":
        return 0
    digits = match["part"].strip("_")
    return int(digits) if digits.isdigit() else 0


def decode_counter(code: str) -> int | None:
    """Site or drive from its two-character code; None for 1296 and more (## or __)."""
    code = code.upper()
    if not re.fullmatch(_CODE, code, re.ASCII):
        raise LabelError(f"{code!a} is not a site or drive code: expected two of 0-9, A-Z, or ##")
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
    if counter < 100:  # noqa: PLR2004 - the limits of the code, see the module
        return f"{counter:02d}"
    if counter < 1036:  # noqa: PLR2004
        letter, rest = divmod(counter - 100, 36)
        return chr(65 + letter) + (str(rest) if rest < 10 else chr(55 + rest))  # noqa: PLR2004
    if counter < 1296:  # noqa: PLR2004
        digit, letter = divmod(counter - 1036, 26)
        return f"{digit}{chr(65 + letter)}"
    return "##"


def _plain_counter(code: str) -> int | None:
    """A counter in digits; None for the codes of larger ones, which only the label gives."""
    return int(code) if code.isdigit() else None


def _letter(character: str) -> int:
    return ord(character) - ord("A")


def _stem(name: str) -> str:
    last = re.split(r"[/\\]", name)[-1].upper()
    return last.partition(".")[0]
