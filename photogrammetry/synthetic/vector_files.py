"""Site and rover vector files: the telemetry solution of the traverse, as the archive keeps it.

One SVF a rover holds the origin of every site in the site before; one RVF a site holds the pose of
the rover at every motion counter (facts 4.3). The first site is given in site 0 with no offset, so
that the LSL begins at the first stop. Numbers have six digits, as in the archive.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Literal

import numpy as np

from solmap.photogrammetry.archive.vector_files import Solution, VectorFile
from solmap.photogrammetry.archive.vector_writing import vector_text
from solmap.photogrammetry.frames import FrameKind
from solmap.photogrammetry.synthetic.edr import number
from solmap.photogrammetry.synthetic.traverse import Stop

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def site_vector_file(stops: Sequence[Stop], added: datetime) -> str:
    """The SVF: every site in the one before it."""
    sites = {stop.id.site: stop.lsl_from_site.translation_m for stop in stops}
    solutions, before = [], (0, np.zeros(3))
    for site, origin in sites.items():
        offset = origin - before[1]
        solutions.append(
            Solution("telemetry", FrameKind.SITE, (site,), before[0], offset, LEVEL, _date(added))
        )
        before = (site, origin)
    return _text("svf", solutions)


def rover_vector_files(stops: Sequence[Stop], added: datetime) -> dict[int, str]:
    """The RVF of every site: the rover at each of its stops."""
    return {
        site: _text("rvf", [_rover_solution(stop, added) for stop in stops if stop.id.site == site])
        for site in dict.fromkeys(stop.id.site for stop in stops)
    }


def _rover_solution(stop: Stop, added: datetime) -> Solution:
    pose = stop.site_from_rover
    counter = (stop.id.site, stop.id.drive, 0, 0, 0)
    offset, turn = pose.translation_m, pose.quaternion
    return Solution("telemetry", FrameKind.ROVER, counter, stop.id.site, offset, turn, _date(added))


def _text(kind: Literal["svf", "rvf"], solutions: Sequence[Solution]) -> str:
    file = VectorFile("", "MER2", kind, ("telemetry",), tuple(solutions))
    return vector_text(file, number)


def _date(added: datetime) -> str:
    return f"{added:%Y-%m-%dT%H:%M:%SZ}"
