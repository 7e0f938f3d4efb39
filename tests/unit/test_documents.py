"""What documents say of tests and files is true."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FEATURES = ROOT / "docs" / "features.md"
TEST = re.compile(r"`(?P<file>[\w/-]+\.\w+)(?:::(?P<name>\w+))?`")


def rows() -> list[str]:
    return [line for line in FEATURES.read_text().splitlines() if re.match(r"\| \d", line)]


def test_every_row_of_the_table_of_features_is_there():
    assert [int(row.split("|")[1]) for row in rows()] == list(range(1, 55))


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.split("|")[1].strip())
def test_a_feature_that_is_claimed_is_shown_by_a_test_that_exists(row):
    claimed = row.split("|")[3].strip()
    test = TEST.search(row)
    if claimed.startswith("–"):
        assert test is None
        return
    file = ROOT / test["file"]
    assert file.is_file(), f"{file} is not there"
    if test["name"]:
        assert f"def {test['name']}(" in file.read_text()
