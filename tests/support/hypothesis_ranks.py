"""How often each way finds where a stop stands: `python -m tests.support.hypothesis_ranks`.

For every two stops of a simulated world up to 50 m apart and those of `rendered_husband`, each way
of `find_hypotheses` is asked on its own. A hypothesis is right within 0.5 m and 1 degree of the
truth.
"""

import time
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from solmap.photogrammetry.matching.cross_site.birds_eye import PlaneFit
from solmap.photogrammetry.matching.cross_site.gate import search_gate
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.hypotheses.search import FINDERS, find_hypotheses
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams
from tests.support.husband_stops import HUSBAND, husband_stop
from tests.support.simulated_stops import ROOT, SimulatedStop
from tests.support.site_pairs import Views, positive_pairs, stops_of

RIGHT_M, RIGHT = 0.5, np.deg2rad(1.0)
CLASSES_M = (15.0, 25.0, 35.0, 50.0)
ALL = "together"


def rank(fits: Sequence[PlaneFit], one: SimulatedStop, other: SimulatedStop) -> int | None:
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


def asked(
    one: StopViews, other: StopViews, params: CrossSiteParams
) -> dict[str, tuple[list[PlaneFit], float]]:
    """What every way finds, and all together, each with its CPU seconds."""
    gate, _ = search_gate(one.stop, other.stop, params.gate)
    found = {}
    for way, find in FINDERS.items():
        started = time.process_time()
        fits = find(one, other, gate, params.birds_eye, params.hypotheses)
        found[way] = (fits, time.process_time() - started)
    started = time.process_time()
    best = find_hypotheses(one, other, gate, params.birds_eye, params.hypotheses)
    found[ALL] = ([h.fit for h in best], time.process_time() - started)
    return found


def main() -> None:
    """Ask all ways about all pairs, and print how often they are right at once and among three."""
    params = CrossSiteParams()
    views = Views(params)
    husband = [husband_stop(ROOT / ".cache" / "rendered_husband", k) for k in range(3)]
    every = [(HUSBAND.terrain, husband[a], husband[b]) for a, b in ((0, 1), (1, 2), (0, 2))]
    rows: dict[tuple[str, float, str], list[tuple[int | None, float]]] = defaultdict(list)
    for name, one, other in every + [("simulated", *stops_of(p)) for p in positive_pairs()]:
        apart_m = np.hypot(*(other.true.translation_m - one.true.translation_m)[:2])
        limit_m = CLASSES_M[int(np.searchsorted(CLASSES_M, apart_m))]
        first, second = views.of(one.matched), views.of(other.matched)
        for way, (fits, seconds) in asked(first, second, params).items():
            place = rank(fits, one, other)
            rows[name, limit_m, way].append((place, seconds))
            print(one.stop, other.stop, f"{apart_m:.0f} m", way, place, flush=True)  # noqa: T201
    for (name, limit_m, way), ranks in sorted(rows.items()):
        first_of = sum(place == 0 for place, _ in ranks)
        third_of = sum(place is not None and place < 3 for place, _ in ranks)
        seconds = np.mean([s for _, s in ranks])
        print(  # noqa: T201 - a table is what this makes
            f"{name:9} to {limit_m:2.0f} m {way:11}: first {first_of}, among three {third_of} "
            f"of {len(ranks)}, {seconds:.1f} s"
        )


if __name__ == "__main__":
    main()
