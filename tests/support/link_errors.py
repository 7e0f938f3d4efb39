"""Links of a world by surfaces and by images alone, with found and with true pointings.

    python -m tests.support.link_errors realistic-hills7 [--only 0-1] [--true-pointing]
    python -m tests.support.link_errors .cache/worlds/day

Both start from the true pose. With true pointings of all pairs, the remainder is the error of the
registration; the difference to found pointings is what the mast adds. Errors are along and across
the way between the stops, and down; then azimuth and tilt.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.birds_eye import PlaneFit
from solmap.photogrammetry.matching.cross_site.gate import level_pose, search_gate
from solmap.photogrammetry.matching.cross_site.ground_grid import GroundGrid
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams, Trials
from solmap.photogrammetry.matching.cross_site.surface_alignment import register
from solmap.photogrammetry.matching.cross_site.surface_matching import HYPOTHESIS_SIGMAS
from solmap.photogrammetry.matching.records import MatchedPair
from tests.support.husband_truth import true_pose
from tests.support.simulated_stops import SimulatedStop
from tests.support.site_pairs import pointed
from tests.support.stop_networks import stops_of_world, world_folder

PARAMS = CrossSiteParams()


def truly_pointed(stop: SimulatedStop, folder: Path) -> SimulatedStop:
    """A stop with the true pointings of its pairs; the folder is that of a rendered world."""

    def turned(number: int, pair: MatchedPair) -> MatchedPair:
        if folder.is_dir():
            paths = folder.glob("sol*/edr/*.img")
            path = next(p for p in paths if p.stem.upper() == pair.pair_id.upper())
            lsl_from_label = true_pose(folder, read_image(path.read_bytes(), path.name).image)
        else:
            world = stop.world.world()
            lsl_from_label = world.true_lsl_from_label_rover(world.shot(stop.number, number))
        labelled = pair.geometry.rover_from_pair
        true = stop.true.inverse @ lsl_from_label @ labelled
        pose = Pose(labelled.target, labelled.source, true.rotation, true.translation_m)
        geometry = replace(pair.geometry, rover_from_pair=pose)
        return replace(pair, geometry=geometry)

    pairs = tuple(turned(k, pair) for k, pair in enumerate(stop.matched.pairs))
    return replace(stop, matched=replace(stop.matched, pairs=pairs))


def link_errors(one: SimulatedStop, other: SimulatedStop) -> Iterator[str]:
    """A line for the surfaces and one for the images."""
    stops, true = (one.matched, other.matched), one.true.inverse @ other.true
    start = Pose(one.stop.frame, other.stop.frame, true.rotation, true.translation_m)
    surface = PARAMS.surface_matching.surface
    grids = [GroundGrid.of(stop, surface.cell_m, surface.farthest_m) for stop in stops]
    prior = np.diag(np.square(HYPOTHESIS_SIGMAS))
    found = register(*grids, level_pose(*stops, start), prior, surface)
    if found is not None:
        level, turn = found.pose, one.matched.lsl_from_rover.rotation.T
        rotation = turn @ level.rotation @ other.matched.lsl_from_rover.rotation
        pose = Pose(start.target, start.source, rotation, turn @ level.translation_m)
        yield (
            f"surfaces, {found.area_m2:.0f} m2, {found.height_bias.lines:.2f} lines: "
            f"{_error(one, other, pose)}"
        )
    views = [StopViews.of(stop, PARAMS.birds_eye) for stop in stops]
    trials = Trials(*views, search_gate(*stops, PARAMS.gate)[1], PARAMS.trials)
    fine = trials.refine(trials.settle_at(PlaneFit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), start))
    if fine.alignment is not None:
        pose = fine.alignment.first_from_second
        yield f"images, {fine.agreeing} ties: {_error(one, other, pose)}"


def _error(one: SimulatedStop, other: SimulatedStop, pose: Pose) -> str:
    true, lsl = one.true.inverse @ other.true, one.true.rotation
    off_cm = 100 * lsl @ (pose.translation_m - true.translation_m)
    turn = Rotation.from_matrix(lsl @ pose.rotation @ true.rotation.T @ lsl.T).as_rotvec()
    way = (lsl @ true.translation_m)[:2]
    ahead = way / np.linalg.norm(way)
    along, across = float(off_cm[:2] @ ahead), float(ahead[0] * off_cm[1] - ahead[1] * off_cm[0])
    share = np.linalg.norm(off_cm) / np.linalg.norm(true.translation_m)
    azimuth, tilt = np.degrees([turn[2], np.hypot(*turn[:2])])
    return (
        f"along {along:.1f}, across {across:.1f}, down {off_cm[2]:.1f} cm, {share:.2f} %, "
        f"azimuth {azimuth:.2f}, tilt {tilt:.2f} deg"
    )


def main() -> None:
    """Read the name of a world, register, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.link_errors")
    parser.add_argument("world", help="as of tests.support.stop_networks")
    parser.add_argument("--only", default="", help="numbers of two stops: 0-1")
    parser.add_argument("--true-pointing", action="store_true")
    options = parser.parse_args()
    stops = stops_of_world(options.world)
    for k, two in enumerate(pairwise(stops)):
        if options.only in f"{k}-{k + 1}":
            folder = world_folder(options.world)
            some = [truly_pointed(s, folder) if options.true_pointing else pointed(s) for s in two]
            for line in link_errors(*some):
                print(f"{k}-{k + 1} {line}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
