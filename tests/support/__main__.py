"""Link all site pairs and print the table: `python -m tests.support`."""

import argparse
import dataclasses
import json
import time
from functools import lru_cache
from pathlib import Path

from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams, tie_cross_site
from solmap.photogrammetry.matching.cross_site.links import LinkTestParams
from tests.support.rendered_stops import HUSBAND, rendered_stop
from tests.support.simulated_stops import ROOT, SimulatedStop
from tests.support.site_pairs import (
    FIRST_SEED,
    HEADING,
    Outcome,
    SitePair,
    Views,
    evaluated,
    matched_stops,
    negative_pairs,
    pointed,
    positive_pairs,
    stops_of,
    totals,
    worlds_from,
)


def linked(pair: SitePair, stops: tuple[SimulatedStop, SimulatedStop], views: Views) -> Outcome:
    """Link one pair and evaluate it."""
    one, other = matched_stops(pair, *stops)
    first, second = views.of(one), views.of(other)
    started = time.process_time()
    link = tie_cross_site(first, second, views.params)
    return evaluated(pair, *stops, link, time.process_time() - started)


def main() -> None:
    """Read the arguments, link, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.support", description=__doc__)
    parser.add_argument("--only", default="", help="part of the pair's name")
    parser.add_argument("--kind", choices=["all", "shared", "foreign", "husband"], default="all")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="of the six worlds")
    parser.add_argument(
        "--json", type=Path, help="file to which outcomes are appended, one line each"
    )
    parser.add_argument(
        "--least-z",
        type=float,
        default=LinkTestParams().least_z,
        help="0 tries every pair in images",
    )
    arguments = parser.parse_args()
    views = Views(CrossSiteParams(link_test=LinkTestParams(least_z=arguments.least_z)))
    worlds = worlds_from(arguments.first_seed)
    pairs: list[SitePair] = []
    if arguments.kind in {"all", "shared"}:
        pairs += positive_pairs(worlds)
    if arguments.kind in {"all", "foreign"}:
        pairs += negative_pairs(worlds)
    if arguments.kind in {"all", "husband"}:
        pairs += [SitePair((HUSBAND, a), (HUSBAND, b)) for a, b in ((0, 1), (1, 2), (0, 2))]
    outcomes = []
    print(HEADING)  # noqa: T201 - prints a table
    for pair in pairs:
        if arguments.only not in pair.name:
            continue
        outcome = linked(pair, _stops(pair), views)
        outcomes.append(outcome)
        print(outcome, flush=True)  # noqa: T201
        if arguments.json:
            with arguments.json.open("a") as file:
                file.write(json.dumps(dataclasses.asdict(outcome)) + "\n")
    print("\n".join(totals(outcomes)))  # noqa: T201


@lru_cache(maxsize=3)
def _husband(number: int) -> SimulatedStop:
    return pointed(rendered_stop(ROOT / ".cache" / "rendered_husband", number))


def _stops(pair: SitePair) -> tuple[SimulatedStop, SimulatedStop]:
    if pair.earlier[0] != HUSBAND:
        return stops_of(pair)
    return _husband(pair.earlier[1]), _husband(pair.later[1])


if __name__ == "__main__":
    main()
