"""Index tables are read as the archive writes them, and pairs are found in them."""

import subprocess
import sys
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solmap.photogrammetry.archive.tables.volume_index import (
    IndexLayout,
    IndexSelection,
    find_in_index,
    parse_index_label,
    read_index_rows,
)
from solmap.photogrammetry.errors import LabelError

COLUMNS = (
    # name, type, start byte, bytes: the columns of a Navcam index that are of use here, and others
    ("VOLUME_ID", "CHARACTER", 11),
    ("DATA_SET_ID", "CHARACTER", 40),
    ("INSTRUMENT_HOST_ID", "CHARACTER", 4),
    ("INSTRUMENT_ID", "CHARACTER", 18),
    ("PATH_NAME", "CHARACTER", 65),
    ("FILE_NAME", "CHARACTER", 32),
    ("RELEASE_ID", "CHARACTER", 4),
    ("PRODUCT_ID", "CHARACTER", 27),
    ("PLANET_DAY_NUMBER", "INTEGER", 4),
    ("SPACECRAFT_CLOCK_START_COUNT", "CHARACTER", 30),
    ("SEQUENCE_ID", "CHARACTER", 30),
    ("IMAGE_TYPE", "CHARACTER", 10),
    ("SOLAR_LONGITUDE", "ASCII_REAL", 11),
)
DESCAM = {
    # the descent camera's index, whose first row is public: start and length
    "VOLUME_ID": (2, 11),
    "PRODUCT_ID": (94, 27),
    "PLANET_DAY_NUMBER": (186, 4),
    "START_TIME": (191, 20),
    "LINES": (412, 4),
    "LINE_SAMPLES": (417, 4),
    "SOLAR_AZIMUTH": (617, 11),
    "SOLAR_ELEVATION": (629, 11),
    "SOLAR_LONGITUDE": (641, 11),
    "ROVER_MOTION_COUNTER": (721, 34),
    "PIXEL_AVERAGING_HEIGHT": (764, 4),
    "PIXEL_AVERAGING_WIDTH": (769, 4),
}

PATIENT = settings(deadline=10_000)
"""Milliseconds; some 20 each, types checked at every call on a busy machine."""


def column_text(name: str, start: int, length: int) -> str:
    items = (
        "  ITEMS = 5\n  ITEM_BYTES = 6\n  ITEM_OFFSET = 7\n"
        if name == "ROVER_MOTION_COUNTER"
        else ""
    )
    return (
        f"  OBJECT = COLUMN\n  NAME = {name}\n  DATA_TYPE = CHARACTER\n  START_BYTE = {start}\n"
        f"  BYTES = {length}\n{items}"
        f'  DESCRIPTION = "What {name} is;\n    it is not\n  END_OBJECT = COLUMN\n  of another"\n'
        "  END_OBJECT = COLUMN\n"
    )


def label_text(columns: dict[str, tuple[int, int]], row_bytes: int, rows: int) -> str:
    return (
        "PDS_VERSION_ID = PDS3\nRECORD_TYPE = FIXED_LENGTH\n"
        f'^EDR_INDEX_TABLE = "EDRINDEX.TAB"\nOBJECT = EDR_INDEX_TABLE\n  ROWS = {rows}\n'
        f"  ROW_BYTES = {row_bytes}\n  COLUMNS = {len(columns)}\n"
        + "".join(column_text(name, *place) for name, place in columns.items())
        + "END_OBJECT = EDR_INDEX_TABLE\nEND\n"
    )


def navcam_layout(rows: int) -> IndexLayout:
    return parse_index_label(label_text(*navcam_columns(), rows), "edrindex.lbl")


def navcam_columns() -> tuple[dict[str, tuple[int, int]], int]:
    columns, start = {}, 1
    for name, kind, length in COLUMNS:
        quoted = kind == "CHARACTER"
        columns[name] = (start + quoted, length)
        start += length + 2 * quoted + 1
    columns["ROVER_MOTION_COUNTER"] = (start, 34)
    return columns, start + 34


def navcam_row(**values: object) -> bytes:
    fields = []
    for name, kind, length in COLUMNS:
        text = f"{values.get(name, '0')!s:<{length}}"
        fields.append(f'"{text}"' if kind == "CHARACTER" else text)
    fields += [f"{count:<6}" for count in values["ROVER_MOTION_COUNTER"]]
    return ("\t".join(fields) + "\n").encode()


