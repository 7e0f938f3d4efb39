"""VICAR labels: the flat text that JPL puts before the pixels, alone or after a PDS3 label.

    LBLSIZE=14336 FORMAT='HALF' ... NL=1024 NS=1024 ... PROPERTY='GEOMETRIC_CAMERA_MODEL' KEY=(...)

The system items come first and give the storage of the pixels; each PROPERTY opens a group with the
keywords of the PDS3 label, each TASK a part of the history. Units are in KEY__UNIT, pointers in
KEY__PTR. EOL=1 marks a second part after the pixels, which also starts with LBLSIZE and continues
the first part. The label is read into the same `Label` as PDS3: properties become groups,
the property IDENTIFICATION becomes the keywords outside of groups, and the system items become the
object IMAGE.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from solmap.photogrammetry.archive.labels.label import (
    MAX_LABEL_BYTES,
    Label,
    Quantity,
    Value,
    none_if_unknown,
    number_of,
)
from solmap.photogrammetry.errors import LabelError

START = b"LBLSIZE="
MAX_COUNT = 1 << 31
_ITEM = re.compile(
    r"\s*(?P<key>[A-Za-z_][A-Za-z0-9_:]*)\s*=\s*"
    r"(?:(?P<list>\((?:[^()']++|'[^']*+')*+\))|(?P<scalar>(?:'[^']*+')++|[^\s'()]++))"
)
_ENTRY = re.compile(r"(?:'[^']*+')++|[^,'\s()]++")
# A quote within a text is doubled, so a text is a sequence of quoted texts. The pattern does not
# backtrack: with two ways to read doubled quotes, a sequence of n would be tried in 2^n ways.
_SIZE = re.compile(rb"LBLSIZE=\s*(\d{1,8})\b")
_SAMPLE_BITS = {"BYTE": 8, "HALF": 16, "WORD": 16, "FULL": 32, "LONG": 32, "REAL": 32, "DOUB": 64}
_STORAGE = {"BSQ": "BAND_SEQUENTIAL", "BIL": "LINE_INTERLEAVED", "BIP": "SAMPLE_INTERLEAVED"}


def vicar_label_end(data: bytes) -> int | None:
    """First byte after the VICAR label in the head of a file, or None."""
    match = _SIZE.search(data, 0, MAX_LABEL_BYTES)
    return None if match is None else match.start() + int(match[1])


def parse_vicar_label(data: bytes, source: str) -> Label:
    """The VICAR label in the head of a file.

    Raises:
        LabelError: there is none, it is longer than the file, or an item is broken.
    """
    match = _SIZE.search(data, 0, MAX_LABEL_BYTES)
    if match is None:
        raise LabelError(
            f"{source}: not a VICAR label: LBLSIZE= was expected in the head of the file"
        )
    size = int(match[1])
    if not 0 < size <= MAX_LABEL_BYTES or match.start() + size > len(data):
        raise LabelError(
            f"{source}: LBLSIZE is {size}, but {len(data) - match.start()} bytes follow"
        )
    text = data[match.start() : match.start() + size].decode("latin-1").partition("\0")[0]
    groups: dict[str, dict[str, Value]] = {"": {}, "SYSTEM": {}}
    here = groups["SYSTEM"]
    for key, value in (*_items(text, source), *_items_behind(data, match.start(), size, source)):
        if key in {"PROPERTY", "TASK"}:
            name = str(value) if key == "PROPERTY" else "HISTORY"
            here = groups.setdefault("" if name == "IDENTIFICATION" else name.upper(), {})
        elif key.endswith("__UNIT"):
            _attach_unit(here, key.removesuffix("__UNIT"), value)
        else:
            key_here = f"^{key.removesuffix('__PTR')}" if key.endswith("__PTR") else key
            here.setdefault(key_here, value)
    groups["IMAGE"] = {**groups.get("IMAGE_DATA", {}), **_image_object(groups["SYSTEM"], source)}
    start = (
        match.start() + size + _count(groups["SYSTEM"], "NLB") * _count(groups["SYSTEM"], "RECSIZE")
    )
    groups[""]["^IMAGE"] = Quantity(start + 1, "BYTES")
    return Label(source, groups)


def _items_behind(data: bytes, start: int, size: int, source: str) -> Iterator[tuple[str, Value]]:
    """The items after the pixels; none where the file was truncated before them."""
    text = data[start : start + size].decode("latin-1").partition("\0")[0]
    system: dict[str, Value] = {}
    for key, value in _items(text, source):
        if key in {"PROPERTY", "TASK"}:
            break
        system.setdefault(key, value)
    if system.get("EOL") != 1:
        return
    sizes = [system.get(key) for key in ("RECSIZE", "N2", "N3", "NLB")]
    if not all(isinstance(count, int) and 0 <= count <= MAX_COUNT for count in sizes):
        raise LabelError(
            f"{source}: EOL=1, but RECSIZE, N2, N3, NLB do not locate the second label"
        )
    record, lines, bands, before = (count for count in sizes if isinstance(count, int))
    here = start + size + record * (lines * bands + before)
    if here >= len(data):
        return
    match = _SIZE.match(data, here)
    if match is None:
        raise LabelError(f"{source}: EOL=1, but byte {here} starts no second label (LBLSIZE=)")
    end = here + min(int(match[1]), MAX_LABEL_BYTES)
    rest = data[match.end() : end].decode("latin-1").partition("\0")[0]
    yield from _items(rest, source)


def _items(text: str, source: str) -> Iterator[tuple[str, Value]]:
    """Key and value of every item, in order."""
    position = 0
    while position < len(text):
        match = _ITEM.match(text, position)
        if match is None:
            rest = text[position:].strip()
            if rest:
                raise LabelError(
                    f"{source}: byte {position} of the VICAR label: expected KEY=value, found "
                    f"{rest[:40]!a}"
                )
            return
        if match["list"] is not None:
            entries = _ENTRY.findall(match["list"])
            yield match["key"].upper(), tuple(_scalar(entry) for entry in entries)
        else:
            yield match["key"].upper(), _scalar(match["scalar"])
        position = match.end()


def _scalar(text: str) -> Value:
    if text.startswith("'"):
        return none_if_unknown(text[1:-1].replace("''", "'"))
    number = number_of(text)
    return text if number is None else number


def _attach_unit(items: dict[str, Value], key: str, unit: Value) -> None:
    """Put a unit, or a list of them, on its number."""
    value = items.get(key)
    if isinstance(value, int | float) and isinstance(unit, str):
        items[key] = Quantity(value, unit)
    elif isinstance(value, tuple) and isinstance(unit, tuple) and len(unit) == len(value):
        items[key] = tuple(
            Quantity(number, name)
            if isinstance(number, int | float) and isinstance(name, str)
            else number
            for number, name in zip(value, unit, strict=True)
        )


def _image_object(system: dict[str, Value], source: str) -> dict[str, Value]:
    """The IMAGE object from the system items."""
    form = str(system.get("FORMAT", "")).upper()
    if form not in _SAMPLE_BITS:
        raise LabelError(f"{source}: FORMAT of the VICAR label {form[:40]!a} is not read")
    if form in {"REAL", "DOUB"}:
        sample_type = "IEEE_REAL" if system.get("REALFMT") == "IEEE" else "PC_REAL"
    elif form == "BYTE":
        sample_type = "UNSIGNED_INTEGER"
    else:
        sample_type = "MSB_INTEGER" if system.get("INTFMT") == "HIGH" else "LSB_INTEGER"
    return {
        "LINES": system.get("NL"),
        "LINE_SAMPLES": system.get("NS"),
        "BANDS": system.get("NB", 1),
        "SAMPLE_BITS": _SAMPLE_BITS[form],
        "SAMPLE_TYPE": sample_type,
        "BAND_STORAGE_TYPE": _STORAGE.get(str(system.get("ORG", "BSQ")).upper()),
        "LINE_PREFIX_BYTES": system.get("NBB", 0),
    }


def _count(system: dict[str, Value], key: str) -> int:
    value = system.get(key)
    return value if isinstance(value, int) and 0 <= value <= MAX_LABEL_BYTES else 0
