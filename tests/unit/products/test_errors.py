"""Any error becomes one bounded line of printable characters."""

import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.products.errors import LONGEST_LINE, cause_of, one_line
from tests.support.injection import ERRORS


@pytest.mark.parametrize("name", sorted(ERRORS))
def test_every_cause_is_one_bounded_line(name):
    error = ERRORS[name]()
    for is_named in (True, False):
        line = cause_of(error, is_named=is_named)
        assert line.isprintable()
        assert 0 < len(line) <= LONGEST_LINE
        line.encode()


def test_our_errors_are_printed_as_they_are_and_others_are_named():
    assert cause_of(MatchingError("no texture")) == "no texture"
    assert cause_of(MatchingError("no texture"), is_named=True) == "MatchingError: no texture"
    assert cause_of(KeyError("sol")) == "KeyError: 'sol'"
    assert cause_of(MemoryError()) == "MemoryError"


def test_line_ends_and_control_characters_are_removed():
    assert one_line("a\n  b\r\n\tc\x1b[31m\udcff") == "a b c\\x1b[31m\\udcff"
