"""Index tables of archive volumes: label text and a stream of bytes in, rows and stereo pairs out.

The index of a volume has one row per product, which is both tab-separated and of fixed width: texts
are quoted and padded inside the quotes, numbers and times are unquoted and padded to the right. The
label gives the position of each column: byte START_BYTE (from 1) to START_BYTE + BYTES - 1 of the
row, after the opening quote; a column of several ITEMS has them ITEM_BYTES wide and ITEM_OFFSET
apart.

A row is cut by these numbers if its length is ROW_BYTES and the requested columns are between
separators; otherwise it is split at its tabs. The largest index has 366,500 rows (342 MB), so rows
are read one at a time and only requested columns are cut.

Stereo pairs are found from the index alone, without images. The frames of one exposure share
spacecraft, instrument without the eye, sequence and motion counter, and their clocks at the start
of the exposure are within a second, as in `partners`; left and right may differ by some ticks. An
exposure is a stereo pair if both eyes have a REGULAR image (no thumbnail, histogram or row sum)
through filters of the same band (Pancam L2 with R2, L7 with R1). The product type is given only in
the file name; of several versions the highest is used, and of the kinds of EDR the full frame
before sub-frames and averaged ones, as in `partners`.

Of the index of Curiosity's volumes only PATH_NAME, FILE_NAME, INSTRUMENT_ID and PLANET_DAY_NUMBER
are used; the rest is also in the file names. Bundles of Mars 2020 have no index, only the inventory
of their data collection (PDS4), one line per product,

    P,urn:nasa:pds:mars2020_navcam_ops_raw:data:nlf_0629_..._06_095j::1.0

whose identifier is the file's name without its version, and whose folder follows from the name.
Each tile is an image with a partner of its own.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from solmap.photogrammetry.archive.file_names import FileName, camera_string, parse_file_name
from solmap.photogrammetry.archive.labels.label import (
    MAX_LABEL_BYTES,
    Label,
    number_of,
    parse_label,
)
from solmap.photogrammetry.archive.missions import mission_id, mission_of_host
from solmap.photogrammetry.archive.partners import group_by_clock
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.imagery import Eye

MAX_ROW_BYTES = 1 << 16
"""The widest index has rows of 933 bytes; a file without a line end within this is not a table."""
MAX_COLUMNS = 1_000
LINE_END_BYTES = 2
"""ROW_BYTES includes a line end of zero, one or two bytes, whatever the file has."""

_BEGIN = re.compile(r"\s*OBJECT\s*=\s*COLUMN\s*\Z", re.IGNORECASE)
_END = re.compile(r"\s*END_OBJECT\b[^\"]*\Z", re.IGNORECASE)
_SEPARATORS = b'\t" ,\r\n'
_INVENTORY = re.compile(rb"[PS],(urn:nasa:pds:[\w.:-]+):([\w.-]+)::(\d{1,4})\.\d{1,4}\Z", re.ASCII)
BUNDLE_FOLDERS = {
    "NAVCAM": "ncam",
    "FRONT_HAZCAM": "fcam",
    "REAR_HAZCAM": "rcam",
    "MASTCAM": "zcam",
}
"""Folder of an instrument's images below data/sol/#####/ids/edr in bundles of Mars 2020."""


@dataclass(frozen=True, slots=True)
class IndexColumn:
    """Position of one column in a row."""

    name: str
    start: int
    """First byte, from 0."""
    length: int
    items: int
    item_length: int
    item_step: int
    first_field: int
    """Number of tab-separated fields before it."""

    def __post_init__(self) -> None:
        last = self.start + (self.items - 1) * self.item_step + self.item_length
        sizes = (self.length, self.items, self.item_length, self.item_step)
        if self.start < 0 or min(sizes) < 1 or last > MAX_ROW_BYTES:
            raise ValueError(
                f"column {self.name}: START_BYTE {self.start + 1}, BYTES {self.length} and ITEMS "
                f"{self.items} should lie in a row of at most {MAX_ROW_BYTES} bytes"
            )


