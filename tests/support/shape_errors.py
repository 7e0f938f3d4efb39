"""Ties by the shape of the ground held against the truth.

    python -m tests.support.shape_errors husband plains11 hills12 crater13

puts the pairs of every two stops that follow each other where they truly stood and looked, moves
the later stop 5 cm across and 0.1 degrees, ties, and prints where the ties say that ground is seen
less where it truly is: across the view, in millimetres and in units of what is stated.
"""

import argparse
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.matching.cross_site.surface_alignment import SurfaceView
from solmap.photogrammetry.matching.cross_site.surface_matching import (
    SurfaceTieParams,
    tie_by_surface,
)
from solmap.photogrammetry.matching.records import Ties
from tests.support.husband_truth import true_pose
from tests.support.simulated_stops import ROOT, SimulatedStop
from tests.support.stop_networks import stops_of_world

ACROSS_M, AZIMUTH_DEG = 0.05, 0.1
HUSBAND = ROOT / ".cache" / "rendered_husband"


def true_views(stop: SimulatedStop, moved: Pose) -> dict[str, SurfaceView]:
    """The surfaces of a stop by pair, where its pairs truly looked but for a common motion."""
    views = {}
    for k, pair in enumerate(stop.matched.pairs):
        geometry = pair.images.geometry
        pose = moved @ true_lsl_from_label_rover(stop, k) @ geometry.rover_from_pair
        views[pair.pair_id] = SurfaceView.of(geometry, pair.parallax, pose, 5)
    return views


def true_lsl_from_label_rover(stop: SimulatedStop, pair: int) -> Pose:
    """Rover to LSL with the pointing error of the label in it."""
    if stop.world.terrain != "husband":
        world = stop.world.world()
        return world.true_lsl_from_label_rover(world.shot(stop.number, pair))
    name = stop.matched.pairs[pair].pair_id
    file = next(HUSBAND.glob(f"sol*/edr/{name.lower()}*"), None) or next(
        path for path in HUSBAND.glob("sol*/edr/*") if path.stem.upper() == name.upper()
    )
    return true_pose(HUSBAND, read_image(file.read_bytes(), file.name).image)


def tied(one: SimulatedStop, other: SimulatedStop) -> tuple[Ties, np.ndarray, np.ndarray]:
    """(ties, millimetres across that they are off, the same in units of what they state)."""
    way = other.true.translation_m - one.true.translation_m
    across = np.array([-way[1], way[0], 0.0]) / np.hypot(way[0], way[1])
    turn = Rotation.from_euler("z", np.radians(AZIMUTH_DEG)).as_matrix()
    about = other.true.translation_m
    rest = Pose.identity(LSL, LSL)
    off = Pose(LSL, LSL, turn, about - turn @ about + ACROSS_M * across)
    earlier, later = true_views(one, rest), true_views(other, rest)
    ties = tie_by_surface(earlier, true_views(other, off), SurfaceTieParams())
    error_px, per_px = np.empty(len(ties)), np.empty(len(ties))
    for k in range(len(ties)):
        source = earlier[ties.pair_ids[ties.first[k]]]
        target = later[ties.pair_ids[ties.second[k]]]
        place = source.place(ties.first_left[[k]], ties.first_parallax_px[[k]])
        seen = (place - target.centre) @ target.rotation
        error_px[k] = ties.second_left[k, 0] - target.geometry.project(seen)[0][0, 0]
        per_px[k] = 1000 * seen[0, 2] / target.geometry.focal_px
    return ties, error_px * per_px, error_px / ties.second_sigma_px


def main() -> None:
    """Read the names of worlds, tie, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.shape_errors")
    parser.add_argument("worlds", nargs="+", help="husband, or a terrain and a seed: plains11")
    for name in parser.parse_args().worlds:
        for one, other in pairwise(stops_of_world(name)):
            apart = np.linalg.norm(other.true.translation_m - one.true.translation_m)
            ties, off_mm, z = tied(one, other)
            line = f"{name} {one.number} - {other.number}, {apart:.1f} m: {len(ties)} ties"
            if len(ties):
                mean = np.average(off_mm, weights=ties.second_sigma_px**-2)
                line += (
                    f", off by {np.median(np.abs(off_mm)):.0f} mm (median), "
                    f"{mean:+.1f} mm all together; 68 and 95 % within "
                    f"{np.percentile(np.abs(z), 68):.1f}, {np.percentile(np.abs(z), 95):.1f} sigma"
                )
            print(line, flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
