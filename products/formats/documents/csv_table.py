"""Tables of comma-separated values for spreadsheets.

A spreadsheet interprets a text that begins with certain characters as a formula and executes it.
Such texts are written with a leading apostrophe, which marks text in spreadsheets (OWASP, CSV
injection). Numbers stay numbers.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable

_FORMULA = re.compile(r"[\t\r\n ]*[=+\-@\t\r\n\uff0b\uff0d\uff1d\uff20]")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def csv_table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table; None is an empty cell, and texts cannot become formulas."""
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
