"""PLACES tables and the location files of MSL: localised stops read, own solutions written.

PLACES gives every site and rover stop in the landing site local frame, one row per frame:

    frame,site,drive,pose,landing_x,landing_y,landing_z,...,roll,pitch,yaw,quat_s,quat_v1,...,sol

x north, y east, z down from site 0, quaternion scalar first, SITE rows with drive -1. The view of a
table (telemetry, best_tactical, best_interp, localized_pos, localized_interp) is given only by its
name, so the caller passes the name of the solution.

`locations.xml` of MSL lists <location> elements with site, drive, x, y, z, lon, lat and rot = (v1,
v2, v3, s), the quaternion with the scalar last. x is north and y east on an equirectangular map
with metres of the equator, so that a metre of ground to the east is y cos(lat) (0.3 percent at Gale
crater); z is down, within the site. In the one known file every quaternion is the identity, which
means "not given": such stops have only a position and are omitted unless requested, while sites,
whose axes are north, east and down by definition, are used.

Both become the `VectorFile` that SVF and RVF files are read into, so `best_poses` chooses among all
of them by one order of priority. Positions refer to site 0, not to the stop's own site.

An own solution is written as a PLACES table of rover stops: offsets to a tenth of a millimetre,
quaternions to 1e-9.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from solmap.photogrammetry.archive.tables.vector_files import Solution, VectorFile, check_pose
from solmap.photogrammetry.archive.xml_text import xml_root
from solmap.photogrammetry.errors import VectorFileError
from solmap.photogrammetry.frames import FrameKind, Pose, roll_pitch_yaw_of_rotation
from solmap.photogrammetry.imagery import StopId

LOCALISED, ORBITAL, SPICE = "localised", "orbital", "spice"
"""Names of solutions: by people, by an orbital image registered here, from SPICE kernels."""
PRIORITY = (LOCALISED, ORBITAL, "adjusted", SPICE, "telemetry")
"""Sources of positions, from the most to the least reliable."""
MAX_TABLE = 1 << 26
"""Characters; rows are read one by one, and at most `MAX_ROWS` are kept."""
MAX_ROWS = 200_000
"""Enough for a rover that moved every minute for years."""
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
PLACES_COLUMNS = ("frame", "site", "drive", "landing_x", "landing_y", "landing_z")
QUATERNION = ("quat_s", "quat_v1", "quat_v2", "quat_v3")
_WHOLE = re.compile(r"[+-]?\d{1,9}")
PLACES_HEAD = (
    *PLACES_COLUMNS[:3],
    "pose",
    *PLACES_COLUMNS[3:],
    "planetocentric_latitude",
    "longitude",
    "roll",
    "pitch",
    "yaw",
    *QUATERNION,
    "sclk",
    "sol",
)


def parse_localisations(
    text: str, source: str, *, mission: str = "MSL", keep_without_attitude: bool = False
) -> VectorFile:
    """A PLACES table or an MSL location file, distinguished by their first character.

    `keep_without_attitude` includes stops of a location file without attitude, as in
    `parse_locations`.

    Raises:
        VectorFileError: the text is neither, or one of its rows is broken.
    """
    if text.lstrip("\ufeff \t\r\n").startswith("<"):
        return parse_locations(
            text, source, mission=mission, keep_without_attitude=keep_without_attitude
        )
    return parse_places(text, source, mission=mission)


def parse_places(
    text: str, source: str, *, mission: str, solution_id: str = LOCALISED
) -> VectorFile:
    """A PLACES table; rows without a position (empty landing_x) are omitted.

    Raises:
        VectorFileError: a column is missing or a value is not a number; the message names the line.
    """
    if len(text) > MAX_TABLE:
        raise VectorFileError(f"{source}: {len(text)} characters are too many for a PLACES table")
    reader = csv.DictReader(io.StringIO(text.lstrip("\ufeff")), skipinitialspace=True)
    solutions: list[Solution] = []
    try:
        fields = [field.strip().lower() for field in reader.fieldnames or ()]
        lacking = [column for column in PLACES_COLUMNS if column not in fields]
        if lacking:
            raise VectorFileError(
                f"{source}: not a PLACES table: its first line lacks {', '.join(lacking)}"
            )
        reader.fieldnames = fields
        for row in reader:
            solution = _of_row(row, f"{source}: line {reader.line_num}", solution_id)
            if solution is not None:
                solutions.append(solution)
            if len(solutions) > MAX_ROWS:
                raise VectorFileError(f"{source}: more than {MAX_ROWS} rows")
    except csv.Error as error:
        raise VectorFileError(f"{source}: line {reader.line_num}: {error}") from error
    return _file(source, mission, solution_id, solutions)


def _of_row(row: Mapping[str, Any], where: str, solution_id: str) -> Solution | None:
    """The solution of one row of a PLACES table."""
    if not (row["landing_x"] or "").strip():
        return None
    frame = (row["frame"] or "").strip().upper()
    site, drive = (
        whole_number(row["site"], "site", where),
        whole_number(row["drive"], "drive", where),
    )
    counter: tuple[int, ...] = (site,)
    kind = FrameKind.SITE
    if frame.startswith("ROVER"):
        kind, counter = FrameKind.ROVER, (site, drive, *_pose_counter(row, where))
    elif not frame.startswith("SITE"):
        raise VectorFileError(f"{where}: frame should be SITE or ROVER, but is {frame[:40]!a}")
    offset_m = numbers_of([row[key] for key in PLACES_COLUMNS[3:]], "landing_x, y, z", where)
    given = [row.get(key) for key in QUATERNION]
    if kind is FrameKind.ROVER and not all((value or "").strip() for value in given):
        return None  # a position without attitude is not a pose
    quaternion = (
        numbers_of(given, "quat_s, v1, v2, v3", where) if kind is FrameKind.ROVER else IDENTITY
    )
    return _solution(solution_id, kind, counter, offset_m, quaternion, where)


def _pose_counter(row: Mapping[str, Any], where: str) -> tuple[int, ...]:
    pose = (row.get("pose") or "").strip()
    return (max(0, whole_number(pose, "pose", where)),) if pose else ()


def parse_locations(
    text: str, source: str, *, mission: str, keep_without_attitude: bool = False
) -> VectorFile:
    """The locations.xml of MSL.

    Args:
        text: the file.
        source: its name.
        mission: its mission, which the file does not name.
        keep_without_attitude: also include stops whose quaternion is the identity, as if measured.

    Raises:
        VectorFileError: the file is not one, lacks site 0, or has a broken element.
    """
    root = xml_root(text, source, "msl", "locations", VectorFileError)
    places = [_place(element, source) for element in root.iterfind("./location")]
    origins = [place[1] for place in places if place[0][:2] == (0, 0)]
    if not origins:
        raise VectorFileError(
            f"{source}: no <location> of site 0, drive 0, the position of the lander"
        )
    ground_scale = np.cos(np.radians(numbers_of([_lander_latitude(root)], "lat", source)[0]))
    solutions = []
    for (site, drive), map_m, quaternion in places:
        offset_m = (map_m - origins[0]) * [1.0, ground_scale, 1.0]
        where = f"{source}: site {site}, drive {drive}"
        if drive == 0:
            solutions.append(
                _solution(LOCALISED, FrameKind.SITE, (site,), offset_m, IDENTITY, where)
            )
        if keep_without_attitude or not np.array_equal(np.abs(quaternion), IDENTITY):
            counter = (site, drive)
            solutions.append(
                _solution(LOCALISED, FrameKind.ROVER, counter, offset_m, quaternion, where)
            )
    return _file(source, mission, LOCALISED, [s for s in solutions if s is not None])


def _lander_latitude(root: Element) -> str:
    """Value of <lat> at site 0, degrees."""
    for element in root.iterfind("./location"):
        if int(element.findtext("site") or 0) == 0:
            return element.findtext("lat") or ""
    return ""


def _place(element: Element, source: str) -> tuple[tuple[int, int], np.ndarray, np.ndarray]:
    """(site, drive), (north, east, down) on the map, and the quaternion scalar first."""

    def text(tag: str) -> str:
        return (element.findtext(tag) or "").strip()

    site, drive = (
        whole_number(text("site"), "site", source),
        whole_number(text("drive"), "drive", source),
    )
    where = f"{source}: site {site}, drive {drive}"
    map_m = numbers_of([text(tag) for tag in "xyz"], "x, y, z", where)
    v1, v2, v3, s = numbers_of(text("rot").split(",", 8)[:4] or [""], "rot", where, count=4)
    return (site, drive), map_m, np.array([s, v1, v2, v3])


def _solution(
    solution_id: str,
    kind: FrameKind,
    counter: tuple[int, ...],
    offset_m: np.ndarray,
    quaternion: np.ndarray,
    where: str,
) -> Solution | None:
    """A solution in the frame of site 0, checked; None for site 0 itself, which needs none."""
    if kind is FrameKind.SITE and counter == (0,):
        return None
    if min(counter) < 0:
        raise VectorFileError(f"{where}: the counter {counter} should not be negative")
    solution = Solution(
        solution_id=solution_id,
        kind=kind,
        counter=counter,
        reference_site=0,
        offset_m=offset_m,
        quaternion=quaternion,
        added="",
    )
    check_pose(solution, where)
    return solution


def _file(source: str, mission: str, solution_id: str, solutions: Sequence[Solution]) -> VectorFile:
    if not solutions:
        raise VectorFileError(f"{source}: expected at least one pose, found none")
    kinds = {solution.kind for solution in solutions}
    priority = PRIORITY if solution_id in PRIORITY else (solution_id, *PRIORITY)
    return VectorFile(
        source=source,
        mission=mission,
        kind="svf" if kinds == {FrameKind.SITE} else "rvf",
        priority=priority,
        solutions=tuple(solutions),
    )


def whole_number(text: str | None, name: str, where: str) -> int:
    """A cell of a table; `where` names it in messages.

    Raises:
        VectorFileError: it is not a whole number of at most nine digits.
    """
    text = (text or "").strip()
    if not _WHOLE.fullmatch(text):
        raise VectorFileError(f"{where}: {name} should be a whole number, but is {text[:40]!a}")
    return int(text)


def numbers_of(
    texts: Iterable[str | None], names: str, where: str, count: int | None = None
) -> np.ndarray:
    """Cells of a table, `count` of them where given.

    Raises:
        VectorFileError: they are not finite numbers.
    """
    given = [(text or "").strip() for text in texts]
    try:
        values = np.array([float(text) for text in given])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all() or (count is not None and len(values) != count):
        shown = ", ".join(given)
        raise VectorFileError(f"{where}: {names} should be numbers, but are {shown[:60]!a}")
    return values


@dataclass(frozen=True, slots=True, eq=False)
class PlacedStop:
    """A stop of a solution, in the LSL and on Mars."""

    stop: StopId
    lsl_from_rover: Pose
    longitude_deg: float
    latitude_deg: float
    """Planetocentric."""
    clock: float | None
    """Spacecraft clock of its first image, seconds; None where unknown."""
    sol: int


def places_text(stops: Iterable[PlacedStop]) -> str:
    """A PLACES table of rover stops; `parse_places` reads it back."""
    sheet = io.StringIO()
    writer = csv.writer(sheet, lineterminator="\n")
    writer.writerow(PLACES_HEAD)
    for placed in stops:
        pose = placed.lsl_from_rover
        angles = np.degrees(roll_pitch_yaw_of_rotation(pose.rotation))
        writer.writerow(
            (
                "ROVER",
                placed.stop.site,
                placed.stop.drive,
                "",
                *(f"{value:.4f}" for value in pose.translation_m),
                f"{placed.latitude_deg:.9f}",
                f"{placed.longitude_deg:.9f}",
                *(f"{angle:.5f}" for angle in angles),
                *(f"{value:.9f}" for value in pose.quaternion),
                "" if placed.clock is None or math.isnan(placed.clock) else f"{placed.clock:.3f}",
                placed.sol,
            )
        )
    return sheet.getvalue()
