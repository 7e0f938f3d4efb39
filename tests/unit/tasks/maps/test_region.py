"""The region as a product: made from the models of stops, and remade only when one changed."""

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.region_dtm import RegionParams
from solmap.photogrammetry.terrain.orthophoto.merging import MergingParams
from solmap.photogrammetry.terrain.relief.contours import RegionContourParams
from solmap.photogrammetry.terrain.relief.slope import HillshadeParams
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import grid_of, open_raster, read_dtm, write_dtm
from solmap.products.model import REGION_KINDS, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.region import fuse_region, merge_orthophotos, seam_notes
from solmap.tasks.maps.terrain import shade_relief, trace_contours
from solmap.tasks.mission.publish import RASTERS, TITLES
from solmap.tasks.network.orientations import Orientation

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
CRS = local_crs(LANDING)
PARAMS = RegionParams()


@pytest.fixture
def store(tmp_path) -> ProductStore:
    return ProductStore.open(tmp_path)


def stop(store: ProductStore, drive: int, east: float, raised_m: float) -> ProductRef:
    """A square of ground 20 m wide around a camera, a plane that is so much too high."""
    grid = MapGrid.covering((east - 9.0, -9.0, east + 9.0, 9.0), 0.04)
    x, _ = np.meshgrid(*grid.centres())
    made = Dtm(
        grid,
        (0.1 * x + raised_m).astype(np.float32),
        np.full(grid.shape, 0.03, np.float32),
        np.ones(grid.shape, np.float32),
        np.full(grid.shape, GroundClass.MEASURED, np.uint8),
        np.full(grid.shape, 0.02, np.float32),
    )
    looking = Orientation(f"P{drive}", tuple(np.eye(3).ravel()), (0.0, east, -1.5))
    scope = Scope(ScopeLevel.STOP, f"mer2-site0010-drive{drive:04d}")
    recipe = Recipe(ProductKind.DTM, scope, (), ((looking,), raised_m))
    return store.make(recipe, lambda path: write_dtm(path, made, CRS))


@pytest.fixture
def stops(store) -> list[ProductRef]:
    return [stop(store, 0, 0.0, 0.0), stop(store, 64, 12.0, 0.05)]


def fuse(store, stops) -> tuple[ProductRef, ProductRef]:
    return fuse_region.fn("MER2", stops, PARAMS, LANDING, store)


def test_a_region_is_named_after_its_first_stop_in_any_order(store, stops):
    assert fuse(store, stops) == fuse(store, stops[::-1])
    dtm, seams = fuse(store, stops)
    assert dtm.scope.name == seams.scope.name == "mer2-region-site0010-drive0000"
    assert (dtm.kind, seams.kind) == (ProductKind.REGION_DTM, ProductKind.REGION_SEAMS)


def test_a_region_is_made_once_and_remade_when_a_stop_changed(store, stops):
    first = fuse(store, stops)
    made = store.path(first[0]).stat().st_mtime_ns
    assert fuse(store, stops) == first
    assert store.path(first[0]).stat().st_mtime_ns == made
    moved = fuse(store, [stops[0], stop(store, 64, 12.0, 0.2)])
    assert moved[0].digest != first[0].digest


def test_the_disagreement_of_stops_is_reported(store, stops):
    (line,) = seam_notes(fuse(store, stops)[1], store)
    assert line.startswith(
        "mer2-site0010-drive0000 and mer2-site0010-drive0064 disagree by 0.050 m (median; 90 %: 0."
    )
    sigmas = float(line.split(" m), ")[1].split(" of their sigmas")[0])
    assert sigmas == pytest.approx(0.05 / (0.03 * np.sqrt(2)), abs=0.05)


def test_a_cell_names_the_stop_whose_cameras_are_nearest(store, stops):
    with open_raster(store.path(fuse(store, stops)[0])) as dataset:
        nearest = dataset.read(list(dataset.descriptions).index("nearest_stop") + 1)
        row, col = dataset.index(5.5, 0.0)
        assert nearest[row, col] == 0
        row, col = dataset.index(6.5, 0.0)
        assert nearest[row, col] == 1
        assert "mer2-site0010-drive0064" in dataset.tags()["STOPS"]