def image_row(  # noqa: PLR0913 - one keyword for each thing that a test varies
    clock: int,
    eye: str,
    kind: str = "eff",
    sol: int = 155,
    *,
    version: str = "1",
    instrument: str = "NAVCAM",
    image_type: str = "REGULAR",
    filter_number: int = 0,
    ticks: str = ".496",
    pose: int | None = None,
) -> bytes:
    letter = instrument[0].lower()
    name = f"2{letter}{clock:09d}{kind}9800p1501{eye}{filter_number}m{version}"
    return navcam_row(
        VOLUME_ID="mer2no_0xxx",
        INSTRUMENT_HOST_ID="MER2",
        INSTRUMENT_ID=f"{instrument}_{'LEFT' if eye == 'l' else 'RIGHT'}",
        PATH_NAME=f"data/sol{sol:04d}/edr/",
        FILE_NAME=f"{name}.img",
        PRODUCT_ID=name.upper(),
        PLANET_DAY_NUMBER=sol,
        SPACECRAFT_CLOCK_START_COUNT=f"{clock}{ticks}",
        SEQUENCE_ID="p1501",
        IMAGE_TYPE=image_type,
        SOLAR_LONGITUDE="-20.900101",
        ROVER_MOTION_COUNTER=(98, 0, 0, clock % 100 if pose is None else pose, 3),
    )


def found(rows, instrument="NAVCAM", sols=(155, 156, 157)):
    layout = navcam_layout(len(rows))
    selection = IndexSelection("MER2", instrument, frozenset(sols))
    return find_in_index(read_index_rows(layout, rows), selection)


def test_the_published_row_is_split_at_the_columns_of_its_label(test_vectors):
    published = test_vectors["index_row"]
    layout = parse_index_label(label_text(DESCAM, published["row_bytes"], 1), "edrindex.lbl")
    (row,) = read_index_rows(layout, [published["row"].encode()])
    for name, value in published["expected"].items():
        if isinstance(value, str):
            assert row.text(name) == value
        elif isinstance(value, list):
            assert list(row.integers(name)) == value
        elif isinstance(value, int):
            assert row.integer(name) == value
        else:
            assert row.real(name) == value


def test_a_row_of_another_width_is_split_at_its_tabs():
    layout = navcam_layout(1)
    narrow = b"\t".join(
        field.strip() for field in image_row(151600000, "l").rstrip(b"\n").split(b"\t")
    ).replace(b' "', b'"')
    (row,) = read_index_rows(layout, [narrow + b"\r\n"])
    assert len(narrow) < layout.row_bytes - 2
    assert row.integer("PLANET_DAY_NUMBER") == 155
    assert row.text("FILE_NAME") == "2n151600000eff9800p1501l0m1.img"
    assert row.integers("ROVER_MOTION_COUNTER") == (98, 0, 0, 0, 3)


def test_a_row_whose_columns_have_shifted_is_split_at_its_tabs():
    layout = navcam_layout(1)
    shifted = image_row(151600000, "l").replace(b'"mer2no_0xxx"', b'"mer2no_0xxx_cd1"', 1)
    shifted = shifted.replace(b"edr/" + b" " * 4, b"edr/", 1)  # as wide as ever, but moved by four
    (row,) = read_index_rows(layout, [shifted])
    assert len(row.line) == layout.row_bytes - 1
    assert row.text("INSTRUMENT_HOST_ID") == "MER2"


def test_rows_end_with_one_byte_or_two():
    layout = navcam_layout(2)
    row = image_row(151600000, "l")
    unix, dos = (
        list(read_index_rows(layout, [row.replace(b"\n", end)])) for end in (b"\n", b"\r\n")
    )
    assert unix[0].line == dos[0].line


@PATIENT
@given(cuts=st.lists(st.integers(0, 1_500), max_size=8))
def test_rows_across_stream_chunks_are_read(cuts):
    table = b"".join(image_row(151600000 + k, "lr"[k % 2]) for k in range(5))
    places = [0, *sorted(cut % len(table) for cut in cuts), len(table)]
    chunks = [table[a:b] for a, b in pairwise(places)]
    layout = navcam_layout(5)
    assert [row.line for row in read_index_rows(layout, chunks)] == table.split(b"\n")[:5]


def test_both_eyes_of_one_exposure_are_a_pair():
    findings = found([image_row(151600000, "l"), image_row(151600000, "r")])
    (pair,) = findings.pairs
    assert pair.left.file_name == "2n151600000eff9800p1501l0m1.img"
    assert pair.right.file_name == "2n151600000eff9800p1501r0m1.img"
    assert not findings.unpaired


