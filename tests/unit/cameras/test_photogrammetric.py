import numpy as np
import pytest

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.photogrammetric import photogrammetric


def test_the_parameters_equal_those_of_the_facts(test_vectors, cameras):
    for row in test_vectors["photogrammetric"]:
        found = photogrammetric(cameras[row["camera"]])
        samples, lines = test_vectors["cameras"][row["camera"]]["size"]
        # A of a label is a unit vector to six digits only, and is made one here.
        near = {"rtol": 2e-6, "atol": 2e-6}
        np.testing.assert_allclose(found.focal_px, [row["hs"], row["vs"]], **near)
        np.testing.assert_allclose(found.shear, row["shear_px_per_px"], **near)
        np.testing.assert_allclose(
            np.array(found.focal_px) * row["pixel_mm"],
            [row["focal_mm_from_hs"], row["focal_mm_from_vs"]],
            **near,
        )
        np.testing.assert_allclose(
            found.principal_point_mm(row["pixel_mm"], samples, lines),
            [row["x0_mm"], row["y0_mm"]],
            atol=2e-5,
        )
        np.testing.assert_allclose(found.photo_from_frame, row["M_rows_right_up_back"], **near)
        np.testing.assert_allclose(
            np.degrees(found.omega_phi_kappa),
            [row["omega_deg"], row["phi_deg"], row["kappa_deg"]],
            atol=2e-4,
        )
        np.testing.assert_allclose(found.calibration, row["K_affine"], rtol=2e-6, atol=2e-3)
        np.testing.assert_allclose(
            found.camera_from_frame, row["R_camera_from_frame_right_down_forward"], **near
        )


def test_conversion_to_photogrammetric_parameters_and_back_is_exact(cameras, rng):
    points = rng.uniform(-20, 20, (200, 3))
    for name, camera in cameras.items():
        perspective = Cahv(camera.c, camera.a, camera.h, camera.v)
        back = photogrammetric(perspective).cahv()
        # Rounding; points close to the plane of the camera have image points far away.
        np.testing.assert_allclose(
            back.project(points), perspective.project(points), rtol=1e-9, atol=1e-8, err_msg=name
        )


def test_omitting_the_shear_costs_a_third_of_a_pixel(cameras):
    """0.31 px at the edge of Spirit's left Navcam."""
    shear = photogrammetric(cameras["navcam_left_spirit_sol767"]).shear
    assert abs(shear) * 512 == pytest.approx(0.31, abs=0.005)


def test_the_rotation_is_orthonormal_to_rounding(cameras):
    for camera in cameras.values():
        rotation = photogrammetric(camera if isinstance(camera, Cahv) else camera.perspective)
        np.testing.assert_allclose(
            rotation.camera_from_frame @ rotation.camera_from_frame.T, np.eye(3), atol=1e-12
        )
        assert np.linalg.det(rotation.camera_from_frame) == pytest.approx(1.0)
