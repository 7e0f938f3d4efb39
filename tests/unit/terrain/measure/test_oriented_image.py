import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.measure.oriented_image import (
    Ellipse,
    OrientedImage,
    StopPose,
    cross_matrix,
    epipolar_curve,
    image_covariance,
    image_covariance_from,
    partials,
    relative_covariance,
)

FOCAL_PX = 1200.0
CENTRE_PX = 511.5


def camera(centre=(0.0, 0.0, -1.5), azimuth_deg=0.0, dip_deg=10.0) -> Cahv:
    """A Navcam at (north, east, down)."""
    a, d = np.radians([azimuth_deg, dip_deg])
    forward = np.array([np.cos(a) * np.cos(d), np.sin(a) * np.cos(d), np.sin(d)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    down = np.cross(forward, right)
    h = FOCAL_PX * right + CENTRE_PX * forward
    return Cahv(np.array(centre), forward, h, FOCAL_PX * down + CENTRE_PX * forward)


def pose(drive=0, at=(0.0, 0.0, 0.0), covariance=None) -> StopPose:
    stop = StopId("MER2", 10, drive)
    known = np.zeros((6, 6)) if covariance is None else covariance
    return StopPose(stop, Pose(LSL, stop.frame, np.eye(3), np.array(at, dtype=float)), known)


def image(stop=None, pointing=0.0, **where) -> OrientedImage:
    seen = camera(**where)
    pivot = seen.centre + np.array([0.1, 0.0, 0.2])
    turn = pointing**2 * np.eye(3)
    return OrientedImage("A", stop or pose(), seen, (1024, 1024), pivot, turn)


@pytest.fixture
def loose(rng):
    """A covariance of a pose whose parts are correlated."""
    root = rng.normal(size=(6, 6)) * np.array([1e-3, 1e-3, 2e-3, 0.02, 0.03, 0.01])
    return root.T @ root / 6


@pytest.mark.usefixtures("unchecked")
def test_the_ellipse_agrees_with_simulated_pose_and_pointing_errors(rng, loose):
    """Poses, pointings and places drawn by their covariances, against the propagated one."""
    stop = pose(1, (2.0, -1.0, 0.0), loose)
    seen = image(stop, pointing=2e-3, centre=(2.1, -1.2, -1.5))
    point = np.array([12.0, 1.5, 0.3])
    own = np.diag([0.03, 0.02, 0.01]) ** 2
    drawn = []
    for _ in range(4000):
        d, shift = np.split(rng.multivariate_normal(np.zeros(6), loose), 2)
        m = rng.normal(0, 2e-3, 3)
        centre = stop.lsl_from_rover.translation_m
        carried = (
            point - shift - np.cross(d, point - centre) - np.cross(m, point - seen.pivot_in_lsl)
        )
        drawn.append(seen.camera.project((carried + own**0.5 @ rng.normal(size=3))[None])[0])
    predicted = image_covariance_from(seen, point, own, pose(0))
    assert np.cov(np.array(drawn).T) == pytest.approx(predicted, abs=0.05 * np.trace(predicted))


def test_stops_share_their_errors_within_and_differ_by_the_larger_one(loose):
    point = np.array([10.0, 3.0, 0.0])
    worse = pose(2, (5.0, 0.0, 0.0), 4 * loose)
    better = pose(1, (5.0, 0.0, 0.0), loose)
    assert not relative_covariance(better, pose(1, covariance=9 * loose), point).any()
    assert relative_covariance(better, worse, point) == pytest.approx(
        3 * better.covariance_at(point)
    )
    assert relative_covariance(worse, better, point) == pytest.approx(
        relative_covariance(better, worse, point)
    )
    assert (
        np.linalg.eigvalsh(relative_covariance(better, pose(3, (9.0, 4.0, 0.0), loose), point))[0]
        > -1e-12
    )


def test_a_rotation_of_the_stop_moves_points_by_their_lever_arm():
    sigma = 1e-3
    stop = pose(1, (4.0, 0.0, 0.0), np.diag([0.0, 0.0, sigma**2, 0.0, 0.0, 0.0]))
    at = stop.covariance_at(np.array([14.0, 0.0, 0.0]))
    assert np.sqrt(np.diagonal(at)) == pytest.approx([0.0, 10 * sigma, 0.0])


def test_derivatives_are_those_of_the_camera():
    seen, point = camera(), np.array([9.0, 2.0, 0.1])
    assert partials(seen, point) == pytest.approx(seen.partials(point[None])[1][0], rel=1e-6)


def test_an_ellipse_has_the_axes_of_its_covariance():
    turn = Rotation.from_euler("z", 30, degrees=True).as_matrix()[:2, :2]
    ellipse = Ellipse.of(turn @ np.diag([9.0, 4.0]) @ turn.T)
    assert (ellipse.semi_major, ellipse.semi_minor) == pytest.approx((3.0, 2.0))
    assert np.degrees(ellipse.angle) == pytest.approx(30.0)


def test_the_epipolar_curve_contains_the_image_of_every_point_of_the_ray():
    one, other = image(), image(pose(1), centre=(1.0, 3.0, -1.4), azimuth_deg=-10.0)
    pixel = np.array([[700.0, 400.0]])
    ranges = np.geomspace(2.0, 100.0, 40)
    places, at = epipolar_curve(one, pixel[0], other, ranges)
    assert 5 < len(places) < 40
    for place, metres in zip(places, at, strict=True):
        point = one.camera.centre + metres * one.camera.rays(pixel)[0]
        assert other.camera.project(point[None])[0] == pytest.approx(place)
        assert other.shows(place)


def test_points_behind_or_beside_an_image_are_not_on_it():
    seen = image()
    assert not seen.shows(seen.camera.project(np.array([[-5.0, 0.0, 0.0]]))[0])
    assert not seen.shows(np.array([1023.6, 5.0]))
    assert seen.shows(np.array([1023.4, -0.4]))


def test_the_cross_matrix_is_the_cross_product(rng):
    a, b = rng.normal(size=(2, 3))
    assert cross_matrix(a) @ b == pytest.approx(np.cross(a, b))


def test_a_place_known_exactly_is_uncertain_by_pointing_alone():
    seen = image(pointing=1e-3)
    ahead = seen.camera.centre + 10.0 * seen.camera.a
    covariance = image_covariance(seen, ahead, np.zeros((3, 3)))
    assert np.sqrt(np.linalg.eigvalsh(covariance)) == pytest.approx(1.2, rel=0.03)