@dataclass(frozen=True, slots=True)
class IndexLayout:
    """The columns of an index table."""

    source: str
    """Name of the label's file; every message begins with it."""
    row_bytes: int
    rows: int | None
    columns: Mapping[str, IndexColumn]

    @property
    def fields(self) -> int:
        """Number of tab-separated fields of a row."""
        return max(column.first_field + column.items for column in self.columns.values())


@dataclass(frozen=True, slots=True)
class IndexRow:
    """One row, of which only requested columns are cut."""

    layout: IndexLayout
    number: int
    """Number of the row, from 1."""
    line: bytes

    def text(self, name: str) -> str:
        """A column without quotes and padding."""
        return self.items(name)[0]

    def integer(self, name: str) -> int:
        """A column as a whole number."""
        return self.integers(name)[0]

    def integers(self, name: str) -> tuple[int, ...]:
        """All items of a column as whole numbers."""
        return tuple(int(number) for number in self._numbers(name, "a whole number", whole=True))

    def real(self, name: str) -> float:
        """A column as a number."""
        return float(self._numbers(name, "a number", whole=False)[0])

    def items(self, name: str) -> tuple[str, ...]:
        """All items of a column as texts.

        Raises:
            LabelError: the table does not have the column, or the row is broken.
        """
        column = self.layout.columns.get(name)
        if column is None:
            raise LabelError(f"{self.layout.source}: the index has no column {name}")
        cut = self._cut(column)
        items = cut if cut is not None else self._split(column)
        return tuple(item.decode("latin-1").strip(' "') for item in items)

    def _cut(self, column: IndexColumn) -> list[bytes] | None:
        """The items by their byte positions; None where the row does not follow the label."""
        length = len(self.line)
        if not self.layout.row_bytes - LINE_END_BYTES <= length <= self.layout.row_bytes:
            return None
        items = []
        for item in range(column.items):
            start = column.start + item * column.item_step
            end = start + column.item_length
            before, after = self.line[start - 1 : start], self.line[end : end + 1]
            if end > length or before not in _SEPARATORS or after not in _SEPARATORS:
                return None
            items.append(self.line[start:end])
        return items

    def _split(self, column: IndexColumn) -> list[bytes]:
        fields = self.line.split(b"\t")
        if len(fields) != self.layout.fields:
            raise LabelError(
                f"{self.layout.source}: row {self.number} should be {self.layout.row_bytes} bytes "
                f"wide or have {self.layout.fields} fields between tabs, but is {len(self.line)} "
                f"bytes wide and has {len(fields)} fields"
            )
        return fields[column.first_field : column.first_field + column.items]

    def _numbers(self, name: str, expected: str, *, whole: bool) -> list[int | float]:
        numbers = [number_of(item) for item in self.items(name)]
        found = [n for n in numbers if n is not None and (not whole or float(n).is_integer())]
        if len(found) < len(numbers):
            raise LabelError(
                f"{self.layout.source}: row {self.number}: {name} should be {expected}, but is "
                f"{' '.join(self.items(name))[:40]!a}"
            )
        return found


def parse_index_label(text: str, source: str) -> IndexLayout:
    """The layout in the label of an index table.

    Raises:
        LabelError: it is not such a label; the message names what is missing.
    """
    head, blocks = _split_columns(text[:MAX_LABEL_BYTES], source)
    label = parse_label(head, source)
    table = next((name for name in label.groups if "ROW_BYTES" in label.groups[name]), None)
    if table is None or not blocks:
        raise LabelError(f"{source}: not the label of a table: it has no ROW_BYTES or no COLUMN")
    columns: dict[str, IndexColumn] = {}
    first_field = 0
    for block in blocks:
        column = _column(parse_label(block + "\nEND\n", source), first_field)
        columns.setdefault(column.name, column)
        first_field += column.items
    row_bytes = label.require(table, "ROW_BYTES", int)
    if not 1 < row_bytes <= MAX_ROW_BYTES:
        raise LabelError(f"{source}: ROW_BYTES should be 2 to {MAX_ROW_BYTES}, but is {row_bytes}")
    return IndexLayout(source, row_bytes, label.optional(table, "ROWS", int), columns)


