"""Files of edit requests: manual tie points to add, automatic ties to veto or move.

Two formats have the same columns (`COLUMNS`): CSV with a line of names at its head, and GeoJSON, a
FeatureCollection whose features have the columns as properties; geometries, which a map may add,
are ignored. The columns are documented in `EditRequest`.
"""

from __future__ import annotations

import math

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.manual.editing import (
    SIGMA_PX,
    TOLERANCE_PX,
    EditAction,
    EditPoint,
    EditRequest,
)
from solmap.products.formats.documents.row_files import Row, RowFormat

POINTS = ("sample", "line", "right_sample", "right_line")
COLUMNS = (
    "action",
    *(f"{side}_{what}" for side in ("first", "second") for what in ("image", *POINTS)),
    "sigma_px",
    "tolerance_px",
    "note",
)
FORMAT = RowFormat(COLUMNS, "action", MatchingError, may_end_short=True)
LARGEST_PX = 1e5
"""Upper limit of image coordinates."""


def parse_edit_requests(text: str, source: str) -> tuple[EditRequest, ...]:
    """Read a file of edit requests; GeoJSON where it starts with a brace, CSV otherwise.

    Raises:
        MatchingError: the message names the file, the row (the first below the names is 1), and
            the fault.
    """
    return FORMAT.parse(text, source, _request)


def _request(row: Row, where: str) -> EditRequest:
    unknown = sorted(set(row) - set(COLUMNS))
    if unknown:
        raise MatchingError(f"there is no column {unknown[0]!a}; there are {', '.join(COLUMNS)}")
    action = str(row.get("action") or "").lower()
    if action not in set(EditAction):
        raise MatchingError(f"action should be add, veto or move, not {action[:40]!a}")
    return EditRequest(
        EditAction(action),
        _point(row, "first"),
        _point(row, "second"),
        _number(row, "sigma_px", SIGMA_PX),
        _number(row, "tolerance_px", TOLERANCE_PX),
        where,
    )


def _point(row: Row, side: str) -> EditPoint:
    image = str(row.get(f"{side}_image") or "").strip().upper()
    if "-DRIVE" in image:
        image = image.lower()  # a stop
    return EditPoint(image, _place(row, f"{side}_"), _place(row, f"{side}_right_"))


def _place(row: Row, prefix: str) -> tuple[float, float] | None:
    sample, line = (_number(row, f"{prefix}{what}", math.nan) for what in ("sample", "line"))
    if math.isnan(sample) != math.isnan(line):
        raise MatchingError(
            f"{prefix}sample and {prefix}line must be given together; one of them is empty"
        )
    return None if math.isnan(sample) else (sample, line)


def _number(row: Row, name: str, otherwise: float) -> float:
    value = row.get(name)
    if value is None or value == "":
        return otherwise
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(value, bool) or not abs(number) < LARGEST_PX:
        raise MatchingError(f"{name} should be a number, not {str(value)[:40]!a}")
    return number
