"""What goes on after a failure and what does not; results of tasks, put in order."""

import pytest

from solmap.photogrammetry.errors import LabelError
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreFullError


@pytest.fixture
def workspace(tmp_path):
    return Workspace.open(tmp_path / "store")


def failed_outcomes(workspace):
    return {one.subject: one.notes for one in workspace.catalogue.outcomes() if one.is_failure}


def test_a_failing_block_is_one_line_and_one_outcome(workspace):
    from solmap.flows.runtime.failures import clear_failure, isolate  # noqa: PLC0415 - imports Prefect

    failures: list[str] = []
    with isolate("mer2", workspace, failures, "MER2: {}"):
        raise ValueError("two\nlines")
    assert failures == ["MER2: ValueError: two lines"]
    assert failed_outcomes(workspace) == {"mer2": ("ValueError: two lines",)}
    clear_failure("mer2", workspace)
    assert failed_outcomes(workspace) == {}


def test_failing_parts_are_named_and_the_block_continues(workspace):
    from solmap.flows.runtime.failures import isolate, keep_going  # noqa: PLC0415 - imports Prefect

    failures: list[str] = []
    done = []
    with isolate("mer2-layers", workspace, failures, "MER2: {}") as failed:
        with keep_going(failed, "traverse"):
            raise LabelError("no pose")
        done.append("stops")
    assert done == ["stops"]
    assert failures == ["MER2: traverse: LabelError: no pose"]
    assert failed_outcomes(workspace) == {"mer2-layers": ("traverse: LabelError: no pose",)}


@pytest.mark.parametrize("error", [StoreFullError("full"), KeyboardInterrupt(), SystemExit(1)])
def test_a_full_disk_and_signals_are_raised(workspace, error):
    from prefect.exceptions import TerminationSignal  # noqa: PLC0415 - slow to import

    from solmap.flows.runtime.failures import isolate, keep_going  # noqa: PLC0415

    for one in (error, TerminationSignal(15)):
        with (
            pytest.raises(type(one)),
            isolate("mer2", workspace, []),
            keep_going({}, "a part"),
        ):
            raise one


def test_an_outcome_that_cannot_be_stored_stops_nothing(workspace, monkeypatch):
    from solmap.flows.runtime.failures import clear_failure, isolate  # noqa: PLC0415 - imports Prefect

    def away(*_args, **_kwargs):
        raise OSError("away")

    monkeypatch.setattr(type(workspace.catalogue), "publish", away)
    monkeypatch.setattr(type(workspace.catalogue), "outcomes", away)
    failures: list[str] = []
    with isolate("mer2", workspace, failures):
        raise ValueError("x")
    clear_failure("mer2", workspace)
    assert failures == ["ValueError: x"]


def test_results_are_listed_by_the_first_part_of_their_keys_in_order():
    from solmap.flows.runtime.failures import group_by_first  # noqa: PLC0415 - imports Prefect

    results = {("b", "dtm"): 1, ("a", "dtm"): 2, ("b", "slope"): 3}
    assert group_by_first(results) == {"b": [1, 3], "a": [2]}
