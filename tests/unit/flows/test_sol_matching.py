"""Which stop is prepared for its link while a new one is tied."""

from types import SimpleNamespace

import numpy as np
import pytest

from solmap.config.pipeline import load_pipeline
from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId

STOPS = tuple(StopId("MER2", 1, drive) for drive in (0, 10, 20, 30))
NORTHS = (0.0, 15.0, 30.0, 45.0)
TELEMETRY = tuple(
    StopPrior(stop, Pose(LSL, stop.frame, np.eye(3), np.array([north, 0.0, 0.0])))
    for stop, north in zip(STOPS, NORTHS, strict=True)
)


@pytest.fixture
def prepared(monkeypatch):
    """The stops that were prepared; ties of all but the new one exist."""
    from solmap.flows import sol_matching  # noqa: PLC0415 - imports Prefect
    from solmap.tasks.stage import LookedUp  # noqa: PLC0415

    order = []

    def tie(stop, *_, **__):
        return LookedUp(None) if stop.stop != STOPS[3] else SimpleNamespace()

    monkeypatch.setattr(sol_matching, "tie_stop", SimpleNamespace(submit=tie))

    def note(stop, *_):
        order.append(stop.stop)

    monkeypatch.setattr(sol_matching, "prepare_to_link", note)
    return order


def prepare(new=(STOPS[3],), touched=(STOPS[3],)):
    from solmap.flows import sol_matching  # noqa: PLC0415 - imports Prefect

    inputs = SimpleNamespace(
        config=load_pipeline("default"),
        workspace=SimpleNamespace(store=None),
        telemetry=SimpleNamespace(stops=TELEMETRY),
        window=TELEMETRY,
        new_stops=new,
        touched=touched,
    )
    pairs = {stop: [SimpleNamespace()] for stop in STOPS}
    sol_matching._prepare_link(pairs, inputs)


def test_the_nearest_earlier_stop_is_prepared(prepared):
    prepare()
    assert prepared == [STOPS[2]]


def test_a_sol_without_new_stops_prepares_none(prepared):
    prepare(new=())
    assert prepared == []


def test_stops_with_new_images_are_not_prepared_early(prepared):
    prepare(touched=STOPS[2:])
    assert prepared == [STOPS[1]]


def test_workers_of_a_cluster_prepare_nothing_for_each_other(prepared, monkeypatch):
    monkeypatch.setenv("SOLMAP_TASK_RUNNER", "dask")
    prepare()
    assert prepared == []
