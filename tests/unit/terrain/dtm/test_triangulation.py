"""Gaps between measured cells filled by triangles."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.stop_dtm import (
    DtmParams,
    Gridding,
    build_dtm,
    fill_by_triangles,
)

UNSEEN, MEASURED, INTERPOLATED, OCCLUDED = GroundClass
PARAMS = DtmParams(max_relative_sigma=0.05, method=Gridding.TIN)


def thinned(scenes, share: float, rng) -> Dtm:
    """An exact model of a plane of which a share of the cells is known."""
    whole = scenes.dtm_of(scenes.tilted)
    known = rng.random(whole.grid.shape) < share
    seen = np.where(known, np.float32(1), np.float32(np.nan))
    return Dtm(
        whole.grid,
        whole.elevation * seen,
        whole.sigma_m * seen,
        whole.observations * known.astype(np.float32),
        np.where(known, MEASURED, UNSEEN).astype(np.uint8),
        np.float32(0.02) * seen,
    )


def test_triangles_of_a_plane_are_on_it(scenes, rng):
    filled = fill_by_triangles(thinned(scenes, 0.05, rng), gap_m=1.0, roughness=0.0)
    new = filled.ground == INTERPOLATED
    assert new.mean() > 0.8
    exact = scenes.dtm_of(scenes.tilted).elevation
    np.testing.assert_allclose(filled.elevation[new], exact[new], atol=1e-5)
    np.testing.assert_allclose(filled.sigma_m[new], 0.01, rtol=1e-3)
    np.testing.assert_allclose(filled.pose_sigma_m[new], 0.02, rtol=1e-3)


def test_ground_deviates_between_far_corners(scenes, rng):
    thin = thinned(scenes, 0.02, rng)
    flat, rough = (fill_by_triangles(thin, 1.0, roughness) for roughness in (0.0, 0.2))
    new = flat.ground == INTERPOLATED
    assert (rough.sigma_m[new] >= flat.sigma_m[new]).all()
    # a triangle of 0.3 m: 0.2 x 0.3 / 4 at the middle of its sides, and a third more at its own
    assert 0.01 < np.median(rough.sigma_m[new] - 0.01) < 0.02


@pytest.mark.parametrize("gap_m", [0.2, 0.5])
def test_no_gap_wider_than_allowed_is_bridged(scenes, gap_m):
    whole = scenes.dtm_of(scenes.tilted)
    col = np.arange(whole.grid.cols)
    known = np.broadcast_to((col < 40) | (col >= 50), whole.grid.shape)  # a gap of 0.44 m
    seen = np.where(known, np.float32(1), np.float32(np.nan))
    ground = np.where(known, MEASURED, UNSEEN).astype(np.uint8)
    cut = replace(whole, elevation=whole.elevation * seen, sigma_m=whole.sigma_m * seen)
    filled = fill_by_triangles(replace(cut, ground=ground), gap_m, 0.2)
    assert (filled.ground[:, 40:50] == INTERPOLATED).mean() == pytest.approx(
        float(gap_m > 0.44), abs=0.05
    )


def test_ground_hidden_by_a_boulder_is_not_bridged(scenes):
    dtm = build_dtm([scenes.view_of(scenes.with_boulder)], PARAMS)
    east, north = np.meshgrid(*dtm.grid.centres())
    hidden = (np.abs(east) < 0.4) & (north > 6.3) & (north < 8.5)
    assert (dtm.ground[hidden] == OCCLUDED).all()
    assert np.isnan(dtm.elevation[hidden]).all()


def test_on_open_ground_gridding_and_triangulation_agree(scenes):
    view = scenes.view_of(scenes.tilted)
    tin = build_dtm([view], PARAMS)
    mesh = build_dtm([view], replace(PARAMS, method=Gridding.GRID), tin.grid)
    both = (tin.ground == INTERPOLATED) & (mesh.ground == INTERPOLATED)
    assert both.sum() > 0.8 * (mesh.ground == INTERPOLATED).sum()
    np.testing.assert_allclose(tin.elevation[both], mesh.elevation[both], atol=0.01)


def test_too_few_cells_make_no_triangle(scenes, rng):
    thin = thinned(scenes, 0.0, rng)
    assert fill_by_triangles(thin, 1.0, 0.2) is thin
