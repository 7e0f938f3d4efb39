"""Which stops are tied by the merged ground of several, and what such links are made from."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from solmap.config.pipeline import load_pipeline
from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.products.model import ProductKind, ProductRef, Scope, ScopeLevel

STOPS = tuple(StopId("MER2", 1, drive) for drive in (0, 10, 20, 30))
NORTHS = (0.0, 6.0, 12.0, 48.0)
TELEMETRY = {
    stop: StopPrior(stop, Pose(LSL, stop.frame, np.eye(3), np.array([north, 0.0, 0.0])))
    for stop, north in zip(STOPS, NORTHS, strict=True)
}
NEXT = {
    (one, other): TELEMETRY[one].lsl_from_rover.inverse @ TELEMETRY[other].lsl_from_rover
    for one, other in pairwise(STOPS[:3])
}


def ties_of(stop):
    return ProductRef(ProductKind.TIES, Scope(ScopeLevel.STOP, str(stop)), f"{stop.drive:016x}")


def products():
    from solmap.tasks.network.tie import StopProducts  # noqa: PLC0415 - imports Prefect

    return {stop: StopProducts(stop, (), ties=ties_of(stop)) for stop in STOPS}


def inputs(*window):
    everything = tuple(TELEMETRY.values())
    return SimpleNamespace(
        config=load_pipeline("default"),
        telemetry=SimpleNamespace(stops=everything),
        window=tuple(TELEMETRY[stop] for stop in window) or everything,
    )


def parts_at(new, poses, at):
    from solmap.flows import sol_network  # noqa: PLC0415 - imports Prefect

    return sol_network.parts_at(TELEMETRY[new], at, products(), poses)


def test_an_unlinked_stop_is_tied_to_the_ground_of_all_linked_stops_in_reach():
    ((earlier, later),) = parts_at(STOPS[3], NEXT, inputs())
    assert (earlier.stop, later.stop) == (STOPS[2], STOPS[3])
    assert [other.stop for other, _ in earlier.beside] == [STOPS[1], STOPS[0]]
    assert [place.translation_m[0] for _, place in earlier.beside] == [-6.0, -12.0]
    assert later.beside == ()


def test_linked_stops_are_not_tied_again():
    assert parts_at(STOPS[2], NEXT, inputs()) == []


def test_a_window_that_lacks_tried_stops_ties_nothing_again():
    assert parts_at(STOPS[3], NEXT, inputs(*STOPS[2:])) == []


@pytest.mark.parametrize("change", ["ground", "place"])
def test_links_of_merged_ground_are_made_from_all_of_it(change):
    from solmap.tasks.network.tie import links_recipe  # noqa: PLC0415 - imports Prefect

    params = inputs().config.cross_site
    ((earlier, later),) = parts_at(STOPS[3], NEXT, inputs())
    reported = TELEMETRY[earlier.stop], TELEMETRY[later.stop]
    merged = links_recipe(earlier, later, *reported, params)
    assert {ties_of(stop) for stop in STOPS} == set(merged.inputs)
    (first, place), second = earlier.beside
    other = {
        "ground": ((first, place),),
        "place": ((first, replace(place, translation_m=(-6.5, 0.0, 0.0))), second),
    }[change]
    changed = links_recipe(replace(earlier, beside=other), later, *reported, params)
    assert changed.ref != merged.ref
