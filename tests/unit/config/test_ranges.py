"""Every number of the pipeline has a range; what lies outside is refused when a file is read."""

import dataclasses
import functools
import math
from typing import get_type_hints

import pytest

from solmap.config.pipeline import PipelineConfig, faults_of_pipeline, load_pipeline
from solmap.config.records import ConfigError, range_of, record_of


def fields(record, *above):
    """Path, type and value of every parameter."""
    hints = get_type_hints(type(record), include_extras=True)
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            yield from fields(value, *above, field.name)
        else:
            yield (*above, field.name), hints[field.name], value


def table_of(path, value):
    for name in reversed(path):
        value = {name: value}
    return value


def is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


PARAMETERS = list(fields(PipelineConfig()))
NUMBERS = [
    (path, value) for path, hint, value in PARAMETERS if is_number(value) or "float" in str(hint)
]
WRONG = [math.nan, math.inf, -math.inf, 1e300, -1e300, 10**400, -(10**400), "1", True, [], {}]


def test_every_number_has_a_range():
    unlimited = [
        ".".join(path)
        for path, hint, value in PARAMETERS
        if not range_of(hint) and not isinstance(value, bool | str)
    ]
    assert unlimited == []
    assert len(NUMBERS) > 200


def test_every_default_lies_in_its_range():
    for path, value in NUMBERS:
        if value is not None:
            read = record_of(PipelineConfig, table_of(path, value), "own.toml")
            assert functools.reduce(getattr, path, read) == value, path


@pytest.mark.parametrize("wrong", WRONG, ids=lambda value: f"{value!r:.12}")
def test_impossible_numbers_are_refused_with_their_key(wrong):
    for path, value in NUMBERS:
        if wrong == [] and isinstance(value, tuple):
            continue  # a list may be empty
        where = "own.toml." + ".".join(path)
        with pytest.raises(ConfigError) as refused:
            record_of(PipelineConfig, table_of(path, wrong), "own.toml")
        assert where in str(refused.value)
        assert len(str(refused.value)) < 300


def test_the_range_is_named():
    with pytest.raises(ConfigError, match=r"dtm.cell_m should be at least 0.005, at most 100, not"):
        record_of(PipelineConfig, {"dtm": {"cell_m": -1}}, "own.toml")
    with pytest.raises(ConfigError, match=r"window_px should be at least 3, at most 101, odd, not"):
        record_of(PipelineConfig, {"sparse": {"window_px": 8}}, "own.toml")


@pytest.mark.parametrize(
    "table",
    [
        "[dtm]\nradius_m = 10000.0\ncell_m = 0.005\n",
        "[cross_site.birds_eye]\nradius_m = 10000.0\ncell_m = 0.005\n",
        "[region.fusion]\nlargest_m = 10000.0\ncell_m = 0.005\n",
    ],
)
def test_a_map_of_too_many_cells_is_refused(table, tmp_path):
    file = tmp_path / "own.toml"
    file.write_text(table)
    with pytest.raises(ConfigError, match=r"own\.toml.*cells"):
        load_pipeline(str(file))
    assert faults_of_pipeline(str(file))
