"""Tables of comma-separated values for spreadsheets.

A spreadsheet takes a text that begins with one of a few characters for a formula and carries it
out, whoever wrote it. Such texts are written with an apostrophe before them, which spreadsheets
take for "this is text" (OWASP, CSV injection). Numbers stay numbers.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable

_FORMULA = re.compile(r"[\t\r\n ]*[=+\-@\t\r\n\uff0b\uff0d\uff1d\uff20]")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def csv_table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table; None is an empty cell, and no text is a formula."""
    text = io.StringIO()
    table = csv.writer(text)  # ends lines by RFC 4180, so that both of its characters are quoted
    table.writerow([_cell(name) for name in head])
    table.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return "" if value is None else value
    is_formula = _FORMULA.match(value) and not _NUMBER.fullmatch(value)
    return f"'{value}" if is_formula else value
