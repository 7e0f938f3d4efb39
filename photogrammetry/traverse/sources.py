"""Traverses from files: tables of whole missions, vector files, PLACES and location files.

Tables are those of the Analyst's Notebook of MER. The path table has a row per motion: SITE, DRIVE,
START_SOL, END_SOL, RAW_X, RAW_Y, RAW_Z (telemetry: east, north, elevation in metres from the
lander) and CORRECTED_X, CORRECTED_Y, the localised position on an equirectangular map. Tables and
GeoJSON files of sites and drives give the localised positions as longitude and latitude, beside the
same map coordinates. Pitfalls:

- rows are duplicated, and a stop has a row for every sol that the rover stayed;
- some are separated by tabs and have decimal commas, or another separator in the header;
- CORRECTED_X is in metres of the equator, so that a metre of ground to the east is CORRECTED_X
  cos(latitude); here longitude is used, so no scaling is needed;
- the GeoJSON files state Earth degrees (EPSG:4326); they are degrees of Mars;
- RAW_Z is 0 everywhere, which is not an elevation.

The stops of vector files, PLACES tables and location files are chained into the LSL.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.archive.tables.vector_files import VectorFile, best_poses, lsl_tree
from solmap.photogrammetry.arrays import Float64, Int32, ObjectPoints
from solmap.photogrammetry.errors import FrameError, TraverseError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind
from solmap.photogrammetry.mars import MARS_RADIUS_M, map_from_lsl
from solmap.photogrammetry.traverse.records import Traverse

TELEMETRY = ("raw_x", "raw_y", "raw_z")
CORRECTED = ("corrected_x", "corrected_y")
NAMES = {
    "rmcsite": "site",
    "rmcdrive": "drive",
    "rmcpose": "pose",
    "firstsol": "start_sol",
    "lastsol": "end_sol",
    "xcorrected": "corrected_x",
    "ycorrected": "corrected_y",
}
"""Names of the same columns in the tables of sites and drives."""
MAX_TABLE = 1 << 26
SAME_PLACE_M = 0.01
"""Rows of one stop farther apart than this contradict each other."""
Row = tuple[str, Mapping[str, str]]
"""Its location, and its fields by the name of their column."""


@dataclass(frozen=True, slots=True)
class Equirectangular:
    """The map of the corrected positions: x = R (longitude - meridian), y = R latitude."""

    central_meridian_deg: float = 175.5
    """Central meridian of the Analyst's Notebook of Spirit."""
    radius_m: float = MARS_RADIUS_M

    def degrees(self, x: float, y: float) -> tuple[float, float]:
        """East longitude and planetocentric latitude of a point on the map."""
        return self.central_meridian_deg + math.degrees(x / self.radius_m), math.degrees(
            y / self.radius_m
        )


@dataclass(frozen=True, slots=True, eq=False)
class MissionTable:
    """The stops of a mission, once each, in the order of the traverse."""

    source: str
    stops: tuple[str, ...]
    sols: Int32[np.ndarray, " points"]
    """Sol on which each was reached."""
    telemetry_m: ObjectPoints | None
    """(east, north, up) from the lander; up is NaN where the table has none. None: not in the
    table."""
    localised_deg: Float64[np.ndarray, "points 2"] | None
    """East longitude and planetocentric latitude. None: not in the table."""
    notes: tuple[str, ...]
    """Corrections made, for the log."""

    def telemetry(self) -> Traverse:
        """The traverse by telemetry.

        Raises:
            TraverseError: the table has no telemetry.
        """
        if self.telemetry_m is None:
            raise TraverseError(
                f"{self.source} contains no telemetry (RAW_X, RAW_Y): compare another"
            )
        return Traverse("telemetry", self.stops, self.sols, self.telemetry_m)


