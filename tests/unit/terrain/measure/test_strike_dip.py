"""Strike and dip of planes through points, and of ground inside an outline: right and as stated."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import fit_plane
from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.measure.strike_dip import (
    CellPlaneParams,
    attitude,
    plane_of_cells,
)

TRIALS = 400
CAMERA = np.array([0.0, 0.0, 1.5])


def normal_of(strike_deg: float, dip_deg: float) -> np.ndarray:
    azimuth, dip = np.radians([strike_deg + 90, dip_deg])
    return np.array([np.sin(dip) * np.sin(azimuth), np.sin(dip) * np.cos(azimuth), np.cos(dip)])


def face(strike_deg, dip_deg, centre, rng, count=60, size_m=0.6) -> np.ndarray:
    """Points of a plane, scattered around its centre."""
    n = normal_of(strike_deg, dip_deg)
    first = np.cross(n, [0.3, -0.5, 0.8])
    first /= np.linalg.norm(first)
    places = rng.uniform(-size_m, size_m, (count, 2))
    return np.asarray(centre) + places @ np.stack([first, np.cross(n, first)])


def stereo_covariances(points: np.ndarray, sigma_px=0.25, base_m=0.2, focal_px=1200.0):
    """Of points seen by a stereo camera at the mast: long along the ray, thin across."""
    ray = points - CAMERA
    distance = np.linalg.norm(ray, axis=1)[:, None, None]
    along = distance**2 / (base_m * focal_px) * sigma_px
    across = distance / focal_px * sigma_px
    unit = ray[:, :, None] / distance
    outer = unit * unit.transpose(0, 2, 1)
    return along**2 * outer + across**2 * (np.eye(3) - outer)


def noisy(points, covariances, rng):
    return points + np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=points.shape)
    )


@given(strike=st.floats(0, 360, exclude_max=True), dip=st.floats(1, 90))
def test_strike_and_dip_of_an_exact_plane(strike, dip):
    points = face(strike, dip, (3.0, 8.0, 0.5), np.random.default_rng(5))
    found = attitude(fit_plane(points, stereo_covariances(points) * 1e-4))
    assert np.degrees(found.dip) == pytest.approx(dip, abs=1e-4)
    off = (np.degrees(found.strike) - strike + 180) % 360 - 180
    if dip > 89.9:  # a vertical plane falls to either side
        off = (off + 90) % 180 - 90
    assert off == pytest.approx(0, abs=1e-3)
    falls = (np.degrees(found.dip_direction) - np.degrees(found.strike)) % 360
    assert falls == pytest.approx(90)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("strike", "dip", "centre"),
    [(20.0, 35.0, (2.0, 6.0, 0.2)), (250.0, 12.0, (-9.0, 9.0, -0.5)), (130.0, 75.0, (4.0, 3.0, 1))],
)
def test_errors_are_as_large_as_stated(strike, dip, centre, rng):
    """Over many trials the errors, divided by what is stated, have the variance 1.

    Five standard deviations of a mean of squares over the trials are 5 sqrt(2 / 400) = 0.35.
    """
    truth = face(strike, dip, centre, rng)
    covariances = stereo_covariances(truth)
    squares, mean_off = np.zeros(3), np.zeros(2)
    for _ in range(TRIALS):
        plane = fit_plane(noisy(truth, covariances, rng), covariances)
        found = attitude(plane)
        off = np.array([np.degrees(found.strike) - strike, np.degrees(found.dip) - dip])
        off = np.radians((off + 180) % 360 - 180)
        stated = np.array([found.sigma_strike, found.sigma_dip])
        place = plane.normal @ (truth.mean(axis=0) - plane.centre) / plane.sigma_m
        squares += np.append(off / stated, place) ** 2 / TRIALS
        mean_off += off / stated / TRIALS
    assert squares == pytest.approx(np.ones(3), abs=0.35)
    assert np.abs(mean_off).max() < 5 / np.sqrt(TRIALS)  # no tilt towards the views


def test_a_shared_turn_of_the_camera_turns_the_plane(rng):
    """Of a turn about the strike the dip takes all, and of one about the vertical the strike."""
    points = face(0.0, 30.0, (3.0, 8.0, 0.5), rng)
    covariances = stereo_covariances(points) * 1e-6
    turning = np.diag([0.0, 0.01**2, 0.02**2])  # about north, which is the strike; about up
    found = attitude(fit_plane(points, covariances, turning))
    assert found.sigma_dip == pytest.approx(0.01, rel=1e-3)
    assert found.sigma_strike == pytest.approx(0.02, rel=1e-3)


def test_scatter_above_the_stated_sigmas_enlarges_the_errors(rng):
    points = face(40.0, 30.0, (3.0, 8.0, 0.5), rng)
    covariances = stereo_covariances(points)
    calm = fit_plane(noisy(points, covariances, rng), covariances)
    rough = fit_plane(noisy(points, 25 * covariances, rng), covariances)
    assert calm.sigma0 == pytest.approx(1, abs=0.5)  # five sigma: 5 / sqrt(2 x 57)
    assert rough.sigma0 == pytest.approx(5, abs=2.5)
    assert attitude(rough).sigma_dip > 2.5 * attitude(calm).sigma_dip


def test_the_plane_of_three_points_contains_them():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    plane = fit_plane(points, np.broadcast_to(np.eye(3) * 1e-6, (3, 3, 3)).copy())
    np.testing.assert_allclose(plane.normal, [0, -np.sqrt(0.5), np.sqrt(0.5)], atol=1e-9)
    assert plane.sigma0 == 1.0
    assert np.degrees(attitude(plane).dip_direction) == pytest.approx(180)


def test_too_few_points_are_refused():
    with pytest.raises(TerrainError, match="3 points that are not on one line, not 2"):
        fit_plane(np.zeros((2, 3)), np.zeros((2, 3, 3)))


def test_points_along_a_line_are_refused(rng):
    along = np.linspace(-1, 1, 30)[:, None] * np.array([0.5, 1.0, 0.2]) + [3.0, 8.0, 0.5]
    covariances = stereo_covariances(along)
    with pytest.raises(TerrainError, match=r"30 points .* rotate about the line"):
        fit_plane(noisy(along, covariances, rng), covariances)
    exact = along * [0.0, 1.0, 0.0]
    with pytest.raises(TerrainError, match="rotate about the line"):
        fit_plane(exact, np.broadcast_to(np.eye(3) * 1e-6, (30, 3, 3)).copy())


def test_the_strike_of_a_level_plane_is_refused(rng):
    points = face(40.0, 0.2, (3.0, 8.0, -0.5), rng)
    covariances = stereo_covariances(points)
    plane = fit_plane(noisy(points, covariances, rng), covariances)
    with pytest.raises(
        TerrainError, match=r"level within its uncertainty, and its strike is undef"
    ):
        attitude(plane)


PARAMS = CellPlaneParams()
OUTLINE = np.array([[-1.0, -1.0], [1.0, -1.0], [0.5, 1.0], [-1.0, 0.8]])


def slab(east, north):
    """Dips by 20 degrees to the east inside the outline, and is level outside."""
    inside = (np.abs(east) < 1.2) & (np.abs(north) < 1.2)
    return np.where(inside, -np.tan(np.radians(20)) * east, 5.0)


def test_the_slab_inside_the_outline_has_its_strike_and_dip(scenes):
    plane = plane_of_cells(scenes.dtm_of(slab), OUTLINE, PARAMS)
    found = attitude(plane)
    assert np.degrees(found.strike) == pytest.approx(0, abs=0.01)
    assert np.degrees(found.dip) == pytest.approx(20, abs=0.01)
    assert plane.points == pytest.approx(3.35 / 0.04**2, rel=0.02)  # area over that of a cell


@pytest.mark.usefixtures("unchecked")
def test_errors_inside_an_outline_are_as_large_as_stated(scenes, rng):
    """Over 200 trials the mean square is 1 but for 5 sqrt(2 / 200) = 0.5, and the shared tilt."""
    dtm = scenes.dtm_of(slab)
    dtm = replace(dtm, observations=np.full(dtm.grid.shape, 81, np.float32))
    alone = replace(PARAMS, tilt_deg=0.0, shared_px=9.0)  # the noise of every cell is its own
    squares = []
    for _ in range(200):
        noise = rng.normal(0, dtm.sigma_m).astype(np.float32)
        noisy = replace(dtm, elevation=dtm.elevation + noise)
        found = attitude(plane_of_cells(noisy, OUTLINE, alone))
        off = np.array([(found.strike + np.pi) % (2 * np.pi) - np.pi, found.dip - np.radians(20)])
        squares.append((off / [found.sigma_strike, found.sigma_dip]) ** 2)
    mean = np.mean(squares, axis=0)
    sideways = 1 + (0.04**2 / 12 * np.sin(np.radians(20)) ** 2) / (0.01**2)  # not drawn, but stated
    assert (mean > 0.5 / sideways).all()
    assert (mean < 1.5).all()


def test_the_common_error_of_all_cells_is_not_scatter_but_its_tilt_counts(scenes):
    dtm = scenes.dtm_of(slab)
    shared = replace(dtm, pose_sigma_m=(0.99 * dtm.sigma_m).astype(np.float32))
    alone, together = (plane_of_cells(one, OUTLINE, PARAMS) for one in (dtm, shared))
    assert together.sigma_m < alone.sigma_m
    for plane in (alone, together):
        assert np.degrees(attitude(plane).sigma_dip) >= PARAMS.tilt_deg * (1 - 1e-9)


def test_only_measured_cells_count(scenes):
    dtm = scenes.dtm_of(slab)
    dtm.ground[:, :64] = GroundClass.INTERPOLATED
    plane = plane_of_cells(dtm, OUTLINE, PARAMS)
    assert plane.centre[0] > 0.2


def test_invalid_outlines_are_refused(scenes):
    dtm = scenes.dtm_of(slab)
    with pytest.raises(TerrainError, match="at least 3 corners, not 2"):
        plane_of_cells(dtm, OUTLINE[:2], PARAMS)
    with pytest.raises(TerrainError, match="crosses itself"):
        plane_of_cells(dtm, OUTLINE[[0, 2, 1, 3]], PARAMS)
    with pytest.raises(TerrainError, match=r"no measured ground .* from -2\.6 to 2\.6 m east"):
        plane_of_cells(dtm, OUTLINE + 50.0, PARAMS)
