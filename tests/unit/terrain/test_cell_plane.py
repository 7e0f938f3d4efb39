"""Strike and dip of ground inside an outline on a terrain model."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.measure.strike_dip import (
    CellPlaneParams,
    attitude,
    plane_of_cells,
)

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


def test_errors_are_as_large_as_stated(scenes, rng):
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


def test_what_all_cells_share_is_no_scatter_but_the_tilt_counts(scenes):
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


def test_outlines_that_are_none_are_refused(scenes):
    dtm = scenes.dtm_of(slab)
    with pytest.raises(TerrainError, match="at least 3 corners, not 2"):
        plane_of_cells(dtm, OUTLINE[:2], PARAMS)
    with pytest.raises(TerrainError, match="crosses itself"):
        plane_of_cells(dtm, OUTLINE[[0, 2, 1, 3]], PARAMS)
    with pytest.raises(TerrainError, match=r"no measured ground .* from -2\.6 to 2\.6 m east"):
        plane_of_cells(dtm, OUTLINE + 50.0, PARAMS)
