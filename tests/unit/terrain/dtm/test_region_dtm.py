"""Many stops' models of the same ground as one, and which stops are mapped together."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.region_dtm import (
    RegionParams,
    SeamCounter,
    StopTerrain,
    fuse_block,
    regions_of,
)
from solmap.photogrammetry.terrain.dtm.resampling import coarser_dtm, finer_dtm

UNSEEN, MEASURED, INTERPOLATED, OCCLUDED = GroundClass
PARAMS = RegionParams(cell_m=0.08)
SIDE = 256


def known_in(dtm: Dtm, cells: np.ndarray, raised_m=0.0, sigma_m=0.01, pose_m=0.0) -> Dtm:
    """A model with some measured cells only."""
    seen = np.where(cells, np.float32(1), np.float32(np.nan))
    return Dtm(
        dtm.grid,
        (dtm.elevation + np.float32(raised_m)) * seen,
        np.float32(np.hypot(sigma_m, pose_m)) * seen,
        np.where(cells, np.float32(3), np.float32(0)),
        np.where(cells, MEASURED, UNSEEN).astype(np.uint8),
        np.float32(pose_m) * seen,
    )


@pytest.fixture(scope="module")
def ground(scenes) -> Dtm:
    return scenes.dtm_of(scenes.tilted, SIDE, 0.08)


@pytest.fixture(scope="module")
def halves(ground):
    """Two stops that share the middle third; the second one stands 0.2 m too high."""
    col = np.arange(SIDE)[None, :] + np.zeros((SIDE, 1))
    west = known_in(ground, col < 2 * SIDE / 3, pose_m=0.05)
    east = known_in(ground, col > SIDE / 3, raised_m=0.2, pose_m=0.1)
    return StopTerrain(4, (-5.0, 0.0), west), StopTerrain(7, (5.0, 0.0), east)


def test_the_border_of_a_stop_has_no_step(halves, ground):
    block = fuse_block(halves, PARAMS)
    off = block.dtm.elevation - ground.elevation
    np.testing.assert_allclose(off[:, :60], 0.0, atol=1e-5)
    np.testing.assert_allclose(off[:, -60:], 0.2, atol=1e-5)
    step = np.abs(np.diff(off, axis=1)).max()
    # 0.2 m over a width of 2 m are 8 mm a cell; squared tapers are at most twice as steep
    assert step < 2.5 * 0.2 * PARAMS.cell_m / PARAMS.feather_m


def test_the_more_certain_stop_has_more_weight(ground):
    everywhere = np.ones((SIDE, SIDE), dtype=bool)
    sure = StopTerrain(0, (0.0, 0.0), known_in(ground, everywhere, pose_m=0.03))
    unsure = StopTerrain(1, (0.0, 0.0), known_in(ground, everywhere, raised_m=1.0, pose_m=0.3))
    block = fuse_block([sure, unsure], PARAMS)
    off = np.median(block.dtm.elevation - ground.elevation)
    assert off == pytest.approx(0.001 / (0.001 + 0.0901), abs=0.002)  # shares by 1/variance


def test_independent_errors_average_out_and_those_of_poses_do_not(ground):
    everywhere = np.ones((SIDE, SIDE), dtype=bool)
    stops = [
        StopTerrain(k, (0.0, 0.0), known_in(ground, everywhere, sigma_m=0.1, pose_m=0.05))
        for k in range(4)
    ]
    made = fuse_block(stops, PARAMS).dtm
    np.testing.assert_allclose(made.pose_sigma_m, 0.05, rtol=1e-3)
    np.testing.assert_allclose(made.sigma_m, np.hypot(0.1 / 2, 0.05), rtol=1e-3)


def test_stops_that_disagree_beyond_their_sigmas_make_a_cell_less_certain(ground):
    everywhere = np.ones((SIDE, SIDE), dtype=bool)
    stops = [
        StopTerrain(k, (0.0, 0.0), known_in(ground, everywhere, raised_m=0.5 * k)) for k in range(2)
    ]
    made = fuse_block(stops, PARAMS)
    assert np.median(made.dtm.sigma_m) > 0.2
    assert np.median(made.seam_m) == pytest.approx(0.5, abs=1e-4)
    assert np.median(made.seam_sigmas) == pytest.approx(0.5 / np.hypot(0.01, 0.01), rel=0.01)


def test_seams_are_only_where_two_stops_see(halves):
    block = fuse_block(halves, PARAMS)
    shared = np.isfinite(halves[0].dtm.elevation) & np.isfinite(halves[1].dtm.elevation)
    np.testing.assert_array_equal(np.isfinite(block.seam_m), shared)
    np.testing.assert_allclose(block.seam_m[shared], 0.2, atol=1e-5)


def test_every_cell_names_the_nearest_stop_that_measured_it(halves):
    nearest = fuse_block(halves, PARAMS).nearest
    assert (nearest[:, : SIDE // 3] == 4).all()
    assert (nearest[:, -SIDE // 3 :] == 7).all()
    assert (nearest[:, SIDE // 3 + 1 : SIDE // 2] == 4).all()  # both have it; the first is nearer


def test_measured_and_occluded_cells_of_stops_are_combined(ground):
    some = np.zeros((SIDE, SIDE), dtype=bool)
    some[:100] = True
    measured = known_in(ground, some)
    hidden = known_in(ground, ~some & False)
    marked = replace(hidden, ground=np.full_like(hidden.ground, OCCLUDED))
    made = fuse_block(
        [StopTerrain(0, (0.0, 0.0), measured), StopTerrain(1, (9.0, 9.0), marked)], PARAMS
    )
    assert (made.dtm.ground[:100] == MEASURED).all()
    assert (made.dtm.ground[100:] == OCCLUDED).all()
    assert np.isnan(made.dtm.elevation[100:]).all()


def test_the_statistics_of_two_stops_are_those_of_their_common_cells(ground, rng):
    everywhere = np.ones((SIDE, SIDE), dtype=bool)
    one = known_in(ground, everywhere)
    other = replace(
        one, elevation=(one.elevation + rng.normal(0.03, 0.1, (SIDE, SIDE))).astype(np.float32)
    )
    stops = [StopTerrain(2, (0.0, 0.0), one), StopTerrain(5, (1.0, 1.0), other)]
    counter = SeamCounter()
    counter.add(stops, (slice(0, 128), slice(None)))
    counter.add(stops, (slice(128, SIDE), slice(None)))
    (seam,) = counter.seams()
    apart = np.abs(other.elevation - one.elevation)
    assert seam.stops == (2, 5)
    assert seam.cells == SIDE**2
    assert seam.mean_m == pytest.approx(0.03, abs=0.002)
    assert seam.median_m == pytest.approx(np.median(apart), rel=0.02)
    assert seam.p90_m == pytest.approx(np.percentile(apart, 90), rel=0.02)
    assert seam.p90_sigmas == pytest.approx(seam.p90_m / np.hypot(0.01, 0.01), rel=0.03)


def test_coarser_cells_are_means_of_the_known_ones(scenes):
    dtm = scenes.dtm_of(scenes.tilted, 128, 0.04)
    dtm.elevation[0, 0] = np.nan
    dtm.ground[0, 0] = OCCLUDED
    made = coarser_dtm(dtm, 2)
    exact = scenes.dtm_of(scenes.tilted, 64, 0.08)
    assert made.grid == exact.grid
    np.testing.assert_allclose(made.elevation[1:, 1:], exact.elevation[1:, 1:], atol=1e-6)
    assert np.isfinite(made.elevation[0, 0])
    assert made.ground[0, 0] == MEASURED
    np.testing.assert_allclose(made.observations, 4.0)
    np.testing.assert_allclose(made.sigma_m, 0.01, rtol=1e-6)


def test_finer_cells_of_a_plane_are_on_it(scenes):
    made = finer_dtm(scenes.dtm_of(scenes.tilted, 64, 0.64), 8)
    exact = scenes.dtm_of(scenes.tilted, 512, 0.08)
    inner = slice(8, -8)
    np.testing.assert_allclose(
        made.elevation[inner, inner], exact.elevation[inner, inner], atol=1e-4
    )


def test_edges_without_a_fade_width_are_refused():
    with pytest.raises(TerrainError, match=r"feather_m must be at least a cell of 0\.08 m"):
        RegionParams(feather_m=0.01)


def around(east: float, north: float, half: float = 30.0) -> tuple[float, float, float, float]:
    return (east - half, north - half, east + half, north + half)


def test_stops_with_common_ground_form_one_region_and_distant_ones_another():
    stops = [around(0.0, 0.0), around(20.0, 0.0), around(70.0, 10.0), around(500.0, 0.0)]
    assert regions_of(stops, 700.0) == [[0, 1, 2], [3]]


def test_a_region_is_limited_in_size():
    stops = [around(40.0 * k, 0.0) for k in range(6)]
    assert regions_of(stops, 150.0) == [[0, 1, 2], [3, 4, 5]]


places = st.lists(st.tuples(st.floats(-300, 300), st.floats(-300, 300)), max_size=12)


@given(places=places, more=places)
def test_a_longer_traverse_changes_the_last_region_at_most(places, more):
    before = regions_of([around(*place) for place in places], 200.0)
    after = regions_of([around(*place) for place in places + more], 200.0)
    assert after[: max(0, len(before) - 1)] == before[:-1]
    if before:
        assert after[len(before) - 1][: len(before[-1])] == before[-1]


@given(places=places)
def test_every_stop_is_in_one_region(places):
    regions = regions_of([around(*place) for place in places], 200.0)
    assert sorted(k for region in regions for k in region) == list(range(len(places)))
