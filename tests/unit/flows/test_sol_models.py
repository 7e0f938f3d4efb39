"""What is said of models that could not be made."""

from flows.sol_inputs import SolReport
from flows.sol_models import _tell


def test_ground_too_far_for_a_model_is_a_finding_and_a_fault_is_a_failure():
    report = SolReport("MER2", 156)
    _tell(
        report,
        {
            "model of what pairs see of mer2-site0010-drive0089": "TerrainError: none of 2 views",
            "3D tiles of mer2-site0010-drive0089": "OSError: broken",
        },
    )
    assert report.notes == [
        "no model of what pairs see of mer2-site0010-drive0089: none of 2 views"
    ]
    assert report.failures == ["model 3D tiles of mer2-site0010-drive0089: OSError: broken"]
