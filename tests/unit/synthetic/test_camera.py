"""What cameras do to light, and what the rover covers."""

import numpy as np
import pytest

from solmap.photogrammetry.errors import PixelError
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.synthetic.body import PANEL_TOP_M, body_radiance, entered
from solmap.photogrammetry.synthetic.camera import (
    SHARPEST_PX,
    CameraParams,
    compress,
    expose,
    transmission,
)
from solmap.photogrammetry.synthetic.lattice import Window
from solmap.photogrammetry.synthetic.lighting import Sun, _beside_shadow
from solmap.photogrammetry.synthetic.render import _spread
from solmap.photogrammetry.synthetic.rig import GROUND_M
from solmap.photogrammetry.synthetic.terrain import Patch

MAST = np.array([0.46, 0.03, -1.25])


@pytest.fixture(scope="module")
def textured():
    noise = np.random.default_rng(3).standard_normal((256, 256)).cumsum(0).cumsum(1)
    signal = 1800 + 400 * noise / noise.std()
    return expose(
        signal.astype(np.float32), np.ones_like(signal, np.float32), 1, np.random.default_rng(4)
    )


def test_a_perfect_camera_transmits_all_light():
    np.testing.assert_array_equal(transmission(CameraParams(), 64, 1), np.ones((64, 64)))


def test_vignetting_equals_the_flat_fields_of_curiosity(shared_data):
    import cv2  # noqa: PLC0415 - of this check alone

    flats = [
        cv2.imread(str(shared_data / "msl_navcam_flats" / name), cv2.IMREAD_UNCHANGED)
        for name in ("MSL_NLB_FLAT_V1.png", "MSL_NRB_FLAT_V1.png")
    ]
    mean = sum(flat / np.percentile(flat, 99.9) for flat in flats) / 2
    real = cv2.resize(cv2.GaussianBlur(mean, (0, 0), 8), (64, 64), interpolation=cv2.INTER_AREA)
    ours = transmission(CameraParams(vignetting=1.0), 64, 1)
    row, column = np.mgrid[:64, :64]
    apart = np.hypot(row - 31.5, column - 31.5) / 31.5
    for radius in (0.1, 0.4, 0.7, 1.0, 1.25):
        ring = np.abs(apart - radius) < 0.05
        assert ours[ring].mean() == pytest.approx(np.median(real[ring]), abs=0.04)


def test_dust_on_a_camera_has_a_fixed_place():
    dusty = CameraParams(dust_specks=20)
    one, again, other = (transmission(dusty, 128, *name) for name in ((7, 0), (7, 0), (7, 1)))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    assert 0.6 < one.min() < 0.97
    assert np.median(one) > 0.98


@pytest.mark.parametrize("psf_px", [SHARPEST_PX, 0.5, 0.7, 0.9])
def test_a_point_is_blurred_to_the_requested_width(psf_px):
    point = np.zeros((41, 41), np.float32)
    point[20, 20] = 1
    spread = _spread(point, psf_px).sum(axis=0)
    elements = np.arange(41) - 20
    variance = (elements**2 * spread).sum() + 1 / 12 + 1 / 6  # the element's width and sampling
    assert np.sqrt(variance) / 2 == pytest.approx(psf_px, abs=0.005)


def test_fewer_bits_lose_more(textured):
    rms = [np.std(compress(textured, bits) - textured) for bits in (0.6, 1.0, 3.0)]
    assert rms[0] > rms[1] > rms[2] > 0.5
    assert rms[2] < 6  # noise alone has 6.6


def test_impossible_cameras_are_refused():
    with pytest.raises(PixelError, match=r"psf_px must be at least 0\.43"):
        CameraParams(psf_px=0.2)


def test_rays_enter_the_rover_by_the_side_that_they_meet_first():
    down_on_panel = np.array([[-0.86, 0.77, 0.944]], np.float32)
    length = np.linalg.norm(down_on_panel)
    distance, normal = entered(MAST, down_on_panel / length)
    assert distance[0] == pytest.approx(length, rel=1e-5)
    np.testing.assert_array_equal(normal, [[0, 0, -1]])
    turned = np.deg2rad(np.arange(0, 360, 5))
    level = np.column_stack([np.cos(turned), np.sin(turned), 0 * turned]).astype(np.float32)
    for camera in MAST + 0.1 * level:  # wherever its bar turns it: the bar is never in view
        assert np.isinf(entered(camera, level)[0]).all()


def test_panels_in_the_shadow_of_the_mast_are_lit_by_the_sky_only():
    sun = np.array([0.5, 0.0, -np.sqrt(0.75)])
    behind_mast = np.array([[-0.1, 0.031, PANEL_TOP_M], [-0.1, 0.6, PANEL_TOP_M]], np.float32)
    up = np.tile(np.float32([0, 0, -1]), (2, 1))
    shaded, lit = body_radiance(behind_mast, up, sun, 0.2)
    assert shaded < 0.35 * lit


def test_the_shadow_of_the_rover_is_opposite_the_sun():
    window = Window(0, -200, -200, 401, 401)
    level = np.full((401, 401), -GROUND_M, np.float32)
    patch = Patch(window, level, np.ones_like(level))
    rover = Pose(LSL, StopId("MER2", 1, 0).frame, np.eye(3), np.zeros(3))
    beside = _beside_shadow(patch, Sun(np.deg2rad(90), np.deg2rad(30)), rover)
    north, east = np.meshgrid(window.north, window.east, indexing="ij")
    shaded = beside == 0
    assert shaded[np.hypot(north, east + 0.5) < 0.3].all()
    assert east[shaded].min() == pytest.approx(-0.15 - 1.614 * np.sqrt(3), abs=0.05)  # the bar's
    assert np.abs(north[shaded]).max() < 1.0
    assert not shaded[east > 0.2].any()
