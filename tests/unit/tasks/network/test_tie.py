"""How links of one stop share its preparation."""

from concurrent.futures import ThreadPoolExecutor
from time import sleep

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeView
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams
from solmap.photogrammetry.matching.cross_site.links import refused_link
from solmap.photogrammetry.matching.records import MatchedStop
from solmap.products.model import ProductKind, ProductRef, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore

STOPS = tuple(StopId("MER2", 1, drive) for drive in (0, 10, 20))
TELEMETRY = {
    stop: StopPrior(stop, Pose(LSL, stop.frame, np.eye(3), np.array([float(stop.drive), 0.0, 0.0])))
    for stop in STOPS
}
EMPTY = np.full((4, 4), np.nan, np.float32)


@pytest.fixture
def tie():
    from solmap.tasks.network import tie  # noqa: PLC0415 - imports Prefect

    tie.clear_prepared()
    yield tie
    tie.clear_prepared()


@pytest.fixture
def prepared(tie, monkeypatch):
    """The stops in the order in which they were prepared."""
    order = []

    def read(stop, telemetry, _params, _store):
        return MatchedStop(stop.stop, (), telemetry.lsl_from_rover, np.zeros((6, 6)))

    def prepare(stop, _params):
        order.append(stop.stop)
        sleep(0.05)  # so that another link needs it meanwhile
        return StopViews(stop, BirdsEyeView(0.16, EMPTY, EMPTY), ())

    monkeypatch.setattr(tie, "_read_pointed", read)
    monkeypatch.setattr(tie, "prepare_stop", prepare)
    monkeypatch.setattr(tie, "tie_cross_site", lambda *two: refused_link(*two[:2], ""))
    return order


def link(tie, store, earlier, later, digest="0" * 16):
    def products(stop):
        ties = ProductRef(ProductKind.TIES, Scope(ScopeLevel.STOP, str(stop)), digest)
        return tie.StopProducts(stop, (), ties=ties)

    telemetry = TELEMETRY[earlier], TELEMETRY[later]
    return tie.link_stops.fn(
        products(earlier), products(later), *telemetry, CrossSiteParams(), store
    )


def test_a_stop_is_prepared_once_for_links_at_the_same_time(tie, prepared, tmp_path):
    store = ProductStore.open(tmp_path)
    with ThreadPoolExecutor(2) as threads:
        made = threads.map(lambda old: link(tie, store, old, STOPS[2]), STOPS[:2])
    assert len(set(made)) == 2
    assert sorted(prepared) == sorted(STOPS)


def test_a_stop_prepared_ahead_is_used_by_its_link(tie, prepared, tmp_path):
    store = ProductStore.open(tmp_path)
    ties = ProductRef(ProductKind.TIES, Scope(ScopeLevel.STOP, str(STOPS[0])), "0" * 16)
    ahead = tie.StopProducts(STOPS[0], (), ties=ties)
    tie.prepare_to_link(ahead, TELEMETRY[STOPS[0]], CrossSiteParams(), store)
    link(tie, store, STOPS[0], STOPS[1])
    assert prepared == [STOPS[0], STOPS[1]]


def test_other_ties_prepare_a_stop_again(tie, prepared, tmp_path):
    store = ProductStore.open(tmp_path)
    link(tie, store, STOPS[0], STOPS[1])
    link(tie, store, STOPS[0], STOPS[1], digest="1" * 16)
    assert prepared == [STOPS[0], STOPS[1]] * 2


def test_stops_that_are_cleared_are_prepared_again(tie, prepared, tmp_path):
    store = ProductStore.open(tmp_path)
    link(tie, store, STOPS[0], STOPS[2])
    tie.clear_prepared()
    link(tie, store, STOPS[1], STOPS[2])
    assert prepared == [STOPS[0], STOPS[2], STOPS[1], STOPS[2]]
