import os
from dataclasses import dataclass, field
from enum import StrEnum

import pytest

from solmap.config.records import ConfigError, faults_of, read_toml, record_of


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True, slots=True)
class Inner:
    size_px: int = 15


@dataclass(frozen=True, slots=True)
class Outer:
    cell_m: float = 0.04
    colour: Colour = Colour.RED
    interval_m: float | None = None
    inner: Inner = field(default_factory=Inner)
    span_m: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        if self.cell_m <= 0:
            raise ValueError("cell_m must be above zero")


def test_absent_keys_keep_their_defaults():
    assert record_of(Outer, {}, "dtm") == Outer()


def test_tables_fill_records_and_integers_are_accepted_as_metres():
    made = record_of(Outer, {"cell_m": 1, "interval_m": 2, "inner": {"size_px": 21}}, "dtm")
    assert made == Outer(cell_m=1.0, interval_m=2, inner=Inner(size_px=21))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"cel_m": 1.0},
            "has no setting 'cel_m'; it has cell_m, colour, inner, interval_m, span_m",
        ),
        ({"inner": {"sizepx": 1}}, "dtm.inner has no setting 'sizepx'"),
        ({"cell_m": "small"}, "dtm.cell_m takes float, not 'small'"),
        ({"colour": "blue"}, "dtm.colour is one of red, not 'blue'"),
        ({"cell_m": -1.0}, "dtm: cell_m must be above zero"),
        ({"cel_m": 1.0}, r"span_m; did you mean cell_m\?$"),
        ({"inner": 3}, "dtm.inner is a table, not 3"),
        ({"span_m": 3.0}, "dtm.span_m is a list, not 3.0"),
        ({"span_m": [3.0]}, "dtm.span_m is a list of 2, not of 1"),
    ],
)
def test_a_wrong_setting_is_named(table, message):
    with pytest.raises(ConfigError, match=message):
        record_of(Outer, table, "dtm")


def test_all_faults_of_a_table_are_named_at_once():
    table = {"cel_m": 1.0, "colour": "blue", "inner": {"size": 1}, "interval_m": 2.0}
    faults = faults_of(Outer, table, "dtm")
    assert [fault.partition(" ")[0] for fault in faults] == ["dtm", "dtm.colour", "dtm.inner"]
    assert faults[2].endswith("did you mean size_px?")


def test_a_value_that_the_record_refuses_is_a_fault():
    assert faults_of(Outer, {"cell_m": -1.0, "x": 1}, "dtm")[1:] == [
        "dtm: cell_m must be above zero"
    ]
    assert not faults_of(Outer, {"cell_m": 1, "span_m": [1, 2], "inner": {"size_px": 3}}, "dtm")


@pytest.mark.parametrize(
    ("text", "message_"),
    [
        ("x = " + "9" * 5000, "Exceeds the limit"),
        ("x = " + "[" * 5000, "recursion"),
        ("x = \x00", "TOML|Illegal|Invalid"),
        (b"\xff", "utf-8"),
        (None, "No such file"),
    ],
)
def test_an_invalid_toml_file_is_one_line(text, message_, tmp_path):
    file = tmp_path / "own.toml"
    if text is not None:
        file.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(ConfigError, match=message_) as refused:
        read_toml(file)
    assert str(refused.value).startswith(f"{file}")
    assert "\n" not in str(refused.value)


def test_only_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "own.toml")
    for path in (tmp_path / "own.toml", tmp_path):
        with pytest.raises(ConfigError, match="is not a file"):
            read_toml(path)
