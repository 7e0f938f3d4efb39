"""Orthophotos of surfaces with a known albedo."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, build_dtm
from solmap.photogrammetry.terrain.orthophoto.brightness import balance
from solmap.photogrammetry.terrain.orthophoto.mosaic import NO_SOURCE
from solmap.photogrammetry.terrain.orthophoto.rendering import OrthophotoParams
from tests.support.terrain.orthophotos import render_orthophoto

PARAMS = OrthophotoParams()
TERRAIN = DtmParams(max_relative_sigma=0.05)


def mottled(east, north):
    """Soil whose features are wider than the pixels of the test camera, 100 to 200 DN."""
    return 150 + 25 * np.sin(2 * np.pi * east / 0.6) + 25 * np.sin(2 * np.pi * north / 0.9)


def on_map(grid):
    return np.meshgrid(*grid.centres())


@pytest.fixture(scope="module")
def pan(scenes):
    """Three overlapping views of tilted, mottled ground, and its terrain model."""
    views = [
        scenes.view_of(scenes.tilted, azimuth_deg=a, pair=k, albedo=mottled)
        for k, a in enumerate((-30, 0, 30))
    ]
    return build_dtm(views, TERRAIN), views


@pytest.fixture(scope="module")
def orthophoto(pan):
    return render_orthophoto(*pan, PARAMS)


def near(orthophoto):
    """Cells whose pixels are finer than the features of the soil."""
    return np.isfinite(orthophoto.brightness) & (np.hypot(*on_map(orthophoto.grid)) < 4.0)


def test_features_are_at_their_coordinates(orthophoto):
    cells = near(orthophoto)
    error = orthophoto.brightness - mottled(*on_map(orthophoto.grid))
    # brightness changes by up to 260 DN a metre: two centimetres are 5 DN
    assert np.median(np.abs(error[cells])) < 2.0
    assert np.percentile(np.abs(error[cells]), 95) < 6.0


def test_ground_without_elevation_is_not_shown(pan, orthophoto):
    dtm, _ = pan
    east, north = on_map(orthophoto.grid)
    row = np.floor((dtm.grid.north - north) / dtm.grid.cell_m).astype(int)
    col = np.floor((east - dtm.grid.west) / dtm.grid.cell_m).astype(int)
    shown = np.isfinite(orthophoto.brightness)
    assert (dtm.ground[row[shown], col[shown]] != GroundClass.UNSEEN).all()
    assert shown.sum() * 0.01**2 > 0.97 * (dtm.ground != GroundClass.UNSEEN).sum() * 0.04**2


def at_sources(orthophoto):
    """Brightness in the middle of every cell of the sources."""
    ratio = round(orthophoto.source_grid.cell_m / orthophoto.grid.cell_m)
    return orthophoto.brightness[ratio // 2 :: ratio, ratio // 2 :: ratio]


def source_at(orthophoto):
    """The source of every cell of the orthophoto."""
    ratio = round(orthophoto.source_grid.cell_m / orthophoto.grid.cell_m)
    return orthophoto.source.repeat(ratio, axis=0).repeat(ratio, axis=1)


def test_every_cell_names_its_source_view(orthophoto):
    shown = np.isfinite(at_sources(orthophoto))
    assert (orthophoto.source != NO_SOURCE)[shown].all()
    assert set(np.unique(orthophoto.source[shown])) == {0, 1, 2}
    assert orthophoto.pair_ids == ("PAIR0", "PAIR1", "PAIR2")
    east, north = on_map(orthophoto.source_grid)
    range_m = np.hypot(east, north)
    far = shown & (range_m > 2.5) & (range_m < 4.0)
    for number, middle in enumerate((-30, 0, 30)):
        own = far & (np.abs(np.degrees(np.arctan2(east, north)) - middle) < 10)
        assert (orthophoto.source[own] == number).mean() > 0.99


def test_an_empty_cell_has_no_source(orthophoto):
    ratio = round(orthophoto.source_grid.cell_m / orthophoto.grid.cell_m)
    shown = np.isfinite(orthophoto.brightness)
    rows, cols = orthophoto.source.shape
    any_shown = shown.reshape(rows, ratio, cols, ratio).any(axis=(1, 3))
    assert (orthophoto.source[~any_shown] == NO_SOURCE).mean() > 0.999


def test_the_size_of_the_blocks_changes_nothing(pan, orthophoto):
    small = render_orthophoto(*pan, replace(PARAMS, block_cells=200))
    np.testing.assert_array_equal(small.source, orthophoto.source)
    np.testing.assert_allclose(small.brightness, orthophoto.brightness, atol=0.2)


def test_views_of_different_exposure_are_balanced(pan):
    dtm, views = pan
    exposed = [
        replace(view, image=view.image * np.float32(gain) + np.float32(offset))
        for view, gain, offset in zip(views, (1.0, 1.15, 0.9), (0.0, -8.0, 5.0), strict=True)
    ]
    orthophoto = render_orthophoto(dtm, exposed, PARAMS)
    cells = near(orthophoto)
    truth = mottled(*on_map(orthophoto.grid))
    levels, spreads = [], []
    for number in range(3):
        own = cells & (source_at(orthophoto) == number)
        slope, offset = np.polyfit(truth[own], orthophoto.brightness[own], 1)
        levels.append(slope * 150 + offset)
        spreads.append(slope)
    assert np.ptp(levels) < 1.5  # one percent of 150 DN
    assert np.ptp(spreads) < 0.05


def test_views_without_common_ground_keep_their_brightness():
    brightness = np.full((2, 400), np.nan, dtype=np.float32)
    brightness[0, :200], brightness[1, 200:] = 100.0, 180.0
    np.testing.assert_allclose(balance(brightness), [[1, 0], [1, 0]], atol=1e-9)


def test_ground_hidden_from_a_view_is_not_taken_from_it(scenes):
    """Two cameras stand on either side of a boulder; each hides what the other shows."""

    def painted(east, north):
        return np.where(scenes.with_boulder(east, north) > 0.25, 200.0, 100.0)

    south = scenes.view_of(scenes.with_boulder, albedo=painted)
    north = scenes.view_of(
        scenes.with_boulder, azimuth_deg=180, pair=1, camera=(0.0, 11.0, 1.5), albedo=painted
    )
    dtm = build_dtm([south, north], TERRAIN)
    orthophoto = render_orthophoto(dtm, [south, north], PARAMS)
    east, north_m = on_map(orthophoto.grid)
    behind = (np.abs(east) < 0.4) & (north_m > 6.2) & (north_m < 7.5)
    before = (np.abs(east) < 0.4) & (north_m > 3.5) & (north_m < 4.8)
    for strip, number in ((behind, 1), (before, 0)):
        assert np.isfinite(orthophoto.brightness[strip]).mean() > 0.9
        assert (source_at(orthophoto)[strip & np.isfinite(orthophoto.brightness)] == number).all()
        spread = np.nanpercentile(orthophoto.brightness[strip], (1, 99))
        assert np.ptp(spread) < 10.0  # ground alone: no ghost of the boulder


def test_the_stretch_contains_most_of_the_brightness(orthophoto):
    low, high = orthophoto.stretch
    shown = orthophoto.brightness[np.isfinite(orthophoto.brightness)]
    assert 0.98 < np.mean((shown >= low) & (shown <= high)) < 0.995


def test_an_empty_terrain_model_is_an_error(pan):
    dtm, views = pan
    nothing = np.full_like(dtm.elevation, np.nan)
    with pytest.raises(TerrainError, match="no known cell"):
        render_orthophoto(replace(dtm, elevation=nothing), views, PARAMS)


def test_the_map_extends_no_farther_than_its_views(scenes):
    view = scenes.view_of(scenes.level, azimuth_deg=90.0, albedo=mottled)
    wide = scenes.dtm_of(scenes.level, side=1024)
    orthophoto = render_orthophoto(wide, [view], PARAMS)
    assert orthophoto.grid.bounds[0] > wide.grid.bounds[0] + 10.0  # the view looks east
    whole = np.isfinite(orthophoto.brightness).sum() * 0.01**2
    assert whole > 20.0
    away = replace(view, lsl_from_pair=scenes.looking(90.0, 20.0, camera=(99.0, 0.0, 1.5))[1])
    with pytest.raises(TerrainError, match="none of the 1 views shows"):
        render_orthophoto(wide, [away], PARAMS)


def test_cells_coarser_than_the_terrain_are_an_error(pan):
    with pytest.raises(TerrainError, match="use finer orthophoto cells"):
        render_orthophoto(*pan, OrthophotoParams(cell_m=0.08))
