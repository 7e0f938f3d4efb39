"""The downlink of a rover that drives through a world with known truth.

    world = make_world(WorldParams(terrain="hills"), rng_seed=4)
    files = [*text_files(world), *(job.run(world) for job in render_jobs(world))]

One seed fixes landscape, traverse, telemetry and mast errors, and the noise of every image, each
from its own random stream: files are the same whether made one by one, in threads, or in processes.

The downlink includes vector files with the telemetry solution, as in the archive: one SVF per rover
with the origin of every site in the previous one; one RVF per site with the pose of the rover at
every motion counter. The first site is given in site 0 with no offset, so that the
origin of the LSL is the first stop. Numbers have six digits, as in the archive.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np

from solmap.photogrammetry.archive.tables.vector_files import Solution, VectorFile, vector_text
from solmap.photogrammetry.frames import FrameKind
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic.edr import CLOCK_ZERO, edr_bytes, format_number
from solmap.photogrammetry.synthetic.render import photograph
from solmap.photogrammetry.synthetic.scene import Shot, World, WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import Stop
from solmap.photogrammetry.synthetic.truth import truth_document

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def site_vector_file(stops: Sequence[Stop], added: datetime) -> str:
    """The SVF: every site in the previous one."""
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
    return vector_text(file, format_number)


def _date(added: datetime) -> str:
    return f"{added:%Y-%m-%dT%H:%M:%SZ}"


@dataclass(frozen=True, slots=True)
class DownlinkFile:
    """A file of the downlink: its path in the folder, and its content."""

    path: str
    data: bytes


@dataclass(frozen=True, slots=True)
class RenderJob:
    """One image to be rendered. Jobs depend only on the world."""

    shot: Shot
    eye: Eye

    def path(self, world: World) -> str:
        """Path of the image in the downlink."""
        exposure = world.exposure(self.shot, self.eye)
        return f"sol{exposure.sol:04d}/edr/{exposure.file_name}"

    def run(self, world: World) -> DownlinkFile:
        """Render the image."""
        exposure = world.exposure(self.shot, self.eye)
        data = edr_bytes(exposure, photograph(world, self.shot, self.eye))
        return DownlinkFile(self.path(world), data)


def render_jobs(world: World) -> list[RenderJob]:
    """All images of the downlink, stop by stop."""
    return [RenderJob(shot, eye) for shot in world.shots for eye in (Eye.LEFT, Eye.RIGHT)]


def simulate_downlink(params: WorldParams, rng_seed: int) -> Iterator[DownlinkFile]:
    """The files of a downlink, one after the other: vector files, truth, images."""
    world = make_world(params, rng_seed)
    yield from text_files(world)
    for job in render_jobs(world):
        yield job.run(world)


def text_files(world: World) -> list[DownlinkFile]:
    """Site and rover vector files, and the truth."""
    added = CLOCK_ZERO.replace(year=2004, month=6, day=10, microsecond=0)
    texts = {"masters/mer2_master.svf": site_vector_file(world.stops, added)}
    for site, text in rover_vector_files(world.stops, added).items():
        texts[f"masters/mer2_site_{site:03d}_master.rvf"] = text
    texts["truth/truth.json"] = json.dumps(truth_document(world), indent=1)
    return [DownlinkFile(path, text.encode("ascii")) for path, text in texts.items()]
