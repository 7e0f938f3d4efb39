"""How often the search finds where a stop stands.

    python -m tests.support.hypothesis_ranks [--only crater]

Every two stops of a simulated world up to 50 m apart and those of `rendered_husband` are searched
with telemetry off by 10, 30 and 100 % of the way, under the suns of their worlds and with the later
stop's grey values negated: worse than the opposite sun, for what is dark in itself turns as well. A
hypothesis is right within 0.5 m and 1 degree of the truth. Then come pairs of stops of different
worlds, with no ground in common: what peaks chance comes to.
"""

import argparse
import time
from collections import defaultdict
from dataclasses import replace
from functools import cache

import numpy as np

from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    BirdsEyeView,
    PlaneFit,
    draw_birds_eye,
)
from solmap.photogrammetry.matching.cross_site.gate import search_stages
from solmap.photogrammetry.matching.cross_site.hypotheses.search import (
    Hypotheses,
    find_hypotheses,
)
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams
from solmap.photogrammetry.matching.records import MatchedStop
from tests.support.rendered_stops import HUSBAND, rendered_stop
from tests.support.simulated_stops import ROOT, SimulatedStop, WorldOfStops, simulated_stop
from tests.support.site_pairs import SitePair, matched_stops, negative_pairs, positive_pairs

RIGHT_M, RIGHT = 0.5, np.deg2rad(1.0)
CLASSES_M = (15.0, 25.0, 35.0, 40.0, 50.0)
SLIPS = (0.1, 0.3, 1.0)
PARAMS = CrossSiteParams()


@cache
def drawn(which: WorldOfStops, number: int) -> tuple[SimulatedStop, BirdsEyeView]:
    """A stop without its pairs, and its view from above."""
    if which == HUSBAND:
        stop = rendered_stop(ROOT / ".cache" / "rendered_husband", number)
    else:
        stop = simulated_stop(which, number)
    (view,) = draw_birds_eye(stop.matched, PARAMS.birds_eye, (PARAMS.birds_eye.cell_m,))
    return replace(stop, matched=replace(stop.matched, pairs=())), view


def slipped(one: SimulatedStop, other: SimulatedStop, slip: float, way: float) -> MatchedStop:
    """The later stop by telemetry with an error of a share of the way, to some side."""
    reported = other.matched.lsl_from_rover
    here = one.matched.lsl_from_rover
    true = here.translation_m + here.rotation @ (one.true.inverse @ other.true).translation_m
    off_m = slip * float(np.hypot(*(true - here.translation_m)[:2]))
    off = off_m * np.array([np.cos(way), np.sin(way), 0.0])
    return other.reported_at(Pose(reported.target, reported.source, reported.rotation, true + off))


def rank(fits: list[PlaneFit], one: SimulatedStop, other: SimulatedStop) -> int | None:
    """Which of some fits is the first that is right."""
    level, later = (s.matched.lsl_from_rover.rotation for s in (one, other))
    true = one.true.inverse @ other.true
    place, turn = level @ true.translation_m, level @ true.rotation @ later.T
    azimuth = np.arctan2(turn[1, 0], turn[0, 0])
    for k, fit in enumerate(fits):
        off = np.hypot(fit.north_m - place[0], fit.east_m - place[1])
        if off < RIGHT_M and abs(fit.azimuth - azimuth) < RIGHT:
            return k
    return None


def searched(
    one: MatchedStop, other: MatchedStop, views: tuple[BirdsEyeView, BirdsEyeView]
) -> tuple[Hypotheses, float]:
    """What is found, and the CPU seconds it took."""
    started = time.process_time()
    stages = search_stages(one, other, PARAMS.gate, PARAMS.birds_eye.radius_m)
    found = find_hypotheses(*views, stages, PARAMS.birds_eye, PARAMS.link_test.least_z)
    return found, time.process_time() - started


def main() -> None:
    """Search all pairs, and print how often the first and one of those tried are right."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.hypothesis_ranks")
    parser.add_argument("--only", default="", help="part of the pair's name")
    only = parser.parse_args().only
    husband = [SitePair((HUSBAND, a), (HUSBAND, b)) for a, b in ((0, 1), (1, 2), (0, 2))]
    shared = [pair for pair in (*husband, *positive_pairs()) if only in pair.name]
    rows: dict[tuple[str, float, float], list[tuple[int | None, float, float]]] = defaultdict(list)
    for n, pair in enumerate(shared):
        (one, first), (other, second) = drawn(*pair.earlier), drawn(*pair.later)
        apart_m = float(np.hypot(*(other.true.translation_m - one.true.translation_m)[:2]))
        limit_m = CLASSES_M[int(np.searchsorted(CLASSES_M, apart_m))]
        for light, later in (("own", second), ("negated", replace(second, grey=-second.grey))):
            for k, slip in enumerate(SLIPS):
                reported = slipped(one, other, slip, 2.4 * (3 * n + k))  # the golden angle
                found, seconds = searched(one.matched, reported, (first, later))
                place = rank(found.fits, one, other)
                rows[light, slip, limit_m].append((place, found.highest, seconds))
                print(pair.name, f"{apart_m:.0f} m", light, slip, place, f"{found.highest:.1f}")  # noqa: T201
    for (light, slip, limit_m), ranks in sorted(rows.items()):
        first_of = sum(place == 0 for place, _, _ in ranks)
        tried_of = sum(place is not None for place, _, _ in ranks)
        print(  # noqa: T201 - a table is what this makes
            f"{light:7} slip {slip:4.0%} to {limit_m:2.0f} m: first {first_of}, tried {tried_of} "
            f"of {len(ranks)}, z from {min(z for _, z, _ in ranks):.1f}, "
            f"{np.mean([s for _, _, s in ranks]):.1f} s"
        )
    chance = []
    for pair in (pair for pair in negative_pairs() if only in pair.name):
        (one, first), (other, second) = drawn(*pair.earlier), drawn(*pair.later)
        found, _ = searched(*matched_stops(pair, one, other), (first, second))
        chance.append(found.highest)
    print(f"foreign: {len(chance)} pairs, z at most {max(chance, default=0.0):.1f}")  # noqa: T201


if __name__ == "__main__":
    main()