def parse_mission_table(
    text: str, source: str, corrected_map: Equirectangular | None = None
) -> MissionTable:
    """Read a path table, or a table or GeoJSON file of sites or drives.

    Args:
        text: The file.
        source: Its name, for messages.
        corrected_map: The map of CORRECTED_X and CORRECTED_Y, where the file gives no longitude and
            latitude.

    Raises:
        TraverseError: the file is none of them, or a row of it is broken; the message names the
            line.
    """
    if len(text) > MAX_TABLE:
        raise TraverseError(f"{source}: {len(text)} characters are too many for a traverse table")
    is_json = text.lstrip("\ufeff \t\r\n").startswith("{")
    rows = list(_geojson_rows(text, source) if is_json else _table_rows(text, source))
    if not rows:
        raise TraverseError(f"{source}: no row with a stop; a traverse table has one per motion")
    notes = ["its degrees are those of Mars, although it states another CRS"] if is_json else []
    return _table(rows, source, corrected_map or Equirectangular(), notes)


def _table_rows(text: str, source: str) -> Iterator[Row]:
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        return
    header = [name.strip().lower() for name in re.split(r"[\t,;]", lines[0][1].lstrip("\ufeff"))]
    columns = [NAMES.get(name, name) for name in header]
    if not {"site", "drive"} <= set(columns):
        raise TraverseError(f"{source}: not a traverse table: its first line lacks SITE and DRIVE")
    for number, line in lines[1:]:
        fields = _fields(line, len(columns))
        if len(fields) != len(columns):
            raise TraverseError(
                f"{source}: line {number} has {len(fields)} fields where the header has "
                f"{len(columns)}: is it truncated?"
            )
        yield f"{source}: line {number}", dict(zip(columns, fields, strict=True))


def _fields(line: str, count: int) -> list[str]:
    """Fields of a row; separated by tabs, numbers may have decimal commas."""
    for separator in ("\t", ";"):
        fields = line.split(separator)
        if len(fields) == count:
            return [field.strip().replace(",", ".") for field in fields]
    return [field.strip() for field in re.split(r"[\t,]", line)]


def _geojson_rows(text: str, source: str) -> Iterator[Row]:
    try:
        features = json.loads(text)["features"]
        for number, feature in enumerate(features, 1):
            fields = {name.lower(): value for name, value in feature["properties"].items()}
            longitude, latitude = feature["geometry"]["coordinates"][:2]
            named = {NAMES.get(name, name): str(value) for name, value in fields.items()}
            yield (
                f"{source}: feature {number}",
                {**named, "longitude": str(longitude), "latitude": str(latitude)},
            )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise TraverseError(
            f"{source}: not a GeoJSON file of sites or drives: {error!r}; expected points with "
            "rmcSite"
        ) from error


def _table(
    rows: Sequence[Row], source: str, corrected_map: Equirectangular, notes: list[str]
) -> MissionTable:
    columns = set(rows[0][1])
    has_telemetry = set(TELEMETRY[:2]) <= columns
    in_degrees = {"longitude", "latitude"} <= columns
    has_places = in_degrees or set(CORRECTED) <= columns
    if not has_telemetry and not has_places:
        raise TraverseError(
            f"{source}: neither RAW_X, RAW_Y nor CORRECTED_X, CORRECTED_Y nor longitude, latitude"
        )
    once: dict[str, Row] = {}
    for row in sorted(rows, key=_counter):
        once.setdefault(_stop(row), row)
    first = list(once.values())
    if len(rows) > len(first):
        notes.append(f"{len(rows) - len(first)} rows of {len(rows)} repeat a stop")
    apart = _contradictions(rows, once) if has_telemetry else []
    if apart:
        notes.append(
            f"{len(apart)} stops have rows at several positions, the first is used: "
            f"{', '.join(apart[:3])}"
        )
    telemetry = np.array([_telemetry_of(row) for row in first]) if has_telemetry else None
    if telemetry is not None and not telemetry[:, 2].any():
        telemetry[:, 2] = np.nan
        notes.append("RAW_Z is 0 everywhere: no elevations")
    return MissionTable(
        source=source,
        stops=tuple(_stop(row) for row in first),
        sols=np.array([_whole(row, "start_sol") for row in first], dtype=np.int32),
        telemetry_m=telemetry,
        localised_deg=(
            np.array([_degrees_of(row, corrected_map, in_degrees=in_degrees) for row in first])
            if has_places
            else None
        ),
        notes=tuple(notes),
    )


