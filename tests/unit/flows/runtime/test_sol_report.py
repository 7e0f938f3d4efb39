"""How a sol's report distinguishes findings from faults."""

from solmap.flows.runtime.sol_report import SolReport
from solmap.photogrammetry.errors import MatchingError, TerrainError


def test_an_undetermined_quantity_is_a_finding_and_a_fault_is_a_failure():
    report = SolReport("MER2", 156)
    report.add_findings(
        "map far ground",
        {
            "a-with-b": "MatchingError: 3 points of the wide pair were found in both images",
            "elevation of mer2-site0010-drive0089": "TerrainError: none of the 1 views has any",
            "c-with-d": "ValueError: shapes differ",
            "contours of mer2-site0010-drive0089": "",  # waited for what failed
        },
        "no far ground,",
        MatchingError,
        TerrainError,
    )
    assert report.notes == [
        "no far ground, a-with-b: 3 points of the wide pair were found in both images",
        "no far ground, elevation of mer2-site0010-drive0089: none of the 1 views has any",
    ]
    assert report.failures == ["map far ground c-with-d: ValueError: shapes differ"]


def test_an_unexpected_error_is_a_fault():
    report = SolReport("MER2", 156)
    failed = {"views of a": "TerrainError: none of 2 views", "3D tiles of a": "OSError: broken"}
    report.add_findings("model", failed, "no", TerrainError)
    assert report.notes == ["no views of a: none of 2 views"]
    assert report.failures == ["model 3D tiles of a: OSError: broken"]
