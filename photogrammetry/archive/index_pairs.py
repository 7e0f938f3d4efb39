"""Stereo pairs, found in the index of an archive volume without looking at an image.

The frames of one exposure share spacecraft, instrument without the eye, sequence and motion
counter, and their clocks at the start of the exposure are within a second, as in `partners`; left
and right may differ by some ticks. An exposure is a stereo pair if both eyes have a REGULAR
image (no thumbnail, histogram or row sum) through filters that see one band (Pancam L2 with R2, L7
with R1). The product type stands in the file name only; of several versions the highest counts, and
of the kinds of EDR the full frame before sub-frames and averaged ones: what `partners` prefers.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from solmap.photogrammetry.archive.file_names import FileName, parse_file_name
from solmap.photogrammetry.archive.index_table import IndexRow
from solmap.photogrammetry.archive.label import number_of
from solmap.photogrammetry.archive.missions import MISSIONS, Mission, mission_of_host
from solmap.photogrammetry.archive.partners import taken_together
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.imagery import Eye

EDR_PREFERENCE = ("EFF", "ESF", "EDN")
"""Experiment data records that are mapped: full frame, sub-frame, down-sampled."""


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


def find_in_index(
    rows: Iterable[IndexRow], selection: IndexSelection, missions: Sequence[Mission] = MISSIONS
) -> IndexFindings:
    """The stereo pairs of a selection, in one pass; only what is selected is kept."""
    places: dict[tuple[str, ...], list[IndexEntry]] = defaultdict(list)
    count, broken, first_fault = 0, 0, ""
    for row in rows:
        count += 1
        try:
            entry = index_entry(row, selection, missions)
        except LabelError as error:
            broken += 1
            first_fault = first_fault or str(error)
            continue
        if entry is not None:
            places[entry.place].append(entry)
    pairs: list[IndexPair] = []
    unpaired: list[IndexEntry] = []
    for at_one_place in places.values():
        for exposure in taken_together(at_one_place, lambda e: (e.clock, e.file_name)):
            pair = _best_pair(exposure, missions)
            if pair is None:
                unpaired += exposure
            else:
                pairs.append(pair)
    pairs.sort(key=lambda pair: (pair.left.sol, pair.left.name.clock, pair.left.file_name))
    unpaired.sort(key=lambda entry: (entry.sol, entry.name.clock, entry.file_name))
    return IndexFindings(tuple(pairs), tuple(unpaired), count, broken, first_fault)


def index_entry(
    row: IndexRow, selection: IndexSelection, missions: Sequence[Mission] = MISSIONS
) -> IndexEntry | None:
    """What a row says, or None where it is not of the selection or no mapping image.

    Raises:
        LabelError: the row is broken.
    """
    sol = row.integer("PLANET_DAY_NUMBER")
    if sol not in selection.sols or row.text("IMAGE_TYPE") != "REGULAR":
        return None
    host = row.text("INSTRUMENT_HOST_ID")
    mission = mission_of_host(host, missions)
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


def _best_pair(entries: Sequence[IndexEntry], missions: Sequence[Mission]) -> IndexPair | None:
    """The frames of an exposure that are matched, by the order in the module's docstring."""
    best: dict[tuple[Eye, int], IndexEntry] = {}
    for entry in sorted(entries, key=_preference, reverse=True):
        best[entry.eye, entry.name.filter_number] = entry
    candidates = [
        IndexPair(left, right)
        for left in best.values()
        if left.eye is Eye.LEFT
        for right in best.values()
        if right.eye is Eye.RIGHT and _filters_agree(left, right, missions)
    ]
    return min(
        candidates,
        key=lambda pair: (_preference(pair.left), _preference(pair.right)),
        default=None,
    )


def _preference(entry: IndexEntry) -> tuple[int, int, str]:
    kind = EDR_PREFERENCE.index(entry.name.product_type)
    return kind, -int(entry.name.version, 36), entry.file_name


def _filters_agree(left: IndexEntry, right: IndexEntry, missions: Sequence[Mission]) -> bool:
    mission = mission_of_host(left.name.mission, missions)
    allowed = mission.stereo_filters.get(left.instrument) if mission else None
    return allowed is None or (left.name.filter_number, right.name.filter_number) in allowed
