"""Two stops on made-up ground: what the registration makes of errors that both stops share."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.ground_grid import GroundGrid
from solmap.photogrammetry.matching.cross_site.surface_alignment import (
    SurfaceParams,
    register,
)
from solmap.photogrammetry.matching.cross_site.surface_matching import ROUNDS_TO_REST
from solmap.photogrammetry.matching.cross_site.tie_weights import SHARED_PARALLAX_PX
from solmap.photogrammetry.matching.height_bias import mean_of_known

PARAMS = SurfaceParams(farthest_m=15.0)
FRAMES = [StopId("MER2", 1, drive).frame for drive in (0, 8)]
AWAY = Pose(*FRAMES, np.eye(3), np.array([11.0, 4.0, 0.0]))
LOOSE = np.diag(np.square([0.005, 0.005, 0.02, 0.3, 0.3, 0.3]))
SUN = np.array([0.6, 0.0, -0.8])
MAST_M, FOCAL_PX, SCALE_PX_M = 1.5, 1200.0, 240.0


@pytest.fixture(scope="module")
def ground():
    """Heights on the cells of a grid, metres: bumps of 0.3 and of 1 m."""
    noise = np.random.default_rng(3).normal(size=(1400, 1400)).astype(np.float32)
    return sum(
        height_m * cv2.GaussianBlur(noise, (0, 0), cells) * cells * 3.54
        for cells, height_m in ((6.0, 0.08), (20.0, 0.12))
    )


def seen_from(ground, north_m, east_m, lines=0.0):
    """What a mast sees of the ground, drawn so many lines too high; crests hide what is behind.

    So many where the tangent of the angle between ray and facet is 0.1, fewer with its root.
    """
    half, cell_m = round(PARAMS.farthest_m / PARAMS.cell_m), PARAMS.cell_m
    row, col = 700 - round(north_m / cell_m), 700 + round(east_m / cell_m)
    up = ground[row - half : row + half, col - half : col + half].copy()
    place = (np.arange(2 * half) + 0.5 - half) * cell_m
    far = np.hypot(place[:, None], place[None, :])
    over = ((up - MAST_M) / far).astype(np.float32)
    middle, size = (half - 0.5, half - 0.5), (2 * half, 1440)
    drawn = cv2.INTER_LINEAR | cv2.WARP_FILL_OUTLIERS  # outside is not what memory held
    polar = cv2.warpPolar(over, size, middle, 2 * half, drawn)
    horizon = np.maximum.accumulate(polar, axis=1)
    back = cv2.warpPolar(horizon, up.shape, middle, 2 * half, drawn | cv2.WARP_INVERSE_MAP)
    up[(over < back - 0.003) | (far > PARAMS.farthest_m) | (far < 1.5)] = np.nan
    by_row, by_col = np.gradient(
        cv2.GaussianBlur(ground, (0, 0), 2.0)[row - half : row + half, col - half : col + half]
    )
    rise = (by_row * place[:, None] + by_col * place[None, :]) / cell_m / far
    tangent = np.maximum((MAST_M - up) / far + rise, 0.03)
    up += lines * np.hypot(far, MAST_M) / FOCAL_PX * np.sqrt(0.1 / tangent)
    return GroundGrid(cell_m, up.astype(np.float32), MAST_M, SCALE_PX_M, FOCAL_PX)


def registered(ground, lines=0.0, suns=(SUN, SUN)):
    """(error of the place in metres, error of the attitude in degrees, registration)."""
    grids = (
        replace(seen_from(ground, *place, lines), sun=sun)
        for place, sun in zip(((0.0, 0.0), (11.0, 4.0)), suns, strict=True)
    )
    found = register(*grids, AWAY, LOOSE, PARAMS)
    turn = np.degrees(Rotation.from_matrix(found.pose.rotation).as_rotvec())
    return found.pose.translation_m - AWAY.translation_m, turn, found


@pytest.fixture(scope="module")
def exact(ground):
    return registered(ground)


def test_stops_on_both_sides_of_a_crest_are_not_displaced(exact):
    off_m, turn_deg, _ = exact
    assert np.abs(off_m).max() < 0.001
    assert np.abs(turn_deg).max() < 0.01


def test_a_registration_goes_on_until_it_is_at_rest(ground):
    grids = [seen_from(ground, *place) for place in ((0.0, 0.0), (11.0, 4.0))]
    start = replace(AWAY, translation_m=AWAY.translation_m + np.array([0.8, 0.5, 0]))
    found = register(*grids, start, LOOSE, replace(PARAMS, rounds=ROUNDS_TO_REST))
    assert np.abs(found.pose.translation_m - AWAY.translation_m).max() < 0.001  # 12 rounds: 1.3 m


def test_ground_with_a_height_bias_of_a_line_tilts_no_stop(ground):
    off_m, turn_deg, found = registered(ground, lines=1.0)
    assert np.abs(off_m).max() < 0.003  # a line is 1 cm at 12 m
    assert np.abs(turn_deg).max() < 0.015
    assert abs(found.height_bias.lines - 1.0) < 3 * found.height_bias.sigma < 0.3


def test_unbiased_ground_has_no_height_bias(exact):
    *_, found = exact
    assert abs(found.height_bias.lines) < 3 * found.height_bias.sigma < 0.3


def test_the_range_between_stops_has_the_uncertainty_of_a_parallax_bias(exact):
    *_, found = exact
    ahead = AWAY.translation_m / np.linalg.norm(AWAY.translation_m)
    along_m = np.sqrt(ahead @ found.covariance[3:, 3:] @ ahead)
    half_m = np.linalg.norm(AWAY.translation_m) / 2
    least_m = 2 * SHARED_PARALLAX_PX / SCALE_PX_M * half_m**2
    assert least_m < along_m < 3 * least_m


def test_suns_from_opposite_sides_add_an_error_of_all_ground(ground, exact):
    across = registered(ground, suns=(SUN, SUN * [-1.0, 1.0, 1.0]))[2]
    added = across.covariance - exact[2].covariance
    share, cells = 0.6, across.cells  # half the difference of the two directions
    arm = np.average(cells.arms, axis=0, weights=cells.weight)
    middle = np.hstack([np.cross(np.eye(3), arm).T, np.eye(3)])  # motion of the middle
    shift2 = (share * PARAMS.shared_shift_m) ** 2
    np.testing.assert_allclose(middle @ added @ middle.T, np.diag([shift2, shift2, 0.0]), atol=1e-8)
    assert added[2, 2] == pytest.approx((share * PARAMS.shared_turn) ** 2)
    unknown = registered(ground, suns=(None, SUN))[2]
    assert unknown.covariance[2, 2] > across.covariance[2, 2]


@pytest.mark.parametrize("sigma_cells", [1.5, 8.0])
def test_unknown_ground_around_does_not_change_the_smoothed_heights(rng, sigma_cells):
    known = rng.normal(size=(60, 70)).astype(np.float32)
    known[20:30, 40:50] = np.nan
    near, far = (
        mean_of_known(np.pad(known, width, constant_values=np.nan), sigma_cells, 0.15)
        for width in (40, 120)
    )
    np.testing.assert_allclose(near, far[80:-80, 80:-80], rtol=1e-5, atol=1e-6)
    assert np.isnan(far[:80]).all()
    assert np.isnan(mean_of_known(np.full((9, 9), np.nan, np.float32), 2.0, 0.15)).all()
