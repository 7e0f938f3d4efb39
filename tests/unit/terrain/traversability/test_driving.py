"""Ways of a rover over ground whose shortest ways are known."""

import math

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.traversability.driving import DrivingParams, reachability
from solmap.photogrammetry.terrain.traversability.hazard import Hazard

GRID = MapGrid.covering((-20.0, -20.0, 20.0, 20.0), 0.16)
HALF = GRID.cell_m / 2
START = (HALF, HALF)
"""The centre of a cell."""
EAST, NORTH = (axis.T for axis in np.meshgrid(*GRID.centres(), indexing="ij"))
PARAMS = DrivingParams()


def ways(closed=None, elevation=None, params=PARAMS, code=Hazard.STEP):
    hazard = np.full(GRID.shape, Hazard.TRAVERSABLE, np.uint8)
    if closed is not None:
        hazard[closed] = code
    level = np.zeros(GRID.shape, np.float32)
    return reachability(hazard, level if elevation is None else elevation, GRID, START, params)


def straight():
    return np.hypot(EAST - START[0], NORTH - START[1])


def test_routes_on_open_level_ground_are_nearly_straight():
    found, line = ways(), straight()
    longer = found.drive_m[line > 1] / line[line > 1]
    assert longer.min() > 1 - 1e-6
    assert longer.max() < 1.028
    for turn in range(0, 360, 45):  # along its own directions a way is exact
        place = (START[0] + 8 * math.sin(math.radians(turn)), 8 * math.cos(math.radians(turn)))
        way = found.path_to(place)
        assert np.hypot(*np.diff(way, axis=0).T).sum() == pytest.approx(
            math.dist(way[0], way[-1]), rel=0.03
        )


def test_the_length_of_a_slope_is_that_on_its_ground():
    climb = (EAST * 0.5).astype(np.float32)
    found = ways(elevation=climb)
    row, col = found.start
    assert found.drive_m[row, col + 50] == pytest.approx(50 * 0.16 * math.hypot(1, 0.5), rel=1e-5)
    assert found.drive_m[row - 50, col] == pytest.approx(50 * 0.16, rel=1e-5)


def test_a_route_goes_round_the_end_of_a_wall():
    wall = (np.abs(EAST - 5) < 0.4) & (NORTH < 6) & (NORTH > -15)
    found = ways(wall)
    to = (HALF + 63 * GRID.cell_m, HALF)
    way = found.path_to(to)
    corner = (5.0, 6.0)
    round_it = math.dist(START, corner) + math.dist(corner, to)
    row, col = GRID.cell_at(*to)
    assert round_it < found.drive_m[row, col] < 1.05 * round_it
    cells = np.floor((way - [GRID.west, 0]) / 0.16).astype(int)[:, 0]
    rows = np.floor((GRID.north - way[:, 1]) / 0.16).astype(int)
    assert not wall[rows, cells].any()
    assert way[0] == pytest.approx(START)
    assert way[-1] == pytest.approx(to)


def test_no_route_passes_a_diagonal_wall_of_one_cell():
    found = ways(np.abs(EAST + NORTH - 8.0) < 0.9 * GRID.cell_m)
    beyond = EAST + NORTH > 9
    assert np.isnan(found.drive_m[beyond]).all()
    with pytest.raises(TerrainError, match="no path free of hazards"):
        found.path_to((10.0, 10.0))


def test_small_gaps_are_crossed_and_wide_ones_are_not():
    def behind(width_m):
        found = ways(np.abs(EAST - 5) < width_m / 2, code=Hazard.UNKNOWN)
        return np.isfinite(found.drive_m[EAST > 8]).any()

    assert behind(0.3)
    assert not behind(1.2)


def test_a_route_leaves_unknown_ground_below_the_rover_but_enters_no_hazard():
    unknown = straight() < 2.0
    found = ways(unknown, code=Hazard.UNKNOWN)
    assert np.isfinite(found.drive_m).mean() > 0.95
    rock = np.hypot(EAST - 1.2, NORTH) < 0.4
    assert np.isnan(ways(rock).drive_m[rock]).all()


def test_a_start_in_a_hazard_or_off_the_map_is_refused():
    with pytest.raises(TerrainError, match="is a hazard \\(step\\)"):
        ways(straight() < 1)
    with pytest.raises(TerrainError, match="not on the map"):
        reachability(
            np.ones(GRID.shape, np.uint8), EAST.astype(np.float32), GRID, (99.0, 0.0), PARAMS
        )


def test_no_route_is_longer_than_requested():
    found = ways(params=DrivingParams(farthest_m=7.0))
    assert np.nanmax(found.drive_m) <= 7.0
    assert np.nanmax(found.drive_m) > 6.8


def test_ground_without_elevation_is_level_with_its_neighbours():
    holes = np.where(EAST > 3, np.nan, 0.0).astype(np.float32)
    assert np.isfinite(ways(elevation=holes).drive_m).mean() > 0.95
    nothing = np.full(GRID.shape, np.nan, np.float32)
    assert np.isfinite(ways(elevation=nothing).drive_m).mean() > 0.95


@pytest.mark.parametrize("wrong", [{"stand_m": -1.0}, {"gap_m": -0.1}, {"farthest_m": 0.0}])
def test_impossible_parameters_are_refused(wrong):
    with pytest.raises(TerrainError, match="farthest_m must be above zero"):
        DrivingParams(**wrong)
