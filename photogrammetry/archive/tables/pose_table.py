"""Poses CSV: poses of the rover, or of a stereo rig, one per row, with standard deviations.

UTF-8, commas, names of columns in the first line in any order; empty lines and lines that start
with # are skipped.

    image or site,drive          the stop: any image taken there, or its motion counters
    x_m,y_m,z_m                  origin of the rover, metres north, east, down of the reference site
    reference_site               that site; by default the stop's own (0 is the lander)
    qw,qx,qy,qz                  attitude: rover (x forward, y right, z down) into north, east, down
    or roll_deg,pitch_deg,yaw_deg     R = Rz(yaw) Ry(pitch) Rx(roll), yaw clockwise from north
    sigma_m,sigma_deg            standard deviations of each coordinate and of each rotation
    sol,source                   shown beside it

Only the stop and the position are required; an empty value is not given.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.archive.tables.places import (
    MAX_ROWS,
    MAX_TABLE,
    numbers_of,
    whole_number,
)
from solmap.photogrammetry.arrays import Quaternion, Vector3
from solmap.photogrammetry.errors import FrameError, VectorFileError
from solmap.photogrammetry.frames import (
    quaternion_of_rotation,
    rotation_of_quaternion,
    rotation_of_roll_pitch_yaw,
)

POSITION = ("x_m", "y_m", "z_m")
QUATERNION = ("qw", "qx", "qy", "qz")
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
COUNTERS = ("site", "drive", "sol", "reference_site")
SIGMAS = ("sigma_m", "sigma_deg")
COLUMNS = ("image", *COUNTERS, *POSITION, *QUATERNION, *ANGLES, *SIGMAS, "source")


@dataclass(frozen=True, slots=True, eq=False)
class PoseRow:
    """A pose given by a person or another program."""

    image: str | None
    """Identifier of an image of the stop: capital letters, without an ending."""
    site: int | None
    drive: int | None
    sol: int | None
    reference_site: int | None
    """Site of its frame (north, east, down); None: the stop's own site."""
    position_m: Vector3
    quaternion: Quaternion | None
    """Scalar first, rover into that frame; None: no attitude given."""
    sigma_m: float | None
    sigma_deg: float | None
    source: str | None
    where: str
    """File and line, for messages."""


def is_pose_table(text: str) -> bool:
    """Whether a text has the columns of a poses CSV."""
    columns = _rows(text).fieldnames or ()
    return set(POSITION) <= {column.strip().lower() for column in columns}


def parse_poses(text: str, source: str) -> tuple[PoseRow, ...]:
    """The rows of a poses CSV.

    Raises:
        VectorFileError: a column or value is missing, unknown or not a number; the message names
            file and line.
    """
    if len(text) > MAX_TABLE:
        raise VectorFileError(f"{source}: {len(text)} characters are too many for a poses CSV")
    reader = _rows(text)
    columns = [column.strip().lower() for column in reader.fieldnames or ()]
    unknown = [column for column in columns if column not in COLUMNS]
    lacking = [column for column in POSITION if column not in columns]
    if "image" not in columns and not {"site", "drive"} <= set(columns):
        lacking.insert(0, "image, or site and drive")
    if unknown or lacking:
        wrong = f"lacks {', '.join(lacking)}" if lacking else f"has {', '.join(unknown)[:80]!a}"
        raise VectorFileError(
            f"{source}: the first line of a poses CSV {wrong}; its columns are {', '.join(COLUMNS)}"
        )
    reader.fieldnames = columns
    rows: list[PoseRow] = []
    try:
        for number, row in enumerate(reader, 1):
            rows.append(_row(row, f"{source}, row {number}"))
            if len(rows) > MAX_ROWS:
                raise VectorFileError(f"{source}: more than {MAX_ROWS} poses")
    except csv.Error as error:
        raise VectorFileError(f"{source}: row {len(rows) + 1}: {error}") from error
    if not rows:
        raise VectorFileError(f"{source}: expected at least one pose, found none")
    return tuple(rows)


def _rows(text: str) -> csv.DictReader[str]:
    """The lines that are neither empty nor comments, as rows."""
    lines = (line for line in io.StringIO(text.lstrip("\ufeff")) if line.strip())
    return csv.DictReader(
        (line for line in lines if not line.lstrip().startswith("#")), skipinitialspace=True
    )


def _row(cells: Mapping[str, str | None], where: str) -> PoseRow:
    row = {name: (text or "").strip() for name, text in cells.items() if isinstance(name, str)}

    def counter(name: str) -> int | None:
        return whole_number(row[name], name, where) if row.get(name) else None

    def group(names: tuple[str, ...]) -> np.ndarray | None:
        given = [row.get(name, "") for name in names]
        return numbers_of(given, ", ".join(names), where) if any(given) else None

    image = row.get("image", "").rpartition("/")[2].partition(".")[0].upper() or None
    site, drive, sol, reference_site = (counter(name) for name in COUNTERS)
    if image is None and (site is None or drive is None):
        raise VectorFileError(f"{where}: the stop is missing; give image, or site and drive")
    position_m = numbers_of([row.get(name, "") for name in POSITION], "x_m, y_m, z_m", where)
    sigmas = [group((name,)) for name in SIGMAS]
    for name, sigma in zip(SIGMAS, sigmas, strict=True):
        if sigma is not None and not sigma[0] > 0:
            raise VectorFileError(f"{where}: {name} is a standard deviation and must be above 0")
    sigma_m, sigma_deg = (None if sigma is None else float(sigma[0]) for sigma in sigmas)
    quaternion, angles = group(QUATERNION), group(ANGLES)
    if quaternion is not None:
        try:
            rotation_of_quaternion(quaternion)
        except FrameError as error:
            raise VectorFileError(f"{where}: {error}") from error
    elif angles is not None:
        quaternion = quaternion_of_rotation(rotation_of_roll_pitch_yaw(*np.radians(angles)))
    return PoseRow(
        image,
        site,
        drive,
        sol,
        reference_site,
        position_m,
        quaternion,
        sigma_m,
        sigma_deg,
        row.get("source") or None,
        where,
    )
