"""What documents say of tests and files is true."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FEATURES = ROOT / "docs" / "features.md"
LINK = re.compile(r"\[`(?P<name>[^`]+)`\]\(\.\./(?P<file>[^)]+)\)")


def rows() -> list[str]:
    return [line for line in FEATURES.read_text().splitlines() if re.match(r"\| \d", line)]


def test_every_row_of_the_table_of_features_is_there():
    assert [int(row.split("|")[1]) for row in rows()] == list(range(1, 55))


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.split("|")[1].strip())
def test_a_feature_that_is_claimed_is_shown_by_a_test_that_exists(row):
    claimed = row.split("|")[3].strip()
    link = LINK.search(row)
    if claimed.startswith("–"):
        assert link is None
        return
    file = ROOT / link["file"]
    assert file.is_file(), f"{file} is not there"
    if link["name"].startswith("test_"):
        assert f"def {link['name']}(" in file.read_text()
