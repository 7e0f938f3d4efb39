"""Findings of far ground are reported once per stop."""

from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_maps import FINDINGS, LACKING, _one_finding_a_stop
from solmap.photogrammetry.imagery import StopId


def test_pairs_without_far_ground_are_reported_in_one_line_per_stop():
    stop, other = StopId("MER2", 10, 64), StopId("MER2", 11, 0)
    failed = {
        (stop, "a-with-b"): "MatchingError: 1 points were found",
        (stop, "a-with-c"): "MatchingError: shows no ground far enough",
        (stop, "d-with-e"): "ValueError: shapes differ",
        (other, "f-with-g"): "MatchingError: 0 points were found",
    }
    requested = [*failed, (stop, "h-with-i")]
    report = SolReport("MER2", 156)
    report.add_findings("map", _one_finding_a_stop(failed, requested), LACKING, *FINDINGS)
    assert report.notes == [
        "no far ground, in 2 of 4 wide-baseline pairs of mer2-site0010-drive0064, the first: "
        "1 points were found",
        "no far ground, in 1 of 1 wide-baseline pairs of mer2-site0011-drive0000, the first: "
        "0 points were found",
    ]
    assert report.failures == ["map d-with-e: ValueError: shapes differ"]