def _contradictions(rows: Iterable[Row], once: Mapping[str, Row]) -> list[str]:
    """Stops with a row at another position than the one used."""
    apart = [
        _stop(row)
        for row in rows
        if math.dist(_telemetry_of(once[_stop(row)]), _telemetry_of(row)) > SAME_PLACE_M
    ]
    return list(dict.fromkeys(apart))


def _counter(row: Row) -> tuple[int, int, int]:
    return _whole(row, "site"), _whole(row, "drive"), _whole(row, "start_sol")


def _stop(row: Row) -> str:
    return f"{_whole(row, 'site')}/{_whole(row, 'drive')}"


def _telemetry_of(row: Row) -> tuple[float, float, float]:
    up = _number(row, "raw_z") if row[1].get("raw_z") else 0.0
    return _number(row, "raw_x"), _number(row, "raw_y"), up


def _degrees_of(
    row: Row, corrected_map: Equirectangular, *, in_degrees: bool
) -> tuple[float, float]:
    if in_degrees:
        return _number(row, "longitude"), _number(row, "latitude")
    return corrected_map.degrees(_number(row, CORRECTED[0]), _number(row, CORRECTED[1]))


def _whole(row: Row, name: str) -> int:
    where, fields = row
    text = fields.get(name, "0")
    if not re.fullmatch(r"[+-]?\d{1,9}", text):
        raise TraverseError(f"{where}: {name} should be a whole number, but is {text[:40]!a}")
    return int(text)


def _number(row: Row, name: str) -> float:
    where, fields = row
    text = fields.get(name, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TraverseError(f"{where}: {name} should be a number, but is {text[:40]!a}")
    return value


def traverse_of_vectors(files: Sequence[VectorFile], solution: str = "") -> Traverse:
    """The stops of vector files, in the order of their counters; sites where there are no rovers.

    A file with only sites gives the origins of the sites, the positions of the rover when each was
    declared. Vector files have no sols; they are 0.

    Args:
        files: Of one mission.
        solution: Which of their solutions; by default the preferred one for each.

    Raises:
        TraverseError: none of their stops is connected to the LSL.
    """
    chosen = [_only(file, solution) for file in files] if solution else list(files)
    given = best_poses(chosen)
    tree = lsl_tree(given).tree
    frames = sorted((pose.source for pose in given), key=lambda frame: frame.index)
    rovers = {frame.index[0] for frame in frames if frame.kind is FrameKind.ROVER}
    used = [f for f in frames if f.kind is FrameKind.ROVER or f.index[0] not in rovers]
    placed: dict[str, np.ndarray] = {}
    for frame in used:
        try:
            placed.setdefault(_name(frame), tree.pose(LSL, frame).translation_m)
        except FrameError:
            continue
    if not placed:
        names = ", ".join(file.source for file in files) or "no file"
        raise TraverseError(f"{names}: no stop is connected to the landing site; add the .svf")
    label = solution or next(iter({s.solution_id for f in chosen for s in f.solutions}), "")
    sols = np.zeros(len(placed), dtype=np.int32)
    return Traverse(label, tuple(placed), sols, map_from_lsl(np.array(list(placed.values()))))


def _only(file: VectorFile, solution: str) -> VectorFile:
    kept = tuple(one for one in file.solutions if one.solution_id == solution)
    return VectorFile(file.source, file.mission, file.kind, file.priority, kept)


def _name(frame: Frame) -> str:
    site, drive = frame.index[0], frame.index[1] if len(frame.index) > 1 else 0
    return f"{site}/{drive}"
