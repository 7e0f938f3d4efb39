"""Horizons and insolation of surfaces whose shadows are known."""

import math

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import window_gradients
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.resampling import coarsen
from solmap.photogrammetry.terrain.insolation.horizon import horizons
from solmap.photogrammetry.terrain.insolation.maps import (
    InsolationParams,
    horizon_towards,
    insolation,
    sky_view,
)
from solmap.photogrammetry.terrain.insolation.sun import Season
from solmap.photogrammetry.terrain.relief.slope import normals_of
from tests.support.terrain.insolation import daily_insolation_above

GUSEV = math.radians(-14.735)
CLEAR = InsolationParams(ls_deg=(90.0,), optical_depth=0.0)


def plane(slope_deg, azimuth_deg):
    """A plane that falls towards the azimuth."""
    g, a = np.tan(np.radians(slope_deg)), np.radians(azimuth_deg)
    return lambda east, north: -g * (np.sin(a) * east + np.cos(a) * north)


def received(scenes, surface, params=CLEAR, side=256):
    dtm = scenes.dtm_of(surface, side=side)
    made = insolation(dtm, GUSEV, params)
    values = made.received[0]
    return values, made


def inner(values):
    """Cells a window's width from the edge of what is known."""
    rows, cols = (
        np.flatnonzero(np.isfinite(values).any(1)),
        np.flatnonzero(np.isfinite(values).any(0)),
    )
    return values[rows[0] + 8 : rows[-1] - 7, cols[0] + 8 : cols[-1] - 7]


def waves(east, north):
    """Dunes of 1 m, 10 m apart, on a gentle slope."""
    return np.sin(north / 1.6) + np.cos(east / 2) + 0.02 * north


def test_the_horizon_equals_that_of_walking_along_the_ray(rng):
    grid = MapGrid(0.0, 0.0, 0.16, 200, 240)
    east, north = grid.centres()
    found = horizons(waves(*np.meshgrid(east, north)).astype(np.float32), grid.cell_m)
    away = np.arange(grid.cell_m, 60.0, 0.04)
    off = []
    for row, col in zip(rng.integers(0, 200, 40), rng.integers(0, 240, 40), strict=True):
        for number, azimuth in enumerate(2 * np.pi * np.arange(36) / 36):
            e, n = east[col] + away * np.sin(azimuth), north[row] + away * np.cos(azimuth)
            inside = (e > east[0]) & (e < east[-1]) & (n < north[0]) & (n > north[-1])
            rise = (waves(e, n) - waves(east[col], north[row]))[inside] / away[inside]
            expected = np.arctan(max(0.0, rise.max(initial=0.0)))
            off.append(np.degrees(np.arctan(found[number, row, col]) - expected))
    # lines of cells stray by half a cell, which on these slopes is 4 cm of height
    assert np.percentile(np.abs(off), 95) < 1.5
    assert np.median(np.abs(off)) < 0.15
    assert abs(np.mean(off)) < 0.1


def test_along_rows_columns_and_diagonals_horizons_are_exact(rng):
    elevation = rng.normal(0, 1, (40, 50)).astype(np.float32)
    found = horizons(elevation, 1.0, azimuths=8)
    for azimuth, (down, right) in enumerate(
        [(-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1)]
    ):
        for row, col in ((20, 25), (3, 47), (39, 0)):
            steps = np.arange(1, 60)
            r, c = row + down * steps, col + right * steps
            inside = (r >= 0) & (r < 40) & (c >= 0) & (c < 50)
            away = steps[inside] * math.hypot(down, right)
            rise = (elevation[r[inside], c[inside]] - elevation[row, col]) / away
            assert found[azimuth, row, col] == pytest.approx(max(0, rise.max(initial=0)), rel=1e-5)


