"""Index tables of archive volumes: label text and a stream of bytes in, rows and stereo pairs out.

A volume's index has one row a product, of fixed width and tab-separated at once: texts are quoted
and padded inside the quotes, numbers and times stand bare and are padded to the right. The label
says where each column lies: byte START_BYTE (from 1) to START_BYTE + BYTES - 1 of the row, behind
the opening quote; a column of several ITEMS has them ITEM_BYTES wide and ITEM_OFFSET apart.

A row is cut by these numbers if it is as long as ROW_BYTES says and the columns asked for stand
between separators; otherwise it is split at its tabs. The largest index has 366,500 rows (342 MB),
so rows are read one at a time and cut only where somebody looks.

Stereo pairs are found in the index without looking at an image. The frames of one exposure share
spacecraft, instrument without the eye, sequence and motion counter, and their clocks at the start
of the exposure are within a second, as in `partners`; left and right may differ by some ticks. An
exposure is a stereo pair if both eyes have a REGULAR image (no thumbnail, histogram or row sum)
through filters that see one band (Pancam L2 with R2, L7 with R1). The product type stands in the
file name only; of several versions the highest counts, and of the kinds of EDR the full frame
before sub-frames and averaged ones: what `partners` prefers.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from solmap.photogrammetry.archive.file_names import FileName, parse_file_name
from solmap.photogrammetry.archive.labels.label import (
    MAX_LABEL_BYTES,
    Label,
    number_of,
    parse_label,
)
from solmap.photogrammetry.archive.missions import mission_of_host
from solmap.photogrammetry.archive.partners import group_by_clock
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.imagery import Eye

MAX_ROW_BYTES = 1 << 16
"""The widest index has rows of 933 bytes; what has no line end within this is no table."""
MAX_COLUMNS = 1_000
LINE_END_BYTES = 2
"""ROW_BYTES counts a line end of none, one or two bytes, whatever the file has."""

_BEGIN = re.compile(r"\s*OBJECT\s*=\s*COLUMN\s*\Z", re.IGNORECASE)
_END = re.compile(r"\s*END_OBJECT\b[^\"]*\Z", re.IGNORECASE)
_SEPARATORS = b'\t" ,\r\n'
EDR_PREFERENCE = ("EFF", "ESF", "EDN")
"""Experiment data records that are mapped: full frame, sub-frame, down-sampled."""


@dataclass(frozen=True, slots=True)
class IndexColumn:
    """Where one column lies in a row."""

    name: str
    start: int
    """First byte, from 0."""
    length: int
    items: int
    item_length: int
    item_step: int
    first_field: int
    """How many tab-separated fields stand before it."""

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
    """Whose label it is: stands at the head of every complaint."""
    row_bytes: int
    rows: int | None
    columns: Mapping[str, IndexColumn]

    @property
    def fields(self) -> int:
        """Number of tab-separated fields of a row."""
        return max(column.first_field + column.items for column in self.columns.values())


@dataclass(frozen=True, slots=True)
class IndexRow:
    """One row, cut where it is asked."""

    layout: IndexLayout
    number: int
    """From 1."""
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
            LabelError: the table has no such column, or the row is broken.
        """
        column = self.layout.columns.get(name)
        if column is None:
            raise LabelError(f"{self.layout.source}: the index has no column {name}")
        cut = self._cut(column)
        items = cut if cut is not None else self._split(column)
        return tuple(item.decode("latin-1").strip(' "') for item in items)

    def _cut(self, column: IndexColumn) -> list[bytes] | None:
        """The items by their bytes; None where the row does not lie as the label says."""
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
    """The layout that the label of an index table describes.

    Raises:
        LabelError: it is no such label; says what is missing.
    """
    head, blocks = _split_columns(text[:MAX_LABEL_BYTES], source)
    label = parse_label(head, source)
    table = next((name for name in label.groups if "ROW_BYTES" in label.groups[name]), None)
    if table is None or not blocks:
        raise LabelError(f"{source}: no label of a table: it has no ROW_BYTES or no COLUMN")
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
    """The rows of a table, one at a time; `chunks` may break anywhere, as a network does.

    Raises:
        LabelError: there is no line end within `MAX_ROW_BYTES`.
    """
    for number, line in enumerate(_lines(layout, chunks), 1):
        if line:
            yield IndexRow(layout, number, line)


def _lines(layout: IndexLayout, chunks: Iterable[bytes]) -> Iterator[bytes]:
    rest = b""
    for chunk in chunks:
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            yield line.rstrip(b"\r")
        if len(rest) > MAX_ROW_BYTES:
            raise LabelError(
                f"{layout.source}: no table: its rows should be {layout.row_bytes} bytes wide, but "
                f"no line end came within {MAX_ROW_BYTES}"
            )
    yield rest.rstrip(b"\r")


