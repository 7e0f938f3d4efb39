"""The STAC catalogue of a small store, held against the schemas that pystac carries with it."""

import json
from datetime import UTC, datetime

import numpy as np
import pystac
import pytest
from pystac.errors import STACValidationError
from pystac.extensions.classification import ClassificationExtension
from pystac.extensions.projection import ProjectionExtension
from pystac.extensions.raster import RasterExtension
from pystac.validation import JsonSchemaSTACValidator
from pystac.validation.local_validator import get_local_schema_cache

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.crs import LandingPoint, local_crs, lon_lat
from solmap.products.formats.raster.orthophoto import write_brightness_blocks, write_sources
from solmap.products.formats.raster.raster import write_raster
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.reports.stac import (
    PROCESSING,
    SOLAR_SYSTEM,
    AcquisitionTimes,
    write_catalogue,
    write_items,
)
from solmap.products.store.product_store import ProductStore

LANDING = LandingPoint("floor of Gusev", 175.4729, -14.5692, 3_393_000.0, "a test")
GUSEV = MissionEntry("MER2", "Spirit, Gusev crater", LANDING, None)
GRID = MapGrid.covering((-5.0, -5.0, 5.0, 15.0), 0.04)
STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0064")
CRS = local_crs(LANDING)
TAKEN = AcquisitionTimes(
    datetime(2004, 6, 11, 10, tzinfo=UTC), datetime(2004, 6, 11, 10, 40, tzinfo=UTC)
)


def slope(path):
    write_raster(path, GRID, {"slope": np.ones(GRID.shape, np.float32)}, CRS, unit="degree")


def sources(path):
    source = np.ones(GRID.shape, np.uint8)
    write_sources(path, GRID, source, ("2N140000001", "2N140000002"), CRS)


def colour(path):
    piece = (0, 0, np.full((3, 256, 256), 7.0, np.float32))
    write_brightness_blocks(path, GRID, [piece], CRS, stretches=[(0.0, 10.0)] * 3)


def contours(path):
    line = Feature("LineString", np.array([[0.0, 0.0, 1.0], [1.0, 2.0, 1.0]]))
    write_features(path, [line], LANDING)


@pytest.fixture
def store(tmp_path):
    """A store with four layers, and what was written of them."""
    store = ProductStore.open(tmp_path)
    layers = []
    for kind, write in (
        (ProductKind.SLOPE, slope),
        (ProductKind.SOURCES, sources),
        (ProductKind.COLOUR, colour),
        (ProductKind.CONTOURS, contours),
    ):
        ref = store.make(Recipe(kind, STOP), write)
        is_raster = kind is not ProductKind.CONTOURS
        layers.append(
            Layer(
                ref,
                "MER2",
                str(kind).title(),
                "raster" if is_raster else "vector",
                GRID.bounds if is_raster else (0.0, 0.0, 1.0, 2.0),
                GRID.cell_m if is_raster else None,
                None,
                None,
                (156,),
                store.made_at(ref),
            )
        )
    write_items([(layer, TAKEN) for layer in layers], GUSEV, store)
    write_catalogue([GUSEV], layers, TAKEN, store)
    return store


def catalogue_of(store):
    return pystac.Catalog.from_file(str(store.root / "stac" / "catalog.json"))


class Offline(JsonSchemaSTACValidator):
    """The schemas in pystac: the core of STAC 1.1 and GeoJSON, none of the extensions."""

    def __init__(self):
        super().__init__()
        self.schema_cache = get_local_schema_cache()

    def validate_extension(self, *_args, **_kwargs):
        """Extensions' schemas are only on the web; their fields have tests of their own."""


def test_everything_is_valid_stac(store):
    catalogue = catalogue_of(store)
    collection = next(catalogue.get_children())
    for thing in (catalogue, collection, *collection.get_items()):
        assert thing.validate(Offline())


def test_an_invalid_item_is_detected(store):
    slope_item = item(store, "slope")
    slope_item.geometry = {"type": "Polygon", "coordinates": "around the lander"}
    with pytest.raises(STACValidationError, match="slope"):
        slope_item.validate(Offline())


