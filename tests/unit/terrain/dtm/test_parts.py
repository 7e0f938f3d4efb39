"""Parts of a terrain model hold all of its elevations, each with the requested margin."""

from __future__ import annotations

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.photogrammetry.terrain.dtm.parts import coarse_elevation, manageable_cell_m, seen_parts
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import coarsen
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import open_dtm, write_dtm

SIDE = 5 * BLOCK


@pytest.fixture
def sparse(rng):
    """Two patches of ground far from each other."""
    elevation = np.full((SIDE, SIDE), np.nan, np.float32)
    elevation[10:300, 40:200] = rng.normal(size=(290, 160))
    elevation[1200:1250, 900:1270] = rng.normal(size=(50, 370))
    sigma = np.where(np.isfinite(elevation), np.float32(0.01), np.float32(np.nan))
    seen = np.isfinite(elevation)
    return Dtm(
        MapGrid(0.0, SIDE * 0.04, 0.04, SIDE, SIDE),
        elevation,
        sigma,
        seen.astype(np.float32),
        seen.astype(np.uint8),
        sigma / 2,
    )


@pytest.mark.parametrize("margin_m", [0.0, 1.2])
def test_parts_hold_every_elevation_once(sparse, margin_m):
    found = np.full(sparse.grid.shape, np.nan, np.float32)
    cells = 0
    for part in seen_parts(sparse, margin_m):
        assert np.isnan(found[part.own]).all()
        found[part.own] = part.dtm.elevation[part.inner]
        assert part.grid.bounds == pytest.approx(sparse.part(*part.own).grid.bounds)
        cells += found[part.own].size
    np.testing.assert_array_equal(found, sparse.elevation)
    assert cells == 4 * BLOCK**2  # of 25 blocks


def test_the_margin_ends_at_the_edge_of_the_model(sparse):
    first = next(seen_parts(sparse, 1.2))
    assert first.inner == (slice(0, 2 * BLOCK), slice(0, BLOCK))
    assert first.dtm.grid.shape == (2 * BLOCK + 30, BLOCK + 30)


def test_a_file_has_the_parts_of_the_model_in_it(sparse, tmp_path):
    crs = local_crs(LandingPoint("a site", 175.4729, -14.5692, 3_393_000.0, "a test"))
    write_dtm(tmp_path / "dtm.tif", sparse, crs)
    with open_dtm(tmp_path / "dtm.tif") as stored:
        assert stored.grid == sparse.grid
        assert (stored.block_steps() >= sparse.block_steps()).all()
        for rows, cols in [part.own for part in seen_parts(sparse, 0.36)]:
            one, other = stored.part(rows, cols), sparse.part(rows, cols)
            assert one.grid == other.grid
            for name in ("elevation", "sigma_m", "observations", "ground", "pose_sigma_m"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_coarse_cells_are_those_of_the_whole(sparse):
    whole, grid = coarsen(sparse.elevation, sparse.grid, 0.16)
    parts, same = coarse_elevation(sparse, 0.16)
    assert same == grid
    np.testing.assert_allclose(parts, whole, atol=1e-6)


def test_cells_are_doubled_until_the_ground_between_all_elevations_fits(sparse):
    cells = (1250 - 10) * (1270 - 40)
    assert manageable_cell_m(sparse, 0.04, cells) == 0.04
    assert manageable_cell_m(sparse, 0.04, cells - 1) == 0.08


def test_a_model_without_elevations_is_an_error(sparse):
    sparse.elevation[:] = np.nan
    with pytest.raises(TerrainError, match="has no elevations"):
        manageable_cell_m(sparse, 0.04, 100)