def _split_columns(text: str, source: str) -> tuple[str, list[str]]:
    """The label without its columns, and the statements of each column.

    The label parser keeps the first of several objects of one name, so each is parsed alone.
    Descriptions are quoted over several lines, and nothing inside of quotes begins or ends.
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
            raise LabelError(f"{source}: more than {MAX_COLUMNS} columns: no index table")
    if block is not None:
        raise LabelError(f"{source}: the label ends inside of a COLUMN")
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
    """Which rows of an index are wanted."""

    mission: str
    """INSTRUMENT_HOST_ID: MER1, MER2."""
    instrument: str
    """NAVCAM, PANCAM, FRONT_HAZCAM ...; HAZCAM is the front and the rear one."""
    sols: frozenset[int]

    def __post_init__(self) -> None:
        if not self.sols:
            raise LabelError("a selection names at least one sol")

    def admits(self, instrument: str) -> bool:
        """Whether an instrument (without its eye) is wanted."""
        wanted = self.instrument.upper()
        return instrument == wanted or instrument.endswith("_" + wanted)


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """What one row of an index says of an image."""

    name: FileName
    file_name: str
    """As the index writes it, with its extension."""
    path_name: str
    """Folder of the file as the index writes it; empty where it does not say."""
    sol: int
    instrument: str
    eye: Eye
    clock: float
    """At the start of the exposure, seconds."""
    place: tuple[str, ...]
    """Spacecraft, instrument, sequence and motion counter: equal for the frames of an exposure."""


@dataclass(frozen=True, slots=True)
class IndexPair:
    """The two images of a stereo pair."""

    left: IndexEntry
    right: IndexEntry


@dataclass(frozen=True, slots=True)
class IndexFindings:
    """What an index holds of a selection."""

    pairs: tuple[IndexPair, ...]
    unpaired: tuple[IndexEntry, ...]
    """Mapping images that are in no pair."""
    rows: int
    broken: int
    """Rows that could not be read."""
    first_fault: str = ""

    @property
    def entries(self) -> tuple[IndexEntry, ...]:
        """The images of all pairs, left before right."""
        return tuple(entry for pair in self.pairs for entry in (pair.left, pair.right))


def find_in_index(rows: Iterable[IndexRow], selection: IndexSelection) -> IndexFindings:
    """The stereo pairs of a selection, in one pass; only what is selected is kept."""
    places: dict[tuple[str, ...], list[IndexEntry]] = defaultdict(list)
    count, broken, first_fault = 0, 0, ""
    for row in rows:
        count += 1
        try:
            entry = index_entry(row, selection)
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
            pair = _best_pair(exposure)
            if pair is None:
                unpaired += exposure
            else:
                pairs.append(pair)
    pairs.sort(key=lambda pair: (pair.left.sol, pair.left.name.clock, pair.left.file_name))
    unpaired.sort(key=lambda entry: (entry.sol, entry.name.clock, entry.file_name))
    return IndexFindings(tuple(pairs), tuple(unpaired), count, broken, first_fault)


def index_entry(row: IndexRow, selection: IndexSelection) -> IndexEntry | None:
    """What a row says, or None where it is not of the selection or no mapping image.

    Raises:
        LabelError: the row is broken.
    """
    sol = row.integer("PLANET_DAY_NUMBER")
    if sol not in selection.sols or row.text("IMAGE_TYPE") != "REGULAR":
        return None
    host = row.text("INSTRUMENT_HOST_ID")
    mission = mission_of_host(host)
    known = mission.instruments.get(row.text("INSTRUMENT_ID")) if mission else None
    if host != selection.mission or known is None or not selection.admits(known[0]):
        return None
    columns = row.layout.columns
    file_name = row.text("FILE_NAME" if "FILE_NAME" in columns else "PRODUCT_ID")
    name = parse_file_name(file_name)
    if name.product_type not in EDR_PREFERENCE:
        return None
    return IndexEntry(
        name=name,
        file_name=file_name if "." in file_name else f"{file_name}.img",
        path_name=row.text("PATH_NAME") if "PATH_NAME" in columns else "",
        sol=sol,
        instrument=known[0],
        eye=known[1],
        clock=_clock(row),
        place=(
            host,
            known[0],
            row.text("SEQUENCE_ID").lower(),
            *row.items("ROVER_MOTION_COUNTER"),
        ),
    )


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


def _best_pair(entries: Sequence[IndexEntry]) -> IndexPair | None:
    """The frames of an exposure that are matched, by the order in the module's docstring."""
    best: dict[tuple[Eye, int], IndexEntry] = {}
    for entry in sorted(entries, key=_preference, reverse=True):
        best[entry.eye, entry.name.filter_number] = entry
    candidates = [
        IndexPair(left, right)
        for left in best.values()
        if left.eye is Eye.LEFT
        for right in best.values()
        if right.eye is Eye.RIGHT and _filters_agree(left, right)
    ]
    return min(
        candidates,
        key=lambda pair: (_preference(pair.left), _preference(pair.right)),
        default=None,
    )


def _preference(entry: IndexEntry) -> tuple[int, int, str]:
    kind = EDR_PREFERENCE.index(entry.name.product_type)
    return kind, -int(entry.name.version, 36), entry.file_name


def _filters_agree(left: IndexEntry, right: IndexEntry) -> bool:
    mission = mission_of_host(left.name.mission)
    allowed = mission.stereo_filters.get(left.instrument) if mission else None
    return allowed is None or (left.name.filter_number, right.name.filter_number) in allowed
