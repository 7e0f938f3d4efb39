import numpy as np
import pytest

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.epipolar import single_image
from solmap.photogrammetry.frames import Frame, FrameKind, rover_frame

ROVER, OWN = rover_frame(1, 0), Frame(FrameKind.PAIR, (1,))


@pytest.fixture
def camera():
    """Looks north and 20 degrees down from the mast, rows level."""
    down = np.radians(20)
    a = np.array([np.cos(down), 0.0, np.sin(down)])
    right, below = np.array([0.0, 1.0, 0.0]), np.array([-np.sin(down), 0.0, np.cos(down)])
    return Cahv(np.array([0.4, 0.1, -1.2]), a, 500 * right + 255.5 * a, 500 * below + 255.5 * a)


def test_a_camera_without_distortion_keeps_its_image(camera):
    geometry = single_image(camera, (512, 512), ROVER, OWN)
    left, _ = geometry.cameras()
    points = np.array([[0.0, 0.0], [511.0, 100.0], [255.5, 255.5]])
    ground = camera.centre + 3.0 * camera.rays(points)
    np.testing.assert_allclose(left.project(ground), camera.project(ground), atol=1e-2)
    assert (geometry.samples, geometry.lines) == (512, 512)
    assert geometry.focal_px == pytest.approx(500, rel=1e-4)


def test_the_camera_has_the_position_of_its_label(camera):
    geometry = single_image(camera, (512, 512), ROVER, OWN)
    np.testing.assert_allclose(geometry.rover_from_pair.translation_m, camera.centre)
    np.testing.assert_allclose(geometry.rover_from_pair.rotation[:, 2], camera.a, atol=1e-6)


def test_the_linearised_image_covers_the_whole_real_frame(shared_data):
    from solmap.photogrammetry.archive.images.reading import read_image  # noqa: PLC0415

    path = shared_data / "mer_spirit_sol1869_troy" / "2n292280938effb100p0703l0m1.img"
    image = read_image(path.read_bytes(), path.name).image
    geometry = single_image(image.camera, (image.samples, image.lines), image.stop.frame, OWN)
    corners = np.array([[0.0, 0.0], [1023.0, 0.0], [0.0, 1023.0], [1023.0, 1023.0]])
    ground = image.camera.centre + 5.0 * image.camera.rays(corners)
    left, _ = geometry.cameras()
    seen = left.project(ground)
    assert (seen > -0.6).all()
    assert (seen < np.array([geometry.samples, geometry.lines]) - 0.4).all()