def test_the_catalogue_links_to_every_item_and_its_file(store):
    collection = next(catalogue_of(store).get_children())
    assert collection.id == "MER2"
    items = list(collection.get_items())
    assert {item.id.rsplit("-", 1)[1] for item in items} == {
        "slope",
        "sources",
        "colour",
        "contours",
    }
    for item in items:
        for asset in item.assets.values():
            assert (store.root / "stac" / "MER2" / asset.href).resolve().is_file()
        assert item.get_root().id == "solmap"
        assert item.get_collection().id == "MER2"


def test_layers_without_features_still_make_a_catalogue(tmp_path):
    store = ProductStore.open(tmp_path)
    recipe = Recipe(ProductKind.CONTOURS, STOP)
    ref = store.make(recipe, lambda path: write_features(path, [], LANDING))
    nowhere = (0.0, 0.0, 0.0, 0.0)
    made = store.made_at(ref)
    flat = Layer(ref, "MER2", "Contours", "vector", nowhere, None, None, None, (156,), made)
    write_catalogue([GUSEV], [flat], TAKEN, store)
    collection = next(catalogue_of(store).get_children())
    west, south, _, _ = collection.extent.spatial.bboxes[0]
    assert (west, south) == pytest.approx((LANDING.longitude, LANDING.latitude), abs=1e-3)


def item(store, kind):
    path = store.root / "stac" / "MER2" / f"{STOP}-{kind}.json"
    return pystac.Item.from_file(str(path))


def test_an_item_has_the_place_of_its_cells_on_mars(store):
    slope_item = item(store, "slope")
    longitude, latitude = lon_lat(LANDING, np.array([GRID.bounds[0]]), np.array([GRID.bounds[1]]))
    np.testing.assert_allclose(slope_item.bbox[:2], [longitude[0], latitude[0]], atol=1e-9)
    assert slope_item.properties["ssys:targets"] == ["Mars"]
    assert SOLAR_SYSTEM in slope_item.stac_extensions
    projection = ProjectionExtension.ext(slope_item)
    assert projection.shape == list(GRID.shape)
    assert projection.transform == [0.04, 0, GRID.west, 0, -0.04, GRID.north]
    assert "Orthographic" in projection.wkt2
    assert projection.code is None


def test_an_item_gives_the_times_of_its_images_and_its_origin(store):
    slope_item = item(store, "slope")
    assert slope_item.common_metadata.start_datetime == TAKEN.first
    assert slope_item.common_metadata.end_datetime == TAKEN.last
    assert PROCESSING in slope_item.stac_extensions
    assert set(slope_item.properties["processing:software"]) == {"solmap"}
    assert "science version" in slope_item.properties["processing:lineage"]
    notes = slope_item.assets["provenance"].href
    recipe = json.loads((store.root / "stac" / "MER2" / notes).read_text())["recipe"]
    assert recipe["kind"] == "slope"


def test_bands_have_names_units_and_scale_to_true_values(store):
    (band,) = RasterExtension.ext(item(store, "slope").assets["data"]).bands
    assert (band.unit, band.nodata, band.data_type) == ("degree", "nan", "float32")
    asset = item(store, "colour").assets["data"]
    assert [band["name"] for band in asset.extra_fields["bands"]] == ["red", "green", "blue"]
    for band in RasterExtension.ext(asset).bands:
        assert band.scale * 255 + band.offset == pytest.approx(10.0)
        assert band.nodata == 0


def test_classes_have_names_and_colours(store):
    classes = ClassificationExtension.ext(item(store, "sources").assets["data"]).classes
    assert [(c.value, c.name) for c in classes] == [(1, "2N140000001"), (2, "2N140000002")]
    assert all(len(c.color_hint) == 6 for c in classes)


def test_a_new_version_of_a_layer_replaces_its_item(store):
    ref = store.make(Recipe(ProductKind.SLOPE, STOP, params="other"), slope)
    layer = Layer(
        ref,
        "MER2",
        "Slope",
        "raster",
        GRID.bounds,
        0.04,
        None,
        None,
        (156,),
        "2026-01-01T00:00:00+00:00",
    )
    write_items([(layer, TAKEN)], GUSEV, store)
    assert item(store, "slope").properties["solmap:digest"] == ref.digest
    assert len(list((store.root / "stac" / "MER2").glob("*slope*"))) == 1