def read_index_rows(layout: IndexLayout, chunks: Iterable[bytes]) -> Iterator[IndexRow]:
    """The rows of a table, one at a time; `chunks` may be split anywhere, as by a network.

    Raises:
        LabelError: there is no line end within `MAX_ROW_BYTES`.
    """
    expected = f": its rows should be {layout.row_bytes} bytes wide, but"
    for number, line in enumerate(read_lines(chunks, layout.source, expected), 1):
        if line:
            yield IndexRow(layout, number, line)


def read_lines(chunks: Iterable[bytes], source: str, expected: str = ",") -> Iterator[bytes]:
    """The lines of a table; `chunks` may be split anywhere.

    Raises:
        LabelError: there is no line end within `MAX_ROW_BYTES`.
    """
    rest = b""
    for chunk in chunks:
        *lines, rest = (rest + chunk).split(b"\n")
        yield from (line.rstrip(b"\r") for line in lines)
        if len(rest) > MAX_ROW_BYTES:
            raise LabelError(
                f"{source}: not a table{expected} no line end came within {MAX_ROW_BYTES}"
            )
    yield rest.rstrip(b"\r")


def _split_columns(text: str, source: str) -> tuple[str, list[str]]:
    """The label without its columns, and the statements of each column.

    The label parser keeps the first of several objects of one name, so each is parsed separately.
    Descriptions are quoted over several lines; statements inside quotes are ignored.
    """
    head: list[str] = []
    blocks: list[list[str]] = []
    block: list[str] | None = None
    quoted = False
    for line in text.splitlines():
        if not quoted and block is None and _BEGIN.match(line):
            block = []
        elif not quoted and block is not None and _END.match(line):
            blocks.append(block)
            block = None
        else:
            (head if block is None else block).append(line)
            quoted ^= line.count('"') % 2 == 1
        if len(blocks) > MAX_COLUMNS:
            raise LabelError(f"{source}: more than {MAX_COLUMNS} columns: not an index table")
    if block is not None:
        raise LabelError(f"{source}: the label ends inside a COLUMN")
    return "\n".join(head), ["\n".join(lines) for lines in blocks]


def _column(label: Label, first_field: int) -> IndexColumn:
    items = label.optional("", "ITEMS", int) or 1
    length = label.require("", "BYTES", int)
    item_length = label.optional("", "ITEM_BYTES", int) or (length if items == 1 else 0)
    item_step = label.optional("", "ITEM_OFFSET", int) or item_length
    if items > 1 and item_length < 1:
        raise LabelError(f"{label.source}: a COLUMN of {items} ITEMS lacks ITEM_BYTES")
    try:
        return IndexColumn(
            name=label.require("", "NAME", str).upper(),
            start=label.require("", "START_BYTE", int) - 1,
            length=length,
            items=items,
            item_length=item_length,
            item_step=item_step,
            first_field=first_field,
        )
    except ValueError as error:
        raise LabelError(f"{label.source}: {error}") from None


@dataclass(frozen=True, slots=True)
class IndexSelection:
    """Selection of rows of an index."""

    mission: str
    """INSTRUMENT_HOST_ID: MER1, MER2."""
    instrument: str
    """NAVCAM, PANCAM, FRONT_HAZCAM ...; HAZCAM is the front and the rear one."""
    sols: frozenset[int]

    def __post_init__(self) -> None:
        if not self.sols:
            raise LabelError("a selection must name at least one sol")

    def admits(self, instrument: str) -> bool:
        """Whether an instrument (without its eye) is selected."""
        name = self.instrument.upper()
        return instrument == name or instrument.endswith("_" + name)


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """An image as described by one row of an index."""

    name: FileName
    file_name: str
    """File name as in the index, with its extension."""
    path_name: str
    """Folder of the file as in the index; empty where not given."""
    sol: int
    instrument: str
    eye: Eye
    clock: float
    """Clock at the start of the exposure, seconds."""
    place: tuple[str, ...]
    """Spacecraft, instrument, sequence and motion counter: equal for frames of one exposure."""


