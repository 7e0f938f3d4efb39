"""Control measured by people: the records, and the text they are read from.

A row gives the position of a stop on another map, usually an orbital image. Two formats have the
same columns: CSV with a line of names at its head, and GeoJSON, a FeatureCollection of points with
the other columns as properties and [longitude, latitude] as geometry.

    stop                        `mer2-site0010-drive0064`, or `10/64` (site and drive)
    longitude, latitude         of the place in the image, degrees of Mars, east and planetocentric
    or east_m, north_m          the same in metres of the local map
    sigma_m                     standard deviation of either coordinate
    map_east_m, map_north_m     the place is not the rover's but that of this point of the rover's
                                map, a rock or crater rim that the stop sees
    up_m, sigma_up_m            height in the local map
    azimuth_deg, sigma_azimuth_deg    of the rover's x axis in the image, clockwise from north
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId
from solmap.products.formats.documents.row_files import Row, RowFormat

COLUMNS = (
    "stop",
    "longitude",
    "latitude",
    "east_m",
    "north_m",
    "sigma_m",
    "map_east_m",
    "map_north_m",
    "up_m",
    "sigma_up_m",
    "azimuth_deg",
    "sigma_azimuth_deg",
    "note",
)
NUMBERS = COLUMNS[1:-1]
TOGETHER = (
    ("longitude", "latitude"),
    ("east_m", "north_m"),
    ("map_east_m", "map_north_m"),
    ("up_m", "sigma_up_m"),
    ("azimuth_deg", "sigma_azimuth_deg"),
)
"""Columns that are given together or not at all."""
FORMAT = RowFormat(COLUMNS, "stop", AdjustmentError, has_places=True)
STOP = re.compile(r"(?:[a-z0-9]+-site0*(\d+)-drive0*(\d+)|(\d+)\s*/\s*(\d+))", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ControlRow:
    """Position of a stop, or of a point that it sees, on another map."""

    stop: StopId
    place: tuple[float, float]
    """(east, north) in metres, or (longitude, latitude) in degrees."""
    in_degrees: bool
    sigma_m: float
    map_point: tuple[float, float] | None = None
    """(east, north) of the same point on the rover's map; None: the rover's own position."""
    up: tuple[float, float] | None = None
    """Height of the rover and its standard deviation, metres."""
    azimuth: tuple[float, float] | None = None
    """Azimuth of the rover and its standard deviation, degrees."""


def parse_control(text: str, mission: str, source: str) -> tuple[ControlRow, ...]:
    """Read a file of control; GeoJSON where it starts with a brace, CSV otherwise.

    Raises:
        AdjustmentError: the message names the file, the row (first below the names: 1), and the
            fault.
    """
    if not text.strip():
        return ()  # an empty file withdraws all of it
    return FORMAT.parse(text, source, lambda row, _: _row(row, mission))


def _row(row: Row, mission: str) -> ControlRow:
    values = {name: _number(name, row.get(name)) for name in NUMBERS}
    for pair in TOGETHER:
        if (values[pair[0]] is None) != (values[pair[1]] is None):
            raise AdjustmentError(f"{pair[0]} and {pair[1]} must be given together or not at all")
    in_degrees = values["longitude"] is not None
    if in_degrees == (values["east_m"] is not None):
        raise AdjustmentError(
            "give the position as longitude and latitude, or as east_m and north_m"
        )
    for name in ("sigma_m", "sigma_up_m", "sigma_azimuth_deg"):
        value = values[name]
        if value is not None and value <= 0:
            raise AdjustmentError(f"{name} must be above zero, not {value:g}")
    sigma_m = values["sigma_m"]
    if sigma_m is None:
        raise AdjustmentError(
            "sigma_m, the standard deviation of the position in metres, is missing"
        )
    place = _both(values, "longitude", "latitude") or _both(values, "east_m", "north_m")
    if place is None:
        raise AdjustmentError("the position is missing")
    return ControlRow(
        _stop(str(row.get("stop") or ""), mission),
        place,
        in_degrees,
        sigma_m,
        _both(values, "map_east_m", "map_north_m"),
        _both(values, "up_m", "sigma_up_m"),
        _both(values, "azimuth_deg", "sigma_azimuth_deg"),
    )


def _number(name: str, value: object) -> float | None:
    if value is None or value == "":
        return None
    try:
        number = float(str(value))
    except ValueError as error:
        raise AdjustmentError(f"{name} should be a number, not {value!r}") from error
    if not math.isfinite(number):
        raise AdjustmentError(f"{name} should be finite, not {value!r}")
    return number


def _both(values: Mapping[str, float | None], one: str, other: str) -> tuple[float, float] | None:
    a, b = values[one], values[other]
    return None if a is None or b is None else (a, b)


def _stop(name: str, mission: str) -> StopId:
    found = STOP.fullmatch(name.strip())
    if found is None:
        raise AdjustmentError(
            f"{name!r} is not a stop: {mission.lower()}-site0010-drive0064 or 10/64 is expected"
        )
    site, drive = (int(part) for part in found.groups() if part is not None)
    return StopId(mission, site, drive)