def test_in_a_round_pit_the_horizon_is_the_rim_all_around():
    side, cell_m = 161, 0.1
    south, east = (np.indices((side, side)) - side // 2) * cell_m
    elevation = np.where(np.hypot(south, east) < 5.0, 0.0, 2.0).astype(np.float32)
    found = horizons(elevation, cell_m)[:, side // 2, side // 2]
    np.testing.assert_allclose(found, 2.0 / 5.0, rtol=0.03)  # half a cell each way


def test_unseen_ground_hides_nothing_and_has_no_horizon():
    elevation = np.zeros((60, 60), np.float32)
    elevation[:30] = np.nan
    found = horizons(elevation, 1.0)
    assert np.isnan(found[:, :30]).all()
    assert (found[:, 30:] == 0).all()


def test_between_two_azimuths_the_horizon_is_interpolated():
    rise = np.arange(4, dtype=np.float32)[:, None, None] * np.ones((4, 2, 2), np.float32)
    assert horizon_towards(rise, math.radians(45))[0, 0] == pytest.approx(0.5)
    assert horizon_towards(rise, math.radians(-45))[0, 0] == pytest.approx(1.5)
    assert horizon_towards(rise, math.radians(-1e-12))[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_level_ground_without_dust_receives_what_arrives_above_it(scenes):
    values, made = received(scenes, scenes.level)
    above = daily_insolation_above(GUSEV, Season(90.0))
    assert made.level[0] == pytest.approx(above, rel=0.001)  # 48 suns a day for the integral
    np.testing.assert_allclose(inner(values), above, rtol=0.001)


@pytest.mark.parametrize("slope_deg", [5.0, 15.0])
def test_ground_tilted_to_north_receives_the_insolation_of_a_northern_latitude(scenes, slope_deg):
    # a plane tilted by b to the north is parallel to level ground b further north, as long as the
    # sun rises for both before it shines on the plane's back: in the southern winter it does
    values, _ = received(scenes, plane(slope_deg, 0.0))
    further = daily_insolation_above(GUSEV + math.radians(slope_deg), Season(90.0))
    np.testing.assert_allclose(np.median(inner(values)), further, rtol=0.01)


def test_at_noon_the_incidence_equals_the_solar_energy_of_vicar():
    gradient = np.array([0.1, -0.2], dtype=np.float32).reshape(2, 1, 1)
    u, v, w = normals_of(gradient)[:, 0, 0]
    for elevation in np.radians([30.0, 60.0]):
        north, east, up = math.cos(elevation), 0.0, math.sin(elevation)
        vicar = u * math.cos(elevation) - w * math.cos(math.pi / 2 - elevation)
        assert u * north + v * east - w * up == pytest.approx(vicar)


def test_a_wall_to_the_north_blocks_the_winter_sun(scenes):
    def walled(east, north):
        return np.where(north > 2.0, 3.0, 0.0) + 0.0 * east

    values, made = received(scenes, walled)
    rows = np.flatnonzero(np.isfinite(values).any(axis=1))
    middle = values[:, values.shape[1] // 2]
    _, north = made.grid.centres()
    shaded = middle[(north > -0.5) & (north < 1.0)]  # the sun stands below 50 degrees
    free = middle[(north < -4.5) & np.isfinite(middle)]
    assert len(rows) > 0
    assert np.nanmax(shaded) < 0.25 * made.level[0]
    assert np.nanmin(free[np.isfinite(free)]) > np.nanmax(shaded)


def test_level_ground_sees_the_whole_sky_and_a_slope_less():
    for slope_deg in (0.0, 30.0):
        surface = plane(slope_deg, 40.0)
        grid = MapGrid(0.0, 0.0, 0.16, 64, 64)
        east, north = np.meshgrid(*grid.centres())
        elevation = surface(east, north).astype(np.float32)
        seen = sky_view(
            np.zeros((36, 64, 64), np.float32), window_gradients(elevation, grid.cell_m, 1.1)
        )
        # an endless plane sees the sky above it: (1 + cos S) / 2
        expected = (1 + math.cos(math.radians(slope_deg))) / 2
        np.testing.assert_allclose(seen[20:-20, 20:-20], expected, atol=2e-3)


def test_dust_reduces_the_effect_of_tilt(scenes):
    ratio = {}
    for depth in (0.0, 2.0):
        params = InsolationParams(ls_deg=(90.0,), optical_depth=depth)
        values, made = received(scenes, plane(15.0, 0.0), params)
        ratio[depth] = np.median(inner(values)) / made.level[0]
    assert ratio[0.0] > 1.15
    assert 1.0 < ratio[2.0] < 1.06


def test_several_seasons_are_mapped_at_once(scenes):
    params = InsolationParams(ls_deg=(90.0, 270.0))
    _, made = received(scenes, scenes.level, params)
    assert made.level[1] > 2 * made.level[0]  # perihelion is in the southern summer
    assert [season.ls_deg for season in made.seasons] == [90.0, 270.0]


def test_coarse_cells_keep_the_place_and_mean_of_a_plane(scenes):
    dtm = scenes.dtm_of(scenes.tilted, side=128)
    coarse, grid = coarsen(dtm.elevation, dtm.grid, 0.16)
    east, north = np.meshgrid(*grid.centres())
    known = np.isfinite(coarse)
    assert known.sum() == 32 * 32
    np.testing.assert_allclose(coarse[known], scenes.tilted(east, north)[known], atol=1e-5)
    assert grid.rows % 256 == 0


def test_cells_are_not_refined(scenes):
    dtm = scenes.dtm_of(scenes.level)
    assert coarsen(dtm.elevation, dtm.grid, 0.02) == (dtm.elevation, dtm.grid)


def test_large_areas_have_larger_cells(scenes):
    dtm = scenes.dtm_of(scenes.tilted, side=256)
    made = insolation(dtm, GUSEV, InsolationParams(most_cells=2000))
    assert made.grid.cell_m == 0.32  # 32 x 32 cells of 10.24 m
    assert np.isfinite(made.received[0]).sum() > 500


def test_a_model_without_elevations_is_an_error(scenes):
    dtm = scenes.dtm_of(scenes.level)
    dtm.elevation[:] = np.nan
    with pytest.raises(TerrainError, match="has no elevations"):
        insolation(dtm, GUSEV, CLEAR)
