"""No text of a table is a formula; everything else stays as it is."""

import csv
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.products.formats.documents.csv_table import csv_table


def cells(value):
    return list(csv.reader(io.StringIO(csv_table(["a", "b"], [[value, 1]]), newline="")))[1]


@pytest.mark.parametrize(
    "text",
    ["=1+1", "+1+1", "-1+1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", " =1", "=cmd|'/C calc'!A0", "＝1"],
)
def test_a_text_like_a_formula_is_written_as_text(text):
    assert cells(text)[0] == f"'{text}"


@pytest.mark.parametrize("value", ["rock", "", "-12.5", "+3e-4", "a=b", "2004-162", "'quoted'"])
def test_other_texts_and_numbers_in_texts_are_unchanged(value):
    assert cells(value)[0] == value


def test_numbers_stay_numbers_and_none_is_an_empty_cell():
    assert cells(-1.5)[0] == "-1.5"
    assert cells(None)[0] == ""


@given(st.text(alphabet="=+-@\t\r\n 1a"))
def test_no_cell_begins_a_formula(text):
    found = next(csv.reader(io.StringIO(csv_table([text], []), newline="")))[0]
    assert found in {text, f"'{text}"}
    if found.lstrip()[:1] in set("=+-@"):
        float(found)  # a number stays a number
