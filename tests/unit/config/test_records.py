from dataclasses import dataclass, field
from enum import StrEnum

import pytest

from solmap.config.records import ConfigError, record_of


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

    def __post_init__(self) -> None:
        if self.cell_m <= 0:
            raise ValueError("cell_m must be above zero")


def test_absent_keys_keep_their_defaults():
    assert record_of(Outer, {}, "dtm") == Outer()


def test_tables_fill_records_and_whole_numbers_serve_as_metres():
    made = record_of(Outer, {"cell_m": 1, "interval_m": 2, "inner": {"size_px": 21}}, "dtm")
    assert made == Outer(cell_m=1.0, interval_m=2, inner=Inner(size_px=21))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"cel_m": 1.0}, "dtm has no setting 'cel_m'; it has cell_m, colour, inner, interval_m"),
        ({"inner": {"sizepx": 1}}, "dtm.inner has no setting 'sizepx'"),
        ({"cell_m": "small"}, "dtm.cell_m takes float, not 'small'"),
        ({"colour": "blue"}, "dtm.colour is one of red, not 'blue'"),
        ({"cell_m": -1.0}, "dtm: cell_m must be above zero"),
    ],
)
def test_a_wrong_setting_names_itself(table, message):
    with pytest.raises(ConfigError, match=message):
        record_of(Outer, table, "dtm")
