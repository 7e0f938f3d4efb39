"""Merging the orthophotos of stops: the nearest is used, edges do not show, gaps stay gaps."""

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.orthophoto.merging import (
    MergingParams,
    StopImagery,
    merge_block,
)

GRID = MapGrid.covering((-10.0, -5.0, 10.0, 5.0), 0.04)
PARAMS = MergingParams(cell_m=0.04)
WEST, EAST = (-8.0, 0.0), (8.0, 0.0)


def image(place, value, shown=None):
    brightness = np.full(GRID.shape, value, np.float32)
    if shown is not None:
        east, _ = GRID.centres()
        brightness[:, ~shown(east)] = np.nan
    return StopImagery(place, brightness)


def test_every_cell_shows_the_image_of_the_nearest_stop():
    merged = merge_block([image(WEST, 1.0), image(EAST, 3.0)], GRID, PARAMS)
    east, _ = GRID.centres()
    inner = np.abs(GRID.centres()[1]) < 3.0
    assert merged[inner][:, (east > -9) & (east < -3)] == pytest.approx(1.0, abs=1e-4)
    assert merged[inner][:, (east > 3) & (east < 9)] == pytest.approx(3.0, abs=1e-4)


def test_the_transition_between_stops_has_no_step():
    half = image(WEST, 1.0, lambda east: east < 5.0)  # its edge lies on the ground of the other
    merged = merge_block([half, image(EAST, 3.0)], GRID, PARAMS)
    inner = merged[np.abs(GRID.centres()[1]) < 3.0]
    assert np.isfinite(inner).all()
    assert np.abs(np.diff(inner, axis=1)).max() < 0.1  # of 2.0


def test_ground_that_no_stop_shows_stays_unseen():
    shown = [image(WEST, 1.0, lambda east: east < -2), image(EAST, 3.0, lambda east: east > 2)]
    merged = merge_block(shown, GRID, PARAMS)
    east, _ = GRID.centres()
    assert np.isnan(merged[:, np.abs(east) < 2]).all()
    assert np.isfinite(merged[:, np.abs(east) > 2.1]).all()


def test_edges_fade_over_at_least_a_cell():
    with pytest.raises(TerrainError, match="at least a cell"):
        MergingParams(cell_m=0.04, feather_m=0.02)
