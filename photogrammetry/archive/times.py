"""Times of labels, in every form allowed by the PDS standards.

    2004-06-10T08:00:36.816        calendar, and the same followed by Z
    2004-162T08:00:36.816          day of the year
    2005-12-31T23:59:60.5          a leap second; it counts as the first second of the next day
    2004-06-10T24:00:00            midnight at the end of a day
    2004, 2004-06, 2004-06-10T08   shortened: the beginning of what is named
    UNK, UNKNOWN, N/A, NULL, ""    not known

All are UTC. Any other text counts as unknown: it causes no image to be rejected and no map to be
left out.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

MAX_CHARACTERS = 40
_CLOCK = r"(?P<hour>\d\d)(?::(?P<minute>\d\d)(?::(?P<second>\d\d(?:\.\d*)?))?)?"
_TIME = re.compile(
    r"(?P<year>\d{4})"
    rf"(?:-(?:(?P<day_of_year>\d{{3}})|(?P<month>\d\d)-(?P<day>\d\d))(?:T{_CLOCK})?"
    r"|-(?P<month_alone>\d\d))?Z?",
    re.ASCII | re.IGNORECASE,
)


def utc_of(text: str | None) -> datetime | None:
    """The moment of a label's time; None where it is not a time."""
    text = "" if text is None else text.strip()
    if len(text) > MAX_CHARACTERS:
        return None
    try:
        moment = datetime.fromisoformat(text)
        return moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return _of_pds(text)


def time_text(text: str | None) -> str | None:
    """A time of a label in a form that sorts: unchanged where it is ISO 8601."""
    moment = utc_of(text)
    if text is None or moment is None:
        return None
    try:
        datetime.fromisoformat(text)
    except ValueError:
        is_iso = False
    else:
        is_iso = text.isascii() and text.isprintable()
    return text if is_iso else moment.replace(tzinfo=None).isoformat(timespec="milliseconds")


def _of_pds(text: str) -> datetime | None:
    """The forms outside ISO 8601, or outside Python's reading of it."""
    match = _TIME.fullmatch(text)
    if match is None:
        return None
    hour, minute, second = (float(match[name] or 0) for name in ("hour", "minute", "second"))
    is_midnight = hour == 24 and minute == second == 0  # noqa: PLR2004 - hours of a day
    is_leap = (hour, minute) == (23, 59) and 60 <= second < 61  # noqa: PLR2004
    is_within = hour < 24 and minute < 60 and second < 60  # noqa: PLR2004
    if not (is_midnight or is_leap or is_within):
        return None
    try:
        first = datetime(
            int(match["year"]),
            int(match["month"] or match["month_alone"] or 1),
            int(match["day"] or 1),
            tzinfo=UTC,
        )
        days = int(match["day_of_year"] or 1) - 1
        moment = first + timedelta(days=days, hours=hour, minutes=minute, seconds=second)
        is_of_year = days >= 0 and (first + timedelta(days=days)).year == first.year
    except (ValueError, OverflowError):
        return None
    return moment if is_of_year else None