def test_eyes_some_ticks_apart_are_a_pair_as_in_a_downlink():
    """Clock strings differ, even in the second; at most a second apart, as `partners` has it."""
    rows = [
        image_row(151600000, "l", ticks=".998", pose=1),
        image_row(151600001, "r", ticks=".003", pose=1),
        image_row(151600003, "l", ticks=".100", pose=1),  # the next exposure at the same pose
        image_row(151600003, "r", ticks=".096", pose=1),
        image_row(151600010, "l", ticks=".100", pose=1),
        image_row(151600011, "r", ticks=".200", pose=1),
    ]
    findings = found(rows)
    clocks = [(pair.left.clock, pair.right.clock) for pair in findings.pairs]
    assert clocks == [(151600000.998, 151600001.003), (151600003.1, 151600003.096)]
    assert [entry.clock for entry in findings.unpaired] == [151600010.1, 151600011.2]


def test_a_clock_may_have_a_partition_and_is_a_number():
    pair = [image_row(151600000, "l"), image_row(151600000, "r")]
    partitioned = [row.replace(b"151600000.496  ", b"1/151600000.496") for row in pair]
    assert found(partitioned).pairs[0].left.clock == 151600000.496
    findings = found([*pair, image_row(151600000, "l", ticks=" late")])
    assert findings.broken == 1
    assert "row 3: SPACECRAFT_CLOCK_START_COUNT should be seconds, but" in findings.first_fault


def test_frames_of_other_times_kinds_sols_and_instruments_are_not_a_pair():
    findings = found(
        [
            image_row(151600000, "l"),
            image_row(151600001, "r"),
            image_row(151600002, "l", "eth", image_type="THUMBNAIL"),
            image_row(151600002, "r", "eth", image_type="THUMBNAIL"),
            image_row(151600005, "l", image_type="REF_PIXELS"),
            image_row(151600005, "r", image_type="REF_PIXELS"),
            image_row(151600003, "l", sol=158),
            image_row(151600003, "r", sol=158),
            image_row(151600004, "l", instrument="PANCAM"),
            image_row(151600004, "r", instrument="PANCAM"),
        ]
    )
    assert not findings.pairs
    assert [entry.eye for entry in findings.unpaired] == ["left", "right"]


def test_the_highest_version_and_the_full_frame_are_preferred():
    rows = [
        image_row(151600000, eye, kind, version=version)
        for eye in "lr"
        for kind in ("edn", "eff", "esf")
        for version in ("1", "B", "2")
    ]
    (pair,) = found(rows).pairs
    assert pair.left.file_name.endswith("l0mB.img")
    assert pair.left.name.product_type == pair.right.name.product_type == "EFF"


def test_an_index_with_one_clock_for_all_rows_is_searched_as_fast():
    rows = [image_row(151600000, "lr"[k % 2], version="123456789"[k % 9]) for k in range(4_000)]
    (pair,) = found(rows).pairs
    assert pair.left.name.version == pair.right.name.version == "9"


def test_pancam_pairs_have_one_band():
    def rows(left, right):
        return [
            image_row(151600000, "l", instrument="PANCAM", filter_number=left),
            image_row(151600000, "r", instrument="PANCAM", filter_number=right),
        ]

    assert len(found(rows(2, 2), "PANCAM").pairs) == 1
    assert len(found(rows(7, 1), "pancam").pairs) == 1
    assert not found(rows(2, 1), "PANCAM").pairs


def test_hazcam_means_the_front_and_the_rear_one():
    rows = [
        image_row(151600000, eye, instrument=f"{side}_HAZCAM")
        for side in ("FRONT", "REAR")
        for eye in "lr"
    ]
    assert len(found(rows, "hazcam").pairs) == 2
    assert len(found(rows, "rear_hazcam").pairs) == 1


def test_a_broken_row_is_counted_and_the_rest_is_read():
    findings = found([b"sorry\n", image_row(151600000, "l"), image_row(151600000, "r")])
    assert len(findings.pairs) == 1
    assert findings.broken == 1
    assert "row 1 should be" in findings.first_fault
    assert "18 fields between tabs, but is 5 bytes wide and has 1 fields" in findings.first_fault


