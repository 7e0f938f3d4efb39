"""Profiles and measured picks of a run of `rendered_husband`, compared with its truth.

    python -m tests.support.terrain.measure_truth STORE TRUTH_FOLDER [picks]

Lines of 15 m lie at random over the mapped ground. Picks are true conjugates of random pixels in
left Navcam images, the second moved by up to three pixels along each axis.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solmap.gis_server.analysis.bodies import UnanswerableError
from solmap.gis_server.analysis.ground import BEST, Ground
from solmap.gis_server.analysis.manual_ties import RefineQuestion, refine_pick
from solmap.gis_server.analysis.measures import ProfileQuestion, profile_of
from solmap.gis_server.rendering.reading import RasterPool
from solmap.photogrammetry.terrain.measure.ground_point import range_to_ground
from solmap.photogrammetry.terrain.measure.lines import _tangent
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace
from tests.support.husband_truth import true_pose
from tests.support.terrain.projection_truth import _true_point, elevations

BASELINE_M, LENGTH_M, LINES = 1.0, 15.0, 30
MOVED_PX, EDGE_PX, LAST_PX = 3.0, 30.0, 990.0


def profiles(workspace: Workspace, folder: Path) -> Iterator[str]:
    """How far elevations and slopes along random lines are off, and within how many sigmas."""
    layers = workspace.catalogue.layers("MER2")
    ground = Ground.of(layers, BEST, workspace.store, RasterPool())
    surface, rng = elevations(folder), np.random.default_rng(3)
    heights, slopes = [], []
    for _ in range(LINES):
        start, azimuth = rng.uniform([-15, -15], [45, 50]), rng.uniform(0, 2 * np.pi)
        end = start + LENGTH_M * np.array([np.cos(azimuth), np.sin(azimuth)])
        line = [tuple(start.tolist()), tuple(end.tolist())]
        found = profile_of(ProfileQuestion(line=line, slope_baseline_m=BASELINE_M), ground)
        truth = surface(found.stations.places)
        steep = np.arctan(_tangent(found.stations.distance_m, truth, BASELINE_M))
        heights.append(np.stack([found.ground.elevation - truth, found.ground.sigma_m]))
        slopes.append(np.degrees(np.stack([found.slope - steep, found.slope_sigma])))
    for what, unit, rows in (("elevation", "m", heights), ("slope", "degrees", slopes)):
        error, sigma = np.concatenate(rows, axis=1)
        known = np.isfinite(error) & np.isfinite(sigma)
        error, sigma = np.abs(error[known]), sigma[known]
        yield (
            f"{what}: {known.sum()} stations, median {np.median(error):.3f} {unit}, within one "
            f"sigma {np.mean(error < sigma):.2f}, within two {np.mean(error < 2 * sigma):.2f}"
        )


def picks(workspace: Workspace, folder: Path, queried: int, *, same_stop: bool) -> str:
    """How many moved picks are found, and how far off they are then."""
    mission = OrientedMission.latest("MER2", workspace)
    entries = [e for e in workspace.catalogue.images("MER2") if e.instrument == "NAVCAM"]
    lefts = [e for e in entries if e.eye == "left"]
    surface, rng = elevations(folder), np.random.default_rng(2)
    requested, off = 0, []
    while requested < queried:
        entry, pixel = lefts[rng.integers(len(lefts))], rng.uniform([30, 150], [990, 900])
        point = _true_point(entry, pixel, mission, folder, surface)
        other = (
            None if point is None else _seeing(entry, point, same_stop, (mission, folder, lefts))
        )
        if other is None:
            continue
        requested += 1
        image, at = other
        moved = at + rng.uniform(-MOVED_PX, MOVED_PX, 2)
        first = {"image": entry.id, "sample": pixel[0], "line": pixel[1]}
        second = {"image": image, "sample": moved[0], "line": moved[1]}
        try:
            found = refine_pick(RefineQuestion(first=first, second=second), mission)
        except UnanswerableError:
            continue
        if found.found:
            off.append(np.hypot(found.sample - at[0], found.line - at[1]))
    where = "within a stop" if same_stop else "between stops"
    middle, most = np.percentile(off, [50, 90]) if off else (np.nan, np.nan)
    found = f"{len(off)} of {requested} found"
    return f"picks {where}: {found}, median {middle:.2f} px, 90 % {most:.2f} px"


def _seeing(entry, point, same_stop, world):
    """The first other left image that truly sees a place, and where in it."""
    mission, folder, lefts = world
    for other in lefts:
        if other.id == entry.id or (other.stop == entry.stop) != same_stop:
            continue
        record = mission.record(other)
        camera = record.camera.transform(true_pose(folder, record))
        at = camera.project(point[None])[0]
        if not ((at > EDGE_PX) & (at < LAST_PX)).all():
            continue
        way = point - camera.centre
        distance = float(np.linalg.norm(way))
        met = range_to_ground(camera.centre, way / distance, elevations(folder), distance + 2, 0.02)
        if met is None or met > distance - 0.2:
            return other.id, at
    return None


if __name__ == "__main__":
    opened, truth_folder = Workspace.open(Path(sys.argv[1])), Path(sys.argv[2])
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 100
    for reported in profiles(opened, truth_folder):
        print(reported)  # noqa: T201
    for same in (True, False):
        print(picks(opened, truth_folder, count, same_stop=same))  # noqa: T201
