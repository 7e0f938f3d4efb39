"""Times as labels write them."""

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.archive.images.reading import read_image_record
from solmap.photogrammetry.archive.times import time_text, utc_of

NAME = "2n292280938effb100p0703l0m1.img"
IN_JUNE = datetime(2004, 6, 10, 8, 0, 36, 816_000, UTC)
FORMS = {
    "2004-06-10T08:00:36.816": IN_JUNE,
    "2004-06-10T08:00:36.816Z": IN_JUNE,
    "2004-06-10t08:00:36.816z": IN_JUNE,
    "2004-162T08:00:36.816": IN_JUNE,
    "2004-162T08:00:36.816Z": IN_JUNE,
    "2004-162T08:00:36.": IN_JUNE.replace(microsecond=0),
    "2004-162T08:00": IN_JUNE.replace(second=0, microsecond=0),
    "2004-162T08": datetime(2004, 6, 10, 8, tzinfo=UTC),
    "2004-06-10T08": datetime(2004, 6, 10, 8, tzinfo=UTC),
    "2004-162": datetime(2004, 6, 10, tzinfo=UTC),
    "2004-06-10": datetime(2004, 6, 10, tzinfo=UTC),
    "2004-06": datetime(2004, 6, 1, tzinfo=UTC),
    "2004": datetime(2004, 1, 1, tzinfo=UTC),
    "2005-12-31T23:59:60": datetime(2006, 1, 1, tzinfo=UTC),
    "2005-365T23:59:60.5Z": datetime(2006, 1, 1, 0, 0, 0, 500_000, UTC),
    "2004-06-10T24:00:00": datetime(2004, 6, 11, tzinfo=UTC),
    "2004-162T24:00:00.000Z": datetime(2004, 6, 11, tzinfo=UTC),
}
UNKNOWN = ("UNK", "unk", "UNKNOWN", "N/A", '"N/A"', "NULL", "", "2005-366", "2004-06-10T24:00:01")
NO_TIMES = ("yesterday", "2004-13-01", "0000-01-01", "9999-12-31T24:00:00", "2004-06T08", "1" * 400)


@pytest.mark.parametrize("text", FORMS)
def test_every_legal_time_is_parsed(text):
    assert utc_of(text) == FORMS[text]
    assert utc_of(time_text(text)) == FORMS[text]


def test_an_iso_time_is_kept():
    for text in ("2004-06-10T08:00:36.816", "2004-06-10T08:00:36.816Z", "2004-06-10T08:00"):
        assert time_text(text) == text
    assert time_text("2004-162T08:00:36.816") == "2004-06-10T08:00:36.816"


@pytest.mark.parametrize("text", [*UNKNOWN, *NO_TIMES, None])
def test_an_invalid_time_is_unknown(text):
    assert utc_of(text) is None
    assert time_text(text) is None


@given(st.text(max_size=50))
def test_any_text_is_a_time_or_none(text):
    known = time_text(text)
    assert known is None or (known.isprintable() and utc_of(known) == utc_of(text))


@pytest.mark.parametrize("text", [*FORMS, *(text for text in UNKNOWN if text and '"' not in text)])
def test_an_image_is_read_with_times_of_any_form(small, text):
    quoted = small.but("2009-04-06T08:48:13.468", f'"{text}"').but('"11:23:54"', f'"{text}"')
    for image in (quoted, small.but("2009-04-06T08:48:13.468", text)):
        assert utc_of(read_image_record(image.data, NAME).start_time) == FORMS.get(text)