def test_an_invalid_number_is_named_with_row_and_column():
    row = image_row(151600000, "l").replace(b"\t155 \t", b"\tsol \t")
    (broken,) = read_index_rows(navcam_layout(1), [row])
    with pytest.raises(LabelError, match=r"row 1: PLANET_DAY_NUMBER should be a whole .*'sol'"):
        broken.integer("PLANET_DAY_NUMBER")


def test_a_missing_column_is_named():
    (row,) = read_index_rows(navcam_layout(1), [image_row(151600000, "l")])
    with pytest.raises(LabelError, match="the index has no column LINES"):
        row.integer("LINES")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ROW_BYTES", "ROW_BITES", "it has no ROW_BYTES"),
        ("START_BYTE = 2\n", "START_BYTE = many\n", "START_BYTE should be a whole number"),
        ("START_BYTE = 2\n", "START_BYTE = 99999999\n", "column VOLUME_ID: START_BYTE 99999999"),
        ("BYTES = 11\n", "BYTES = 0\n", "column VOLUME_ID"),
        ("ITEM_BYTES = 6\n", "", "lacks ITEM_BYTES"),
        ("OBJECT = EDR_INDEX_TABLE\nEND", "", "END"),
    ],
)
def test_a_label_without_a_table_is_refused_with_the_reason(old, new, message):
    text = label_text(DESCAM, 773, 1)
    assert old in text
    with pytest.raises(LabelError, match=message):
        parse_index_label(text.replace(old, new), "edrindex.lbl")


def test_a_file_without_line_ends_is_refused_before_it_fills_the_memory():
    endless = (b"x" * 10_000 for _ in range(1_000))
    with pytest.raises(LabelError, match="no line end came within 65536"):
        list(read_index_rows(navcam_layout(1), endless))


SIXTY_THOUSAND = """
import sys, time, tracemalloc
from solmap.photogrammetry.archive.tables.volume_index import (
    IndexSelection, find_in_index, parse_index_label, read_index_rows
)

label, left, right = (text.encode("latin-1") for text in sys.argv[1:])
layout = parse_index_label(label.decode(), "edrindex.lbl")

def chunks():
    for first in range(0, 60_000, 40):
        rows = []
        for k in range(first, first + 40):
            row = (left, right)[k % 2].replace(b"151600000", b"%d" % (151_600_000 + k // 2 * 20))
            rows.append(row.replace(b"\t155 ", b"\t%-4d" % (1 + k // 400)))
        yield b"".join(rows)

selection = IndexSelection("MER2", "NAVCAM", frozenset(range(100, 103)))
tracemalloc.start()
findings = find_in_index(read_index_rows(layout, chunks()), selection)
print(findings.rows, len(findings.pairs), findings.broken, tracemalloc.get_traced_memory()[1])
"""


def test_sixty_thousand_rows_need_little_memory():
    """As many rows as Spirit's Navcam index has, of 21 MB; 600 pairs are requested and found.

    In a process of its own: the checks of array types in this one triple what is measured.
    """
    rows = [image_row(151600000, eye).decode() for eye in "lr"]
    label = label_text(*navcam_columns(), 60_000)
    done = subprocess.run(
        [sys.executable, "-c", SIXTY_THOUSAND, label, *rows],
        capture_output=True,
        text=True,
        check=True,
    )
    count, pairs, broken, peak = map(int, done.stdout.split())
    assert (count, pairs, broken) == (60_000, 600, 0)
    assert peak < 4e6  # 1,200 entries of about 1 kB, and one chunk


@PATIENT
@given(
    place=st.floats(0, 1),
    removed=st.integers(0, 60),
    inserted=st.sampled_from(
        ["", '"', "(", "=", "\n", "END_OBJECT", "OBJECT = COLUMN\n", "-9", "\x00"]
    ),
)
def test_a_damaged_label_raises_our_error_or_gives_a_layout(place, removed, inserted):
    text = label_text(DESCAM, 773, 1)
    at = int(place * len(text))
    try:
        layout = parse_index_label(text[:at] + inserted + text[at + removed :], "edrindex.lbl")
    except LabelError as error:
        assert str(error).startswith("edrindex.lbl: ")  # noqa: PT017 - a layout is as good
    else:
        assert layout.columns


@PATIENT
@given(row=st.binary(max_size=500), at=st.integers(0, 356), removed=st.integers(0, 9))
def test_a_damaged_row_is_counted_or_read(row, at, removed):
    good = image_row(151600000, "l")
    damaged = good[:at] + row + good[at + removed :]
    findings = found([damaged, good, image_row(151600000, "r")])
    assert findings.pairs or findings.broken
