"""Names of networks, written and read."""

import pytest

from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.tasks.scopes import is_of_mission, is_overall, network_scope, sol_of


@pytest.mark.parametrize("mode", AdjustmentMode)
@pytest.mark.parametrize("sol", [0, 156, 12345])
def test_a_networks_name_contains_its_mission_sol_and_mode(mode, sol):
    scope = network_scope("MER2", sol, mode)
    assert sol_of(scope) == sol
    assert is_overall(scope) == (mode is AdjustmentMode.OVERALL)
    assert is_of_mission(scope, "MER2")
    assert not is_of_mission(scope, "MER1")


def test_an_overall_adjustment_sorts_between_its_sol_and_the_next():
    names = [
        network_scope("MER2", 156, AdjustmentMode.STEPWISE).name,
        network_scope("MER2", 156, AdjustmentMode.OVERALL).name,
        network_scope("MER2", 157, AdjustmentMode.STEPWISE).name,
    ]
    assert names == sorted(names)