@dataclass(frozen=True, slots=True)
class IndexPair:
    """The two images of a stereo pair."""

    left: IndexEntry
    right: IndexEntry


@dataclass(frozen=True, slots=True)
class IndexFindings:
    """The selected images of an index."""

    pairs: tuple[IndexPair, ...]
    unpaired: tuple[IndexEntry, ...]
    """Mapping images that are in no pair."""
    rows: int
    broken: int
    """Number of rows that could not be read."""
    first_fault: str = ""

    @property
    def entries(self) -> tuple[IndexEntry, ...]:
        """The images of all pairs, left before right."""
        return tuple(entry for pair in self.pairs for entry in (pair.left, pair.right))


def find_in_index(
    rows: Iterable[IndexRow] | Iterable[bytes], selection: IndexSelection
) -> IndexFindings:
    """The stereo pairs of a selection, in one pass; only selected rows are kept.

    Args:
        rows: those of an index table, or the lines of an inventory.
        selection: which of them to keep.
    """
    places: dict[tuple[str, ...], list[IndexEntry]] = defaultdict(list)
    count, broken, first_fault = 0, 0, ""
    for row in rows:
        count += 1
        try:
            entry = (
                inventory_entry(row, selection)
                if isinstance(row, bytes)
                else index_entry(row, selection)
            )
        except LabelError as error:
            broken += 1
            first_fault = first_fault or str(error)
            continue
        if entry is not None:
            places[entry.place].append(entry)
    pairs: list[IndexPair] = []
    unpaired: list[IndexEntry] = []
    for at_one_place in places.values():
        for exposure in group_by_clock(at_one_place, lambda e: (e.clock, e.file_name)):
            found = _best_pairs(exposure)
            pairs += found
            unpaired += [] if found else exposure
    pairs.sort(key=lambda pair: (pair.left.sol, pair.left.name.clock, pair.left.file_name))
    unpaired.sort(key=lambda entry: (entry.sol, entry.name.clock, entry.file_name))
    return IndexFindings(tuple(pairs), tuple(unpaired), count, broken, first_fault)


def index_entry(row: IndexRow, selection: IndexSelection) -> IndexEntry | None:
    """The image of a row, or None where not selected or not a mapping image.

    Raises:
        LabelError: the row is broken.
    """
    columns = row.layout.columns
    sol = row.integer("PLANET_DAY_NUMBER")
    is_regular = "IMAGE_TYPE" not in columns or row.text("IMAGE_TYPE") == "REGULAR"
    if sol not in selection.sols or not is_regular:
        return None
    mission = mission_of_host(selection.mission)
    host = row.text("INSTRUMENT_HOST_ID") if "INSTRUMENT_HOST_ID" in columns else selection.mission
    known = mission.instruments.get(row.text("INSTRUMENT_ID")) if mission else None
    if mission_id(host) != selection.mission or known is None or not selection.admits(known[0]):
        return None
    file_name = row.text("FILE_NAME" if "FILE_NAME" in columns else "PRODUCT_ID")
    name = parse_file_name(file_name)
    if not _is_mapped(name):
        return None
    stem, _, suffix = file_name.rpartition(".")
    if not stem or suffix.lower() == "lbl":
        file_name = f"{stem or file_name}.{'IMG' if file_name.isupper() else 'img'}"
    clock = _clock(row) if "SPACECRAFT_CLOCK_START_COUNT" in columns else float(name.clock)
    counter: tuple[str, ...] = (str(name.site), str(name.drive))
    if "ROVER_MOTION_COUNTER" in columns:
        counter = row.items("ROVER_MOTION_COUNTER")
    return IndexEntry(
        name=name,
        file_name=file_name,
        path_name=row.text("PATH_NAME") if "PATH_NAME" in columns else "",
        sol=sol,
        instrument=known[0],
        eye=known[1],
        clock=clock,
        place=(host, known[0], name.sequence, camera_string(name.product_id), *counter),
    )


