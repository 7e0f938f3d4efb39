"""Vector files and PLACES tables, written: an own solution as other tools read one.

A pair of SVF and RVFs is written as a whole: sites where the solution's chain has them, rovers in
their sites, so that whoever composes both comes out at the stop's place in the LSL. Offsets are
written to a tenth of a millimetre, quaternions to 1e-9.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.archive.places import PLACES_COLUMNS, QUATERNION
from solmap.photogrammetry.archive.vector_files import Solution, VectorFile
from solmap.photogrammetry.frames import FrameKind, Pose, roll_pitch_yaw_of_rotation
from solmap.photogrammetry.imagery import StopId

FRAME_NAMES = {FrameKind.SITE: "SITE_FRAME", FrameKind.ROVER: "ROVER_FRAME"}
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

Digits = Callable[[float], str]


def _plain(value: float) -> str:
    return f"{value:.9f}"


def vector_text(file: VectorFile, number: Digits = _plain) -> str:
    """The XML of a vector file; `parse_vector_file` reads it back."""
    first = file.solutions[0]
    site = f' index1="{first.counter[0]}"' if file.kind == "rvf" else ""
    entries = "".join(f'  <entry solution_id="{name}"/>\n' for name in file.priority)
    solutions = "".join(_solution(one, number) for one in file.solutions)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<rmc_file mission="{file.mission}" variant="Master_{file.kind.upper()}"{site}>\n'
        f" <priority>\n{entries} </priority>\n{solutions}</rmc_file>\n"
    )


def _solution(one: Solution, number: Digits) -> str:
    index = " ".join(f'index{k}="{value}"' for k, value in enumerate(one.counter, 1))
    place = " ".join(f'{axis}="{number(v)}"' for axis, v in zip("xyz", one.offset_m, strict=True))
    turn = zip(("s", "v1", "v2", "v3"), one.quaternion, strict=True)
    attitude = " ".join(f'{axis}="{number(v)}"' for axis, v in turn)
    added = f'add_date="{one.added}" ' if one.added else ""
    head = f'solution_id="{one.solution_id}" name="{FRAME_NAMES[one.kind]}"'
    return (
        f" <solution {head} {added}{index}>\n"
        f'  <reference_frame name="SITE_FRAME" index1="{one.reference_site}"/>\n'
        f"  <offset {place}/>\n  <orientation {attitude}/>\n </solution>\n"
    )


@dataclass(frozen=True, slots=True, eq=False)
class PlacedStop:
    """A stop of a solution, in the LSL and on Mars."""

    stop: StopId
    lsl_from_rover: Pose
    longitude_deg: float
    latitude_deg: float
    """Planetocentric."""
    clock: float | None
    """Spacecraft clock of its first image, seconds; None where it is not known."""
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
