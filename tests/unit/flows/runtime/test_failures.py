"""Results of tasks, put in order."""

from solmap.flows.runtime.failures import group_by_first


def test_results_are_listed_by_the_first_part_of_their_keys_in_their_order():
    results = {("b", "dtm"): 1, ("a", "dtm"): 2, ("b", "slope"): 3}
    assert group_by_first(results) == {"b": [1, 3], "a": [2]}