def inventory_entry(line: bytes, selection: IndexSelection) -> IndexEntry | None:
    """The image of an inventory's line, or None where not selected.

    Raises:
        LabelError: it is not a line of an inventory.
    """
    match = _INVENTORY.match(line)
    if match is None:
        raise LabelError(
            f"the inventory should have lines like P,urn:nasa:pds:...::1.0, but has "
            f"{line[:40].decode('latin-1')!a}"
        )
    try:
        name = parse_file_name(match[2].decode("ascii"))
    except LabelError:
        return None  # a document, or an image of a camera that is not mapped
    if (
        name.sol not in selection.sols
        or name.mission != selection.mission
        or not selection.admits(name.instrument)
        or not _is_mapped(name)
        or name.instrument not in BUNDLE_FOLDERS
    ):
        return None
    version = name.version or f"{int(match[3]):02d}"
    stem = name.product_id.removesuffix(name.version)
    return IndexEntry(
        name=name,
        file_name=f"{stem}{version}.IMG",
        path_name=f"data/sol/{name.sol:05d}/ids/edr/{BUNDLE_FOLDERS[name.instrument]}",
        sol=name.sol,
        instrument=name.instrument,
        eye=Eye.LEFT if name.eye == "L" else Eye.RIGHT,
        clock=float(name.clock),
        place=(
            *(name.mission, name.instrument, name.sequence, camera_string(name.product_id)),
            *(str(name.site), str(name.drive)),
        ),
    )


def _is_mapped(name: FileName) -> bool:
    """Whether an image of this name is an EDR of the scene and not a thumbnail."""
    mission = mission_of_host(name.mission)
    return mission is not None and name.product_type in mission.edr_types and name.frame != "T"


def _clock(row: IndexRow) -> float:
    """Seconds of the spacecraft clock; a partition before a slash is dropped."""
    text = row.text("SPACECRAFT_CLOCK_START_COUNT")
    clock = number_of(text.rpartition("/")[2])
    if clock is None or not math.isfinite(clock):
        raise LabelError(
            f"{row.layout.source}: row {row.number}: SPACECRAFT_CLOCK_START_COUNT should be "
            f"seconds, but is {text[:40]!a}"
        )
    return float(clock)


def _best_pairs(entries: Sequence[IndexEntry]) -> list[IndexPair]:
    """The frames of an exposure to match, in the order of the module's docstring."""
    best: dict[tuple[Eye, int, str], IndexEntry] = {}
    for entry in sorted(entries, key=_preference, reverse=True):
        best[entry.eye, entry.name.filter_number, entry.name.tile_or_zoom] = entry
    candidates = [
        IndexPair(left, right)
        for left in best.values()
        if left.eye is Eye.LEFT
        for right in best.values()
        if right.eye is Eye.RIGHT
        and right.name.tile_or_zoom == left.name.tile_or_zoom
        and _filters_agree(left, right)
    ]
    found: dict[str, IndexPair] = {}
    for pair in sorted(candidates, key=lambda p: (_preference(p.left), _preference(p.right))):
        found.setdefault(pair.left.name.tile_or_zoom, pair)
    return list(found.values())


def _preference(entry: IndexEntry) -> tuple[int, int, str]:
    mission = mission_of_host(entry.name.mission)
    kinds = mission.edr_types if mission else ()
    version = entry.name.version
    newest = int(version, 36) if version.isalnum() else 0
    return kinds.index(entry.name.product_type), -newest, entry.file_name


def _filters_agree(left: IndexEntry, right: IndexEntry) -> bool:
    mission = mission_of_host(left.name.mission)
    allowed = mission.stereo_filters.get(left.instrument) if mission else None
    return allowed is None or (left.name.filter_number, right.name.filter_number) in allowed