def test_a_region_is_mapped_by_the_tasks_of_stops_under_names_of_its_own(store, stops):
    dtm, _ = fuse(store, stops)
    shade = shade_relief.fn(dtm, HillshadeParams(), LANDING, store)
    lines = trace_contours.fn(dtm, RegionContourParams(), LANDING, store)
    assert (shade.kind, lines.kind) == (ProductKind.REGION_HILLSHADE, ProductKind.REGION_CONTOURS)
    assert np.isfinite(read_dtm(store.path(dtm)).elevation).any()


def shown(
    store: ProductStore,
    drive: int,
    east: float,
    gain: float,
    offset: float,
    cell_m: float = 0.01,
) -> ProductRef:
    """The orthophoto of a square of ground 20 m wide, in a light of its own."""
    grid = MapGrid.covering((east - 9.0, -9.0, east + 9.0, 9.0), cell_m)
    brightness = (gain * ground(*np.meshgrid(*grid.centres())) + offset).astype(np.float32)
    looking = Orientation(f"P{drive}", tuple(np.eye(3).ravel()), (0.0, east, -1.5))
    scope = Scope(ScopeLevel.STOP, f"mer2-site0010-drive{drive:04d}")
    recipe = Recipe(ProductKind.ORTHOPHOTO, scope, (), ((looking,), gain))
    return store.make(recipe, lambda path: write_orthophoto(path, grid, brightness, CRS))


def ground(east, north):
    return 1000.0 + 200.0 * np.sin(1.7 * east) * np.sin(1.3 * north + 0.2 * east)


def test_orthophotos_of_stops_agree_in_the_region(store, stops):
    dtm, _ = fuse(store, stops)
    images = [shown(store, 0, 0.0, 1.0, 0.0), shown(store, 64, 12.0, 1.2, 90.0)]
    merged = merge_orthophotos.fn(dtm, images, MergingParams(), LANDING, store)
    assert (merged.kind, merged.scope) == (ProductKind.REGION_ORTHOPHOTO, dtm.scope)
    assert merged == merge_orthophotos.fn(dtm, images[::-1], MergingParams(), LANDING, store)
    with open_raster(store.path(merged)) as dataset:
        assert grid_of(dataset).cell_m == 0.02
        grey = dataset.read(1).astype(float)
        brightness = grey * dataset.scales[0] + dataset.offsets[0]
        truth = ground(*np.meshgrid(*grid_of(dataset).centres()))
        sides = [np.s_[:, : dataset.index(0.0, 0.0)[1]], np.s_[:, dataset.index(12.0, 0.0)[1] :]]
        inside = (grey > 1) & (grey < 255)
        fits = [np.polyfit(truth[s][inside[s]], brightness[s][inside[s]], 1) for s in sides]
    np.testing.assert_allclose(fits[0][0], fits[1][0], rtol=0.01)
    levels = [np.polyval(fit, 1000.0) for fit in fits]
    np.testing.assert_allclose(*levels, rtol=0.01)


def test_a_region_is_no_finer_than_its_coarsest_stop(store, stops):
    dtm, _ = fuse(store, stops)
    images = [shown(store, 0, 0.0, 1.0, 0.0), shown(store, 64, 12.0, 1.2, 90.0, cell_m=0.32)]
    merged = merge_orthophotos.fn(dtm, images, MergingParams(), LANDING, store)
    with open_raster(store.path(merged)) as dataset:
        assert grid_of(dataset).cell_m == 0.32
        assert (dataset.read(1) > 0).any()


def test_every_map_of_a_region_has_a_suffix_and_a_title():
    for kind in (*REGION_KINDS.values(), ProductKind.REGION_SEAMS):
        assert kind.suffix
        assert kind in TITLES
        assert (kind in RASTERS) == (kind.suffix == ".tif")
