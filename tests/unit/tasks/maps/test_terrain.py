"""The tasks that derive maps from a terrain model."""

import json

import numpy as np
import pytest

from solmap.config.pipeline import PipelineConfig
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.insolation.maps import HavenParams, InsolationParams
from solmap.photogrammetry.terrain.traversability.hazard import Hazard
from solmap.photogrammetry.terrain.visibility.viewshed import Sight
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.raster import open_dtm, open_raster, read_raster, write_dtm
from solmap.products.formats.vector.geojson import read_features
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.dtms import clear_dtms, read_stop_dtm, terrain_of
from solmap.tasks.maps.suitability import (
    Eye,
    highest_camera,
    map_hazards,
    map_insolation,
    map_viewshed,
)
from solmap.tasks.maps.terrain import RELIEF, map_relief
from solmap.tasks.mission.publish import RASTERS, TITLES
from solmap.tasks.network.orientations import Orientation, OrientedPair

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
CONFIG = PipelineConfig()
TILT = np.radians(12.0)


@pytest.fixture
def store(tmp_path) -> ProductStore:
    return ProductStore.open(tmp_path)


@pytest.fixture
def dtm(store) -> ProductRef:
    """Ground that falls to the north by 12 degrees, with a rock of half a metre."""
    grid = MapGrid(-10.24, 10.24, 0.04, 512, 512)
    east, north = np.meshgrid(*grid.centres())
    rock = (np.abs(east - 5) < 0.3) & (np.abs(north) < 0.3)
    made = Dtm(
        grid=grid,
        elevation=(-np.tan(TILT) * north + np.where(rock, 0.5, 0.0)).astype(np.float32),
        sigma_m=np.full(grid.shape, 0.01, np.float32),
        observations=np.ones(grid.shape, np.float32),
        ground=np.full(grid.shape, GroundClass.MEASURED, np.uint8),
    )
    recipe = Recipe(ProductKind.DTM, Scope(ScopeLevel.STOP, "mer2-site0010-drive0064"))
    return store.make(recipe, lambda path: write_dtm(path, made, local_crs(LANDING)))


def test_the_terrain_model_of_a_stop_is_read_once_until_the_end_of_the_sol(store, dtm):
    rows, cols = slice(100, 300), slice(0, 512)
    with terrain_of(dtm, store) as kept, open_dtm(store.path(dtm)) as stored:
        part = kept.part(rows, cols)
        np.testing.assert_array_equal(part.elevation, stored.part(rows, cols).elevation)
        np.testing.assert_array_equal(kept.block_steps(), stored.block_steps())
    with pytest.raises(ValueError, match="read-only"):
        part.elevation[0, 0] = 0.0
    store.path(dtm).unlink()
    assert read_stop_dtm(dtm, store).grid == kept.grid
    clear_dtms()
    with pytest.raises(ProductNotFoundError):
        read_stop_dtm(dtm, store)


def at(store, ref, east, north):
    """Values of all bands at a place."""
    grid, bands = read_raster(store.path(ref))
    row = int((grid.north - north) / grid.cell_m)
    col = int((east - grid.west) / grid.cell_m)
    return {name: float(band[row, col]) for name, band in bands.items()}


def test_relief_is_mapped_at_a_stated_baseline(store, dtm):
    made = {ref.kind: ref for ref in map_relief.fn(dtm, CONFIG.slope, LANDING, store)}
    assert set(made) == set(RELIEF)
    slope = at(store, made[ProductKind.SLOPE], -5, 2)
    assert slope["slope"] == pytest.approx(12.0, abs=0.01)
    assert 0.05 < slope["standard_deviation"] < 1.0
    assert at(store, made[ProductKind.ASPECT], -5, 2)["aspect"] % 360 == pytest.approx(0, abs=0.1)
    tilt = at(store, made[ProductKind.NORTHERLY_TILT], -5, 2)["northerly_tilt"]
    assert tilt == pytest.approx(12.0, abs=0.01)
    assert at(store, made[ProductKind.ROUGHNESS], -5, 2)["roughness"] < 1e-3
    assert at(store, made[ProductKind.ROUGHNESS], 5, 0.5)["roughness"] > 0.1
    with open_raster(store.path(made[ProductKind.SLOPE])) as dataset:
        assert dataset.tags()["BASELINE_M"] == "1.1"
        assert dataset.units[0] == "degree"


def test_insolation_and_havens_are_those_of_the_local_winter(store, dtm):
    params = InsolationParams(cell_m=0.32)
    light, havens = map_insolation.fn(dtm, params, HavenParams(), LANDING, store)
    with open_raster(store.path(light)) as dataset:
        tags = dataset.tags()
        assert dataset.units[0] == "Wh/m2/sol"
    assert tags["LS_DEG"] == "90"
    gain = at(store, light, -5, 2)["insolation_ls090"] / float(tags["LEVEL_WH_M2"])
    assert gain == pytest.approx(1.089, abs=0.004)  # of an endless slope of 12 degrees
    collection = read_features(store.path(havens))
    (first, *_) = collection.features
    assert first.properties["area_m2"] > 200
    assert first.properties["over_level_ground"] == pytest.approx(gain, abs=0.01)
    assert first.properties["tilt_to_sun_deg"] == pytest.approx(12.0, abs=0.3)
    assert collection.tags["LS_DEG"] == "90"
    provenance = json.loads(json.dumps(store.provenance(havens)))
    assert "HavenParams" in json.dumps(provenance)


def test_several_seasons_are_bands_of_one_map(store, dtm):
    params = InsolationParams(ls_deg=(90.0, 270.0), cell_m=0.64)
    light, _ = map_insolation.fn(dtm, params, HavenParams(), LANDING, store)
    bands = at(store, light, -5, 2)
    assert list(bands) == ["insolation_ls090", "insolation_ls270", "sky_view"]
    assert bands["insolation_ls270"] > 1.5 * bands["insolation_ls090"]


def test_hazards_are_mapped_with_their_names(store, dtm):
    ref = map_hazards.fn(dtm, CONFIG.hazard, LANDING, store)
    assert at(store, ref, 5, 0.5)["hazard"] == Hazard.STEP
    assert at(store, ref, -5, 2)["hazard"] == Hazard.TRAVERSABLE
    with open_raster(store.path(ref)) as dataset:
        assert "step too high" in dataset.tags()["CLASSES"]
        assert dataset.nodata == 0


def test_the_viewshed_of_a_stop_is_that_of_its_highest_camera(store, dtm):
    pairs = tuple(
        OrientedPair(
            None, Orientation(name, tuple(np.eye(3).ravel()), (1.0, 2.0, down), (0.0,) * 36)
        )
        for name, down in (("hazcam", -0.5), ("navcam", -1.5))
    )
    eye = highest_camera(pairs)
    assert eye == Eye(2.0, 1.0, 1.5)
    ref = map_viewshed.fn(dtm, Eye(-5.0, 0.0, 1.5), CONFIG.viewshed, LANDING, store)
    assert at(store, ref, 0, 0)["sight"] == Sight.VISIBLE
    assert at(store, ref, 6, 0)["sight"] == Sight.HIDDEN  # behind the rock
    with open_raster(store.path(ref)) as dataset:
        assert dataset.tags()["EYE_EAST_NORTH_UP_M"] == "-5.0 0.0 1.5"


def test_terrain_products_can_be_published():
    kinds = {*RELIEF, ProductKind.INSOLATION, ProductKind.HAZARD, ProductKind.VIEWSHED}
    assert kinds <= RASTERS
    assert {*kinds, ProductKind.HAVENS} <= set(TITLES)
    assert ProductKind.HAVENS not in RASTERS
