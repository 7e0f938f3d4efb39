"""What is said of far ground that could not be mapped."""

from flows.sol_inputs import SolReport
from flows.sol_wide import _tell


def test_light_that_was_not_alike_is_a_finding_and_a_fault_is_a_failure():
    report = SolReport("MER2", 156)
    _tell(
        report,
        {
            "a-with-b": "MatchingError: 3 points of the wide pair were found in both images",
            "elevation of mer2-site0010-drive0089": "TerrainError: none of the 1 views has any",
            "c-with-d": "ValueError: shapes differ",
            "contours of mer2-site0010-drive0089": "",  # waited for what failed
        },
    )
    assert report.notes == [
        "no far ground, a-with-b: 3 points of the wide pair were found in both images",
        "no far ground, elevation of mer2-site0010-drive0089: none of the 1 views has any",
    ]
    assert report.failures == ["map far ground c-with-d: ValueError: shapes differ"]
