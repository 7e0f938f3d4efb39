"""Site and rover vector files: the telemetry solution of the traverse, as the archive keeps it.

One SVF a rover holds the origin of every site in the site before; one RVF a site holds the pose of
the rover at every motion counter (facts 4.3). The first site is given in site 0 with no offset, so
that the LSL begins at the first stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from photogrammetry.frames import Pose
from photogrammetry.synthetic.edr import number
from photogrammetry.synthetic.traverse import Stop

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
PRIORITY = ' <priority>\n  <entry solution_id="telemetry"/>\n </priority>\n'


def site_vector_file(stops: Sequence[Stop], added: datetime) -> str:
    """The SVF: every site in the one before it."""
    sites = {stop.id.site: stop.lsl_from_site.translation_m for stop in stops}
    text, before = "", (0, np.zeros(3))
    for site, origin in sites.items():
        head = f'name="SITE_FRAME" {_date(added)} index1="{site}"'
        level = np.array([1.0, 0.0, 0.0, 0.0])
        text += _solution(head, before[0], origin - before[1], level)
        before = (site, origin)
    return f'{HEAD}<rmc_file mission="MER2" variant="Master_SVF">\n{PRIORITY}{text}</rmc_file>\n'


def rover_vector_files(stops: Sequence[Stop], added: datetime) -> dict[int, str]:
    """The RVF of every site: the rover at each of its stops."""
    files = {}
    for site in dict.fromkeys(stop.id.site for stop in stops):
        text = "".join(_rover_solution(stop, added) for stop in stops if stop.id.site == site)
        files[site] = (
            f'{HEAD}<rmc_file mission="MER2" variant="Master_RVF" index1="{site}">\n'
            f"{PRIORITY}{text}</rmc_file>\n"
        )
    return files


def _rover_solution(stop: Stop, added: datetime) -> str:
    counter = (stop.id.site, stop.id.drive, 0, 0, 0)
    index = " ".join(f'index{k}="{value}"' for k, value in enumerate(counter, 1))
    pose: Pose = stop.site_from_rover
    head = f'name="ROVER_FRAME" {_date(added)} {index}'
    return _solution(head, stop.id.site, pose.translation_m, pose.quaternion)


def _date(added: datetime) -> str:
    return f'add_date="{added:%Y-%m-%dT%H:%M:%SZ}"'


def _solution(head: str, site: int, offset: np.ndarray, quaternion: np.ndarray) -> str:
    place = " ".join(f'{axis}="{number(v)}"' for axis, v in zip("xyz", offset, strict=True))
    turn = zip(("s", "v1", "v2", "v3"), quaternion, strict=True)
    attitude = " ".join(f'{axis}="{number(v)}"' for axis, v in turn)
    return (
        f' <solution solution_id="telemetry" {head}>\n'
        f'  <reference_frame name="SITE_FRAME" index1="{site}"/>\n'
        f"  <offset {place}/>\n  <orientation {attitude}/>\n </solution>\n"
    )
