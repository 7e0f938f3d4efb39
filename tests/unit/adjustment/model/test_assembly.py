"""A network cut by its stops is the same when it is put together again."""

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.assembly import assemble, part_at
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.adjustment.modes.mission import advance
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.quality.weaknesses import shared_ties
from solmap.photogrammetry.synthetic.networks import simulate_network


@pytest.fixture(scope="module")
def mission():
    return simulate_network(
        np.random.default_rng(4), stops=9, pairs_per_stop=4, cross_ties=12, far_cross_ties=5,
        inter_ties=10, intra_ties=8, blunders=0.05,
    )[0]  # fmt: skip


@pytest.fixture
def adjusted(mission, params):
    return adjust_overall(mission, params)[0]


def by_measurement(ties):
    """What is known of every observation and its point, in an order of their own."""
    seen = ties.observations
    names = np.array(seen.pair_ids)[seen.pair]
    order = np.lexsort((seen.left[:, 1], seen.left[:, 0], names))
    numbers = np.column_stack([
        seen.left, seen.parallax_px, ties.status, ties.residuals_px, ties.standardised,
        ties.redundancy, ties.points[seen.point], ties.covariances[seen.point].reshape(-1, 9),
    ])[order]  # fmt: skip
    return names[order], numbers, [ties.kinds[k] for k in seen.point[order]]


def test_parts_assembled_stop_by_stop_equal_the_whole_network(adjusted):
    parts = [part_at(adjusted, {stop.stop}) for stop in adjusted.stops]
    again = assemble(parts)
    assert again.stops == adjusted.stops
    assert again.pairs == adjusted.pairs
    for old, new in zip(by_measurement(adjusted.ties), by_measurement(again.ties), strict=True):
        np.testing.assert_array_equal(old, new)
    assert shared_ties(again) == shared_ties(adjusted)


def test_a_part_has_the_ties_of_its_stops_and_those_shared_with_others(adjusted):
    fifth = adjusted.stops[4].stop
    part = part_at(adjusted, {fifth})
    own = {pair.pair_id for pair in part.pairs}
    assert {pair.stop for pair in part.pairs} == {fifth}
    seen = part.ties.observations
    assert set(seen.pair_ids) > own
    for point in range(len(part.ties.points)):
        assert own & {seen.pair_ids[k] for k in seen.pair[seen.point == point]}


def test_a_stop_is_taken_from_the_last_part_that_contains_it(adjusted):
    moved = part_at(adjusted, {stop.stop for stop in adjusted.stops[:2]})
    with_fewer_pairs = part_at(adjusted, {adjusted.stops[1].stop})
    kept = with_fewer_pairs.pairs[:1]
    late = type(moved)(with_fewer_pairs.stops, kept, with_fewer_pairs.ties)
    again = assemble([moved, late])
    assert [stop.stop for stop in again.stops] == [stop.stop for stop in adjusted.stops[:2]]
    assert [pair for pair in again.pairs if pair.stop == adjusted.stops[1].stop] == list(kept)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("mode", [AdjustmentMode.SEQUENTIAL, AdjustmentMode.STEPWISE])
def test_steps_from_a_part_equal_those_from_the_whole(mission, params, mode):
    """All that a step needs of the stops before is the part that it touches."""
    names = mission.stop_ids
    whole = part = None
    for k, new in enumerate(names):
        window = set(names[max(0, k - 6) : k + 1])
        network = mission.within(set(names[: k + 1]))
        near = type(network)(
            network.stops, mission.within(window).pairs, mission.within(window).ties
        )
        whole, _ = advance(mode, whole, near, {new}, params)
        start = part_at(part, window) if part else None
        part, _ = advance(mode, start, near, {new}, params)
        part = part_at(part, window)
    for stop in part.stops:
        same = whole.stop(stop.stop)
        np.testing.assert_array_equal(
            stop.lsl_from_rover.translation_m, same.lsl_from_rover.translation_m
        )
        np.testing.assert_array_equal(stop.covariance, same.covariance)
    assert len(part.stops) < len(whole.stops)


def test_ties_to_stops_outside_a_part_do_not_reopen_the_traverse(params):
    """A loop cannot be closed with the pairs of a part: stops that are elsewhere would be lost."""
    loop, _ = simulate_network(
        np.random.default_rng(5), stops=10, pairs_per_stop=4, cross_ties=12, far_cross_ties=0,
        inter_ties=10, intra_ties=8, loop=True,
    )  # fmt: skip
    names = loop.stop_ids
    part = None
    for k, new in enumerate(names):
        window = {*names[max(0, k - 6) : k + 1]} | ({names[0]} if k == len(names) - 1 else set())
        network = loop.within(set(names[: k + 1]))
        near = type(network)(network.stops, loop.within(window).pairs, loop.within(window).ties)
        start = part_at(part, window) if part else None
        part, report = advance(AdjustmentMode.SEQUENTIAL, start, near, {new}, params)
    assert "ties reach back beyond the window and were left out" in report.message
    assert not report.name.startswith("re-opened")
