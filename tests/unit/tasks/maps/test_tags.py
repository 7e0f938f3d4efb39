"""Rasters carry tags of mission, sols, stops, cameras and local times."""

from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.synthetic.edr import label_bytes
from solmap.photogrammetry.synthetic.mission import (
    MissionPlan,
    exposures,
    mission_names,
    simulate_mission,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import write_raster
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.tags import ORIGIN_TAGS, origin_tags, raster_tags

PLAN = MissionPlan(stops=2, distance_m=20.0, gaps=0, control_every=0)
LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
GRID = MapGrid(0.0, 0.32, 0.04, 8, 8)


@pytest.fixture(scope="module")
def images():
    """Exposures of the first stop and of the second, each with its label."""
    mission = simulate_mission(np.random.default_rng(1), PLAN, names=mission_names(PLAN))
    pairs = list(exposures(mission, PLAN))
    return [one for pair in (*pairs[:3], *pairs[-3:]) for one in pair]


@pytest.fixture
def store(tmp_path: Path) -> ProductStore:
    return ProductStore.open(tmp_path)


def keep(exposure, store):
    scope = Scope(ScopeLevel.IMAGE, exposure.product_id.lower())
    recipe = Recipe(ProductKind.IMAGE, scope)
    return store.make(recipe, lambda path: path.write_bytes(label_bytes(exposure)))


def raster_of(inputs, store, kind=ProductKind.DTM):
    recipe = Recipe(kind, Scope(ScopeLevel.STOP, "mer2-site0010-drive0000"), tuple(inputs))

    def write(path):
        bands = {"elevation": np.zeros(GRID.shape, np.float32)}
        write_raster(path, GRID, bands, local_crs(LANDING), tags=raster_tags(recipe, store))

    return store.make(recipe, write)


def test_a_raster_has_the_tags_of_its_images(images, store):
    of_stop = [one for one in images if one.stop == images[0].stop]
    tags = origin_tags([keep(one, store) for one in of_stop], store)
    assert tags["MISSION"] == "MER2"
    assert tags["SOL"] == str(of_stop[0].sol)
    assert (tags["SITE"], tags["DRIVE"]) == (str(of_stop[0].stop.site), str(of_stop[0].stop.drive))
    assert tags["INSTRUMENT"] == "NAVCAM"
    first, *last = tags["LOCAL_TIME"].split("/")
    assert len(first) == len("12:00:00")
    assert first < last[0] if last else True


def test_a_derived_product_has_the_tags_of_all_its_rasters(images, store):
    one = raster_of([keep(image, store) for image in images[:2]], store)
    other = raster_of([keep(image, store) for image in images[-2:]], store)
    both = origin_tags([one, other], store)
    assert both["DRIVE"].split() == sorted(
        {str(image.stop.drive) for image in (images[0], images[-1])}, key=int
    )
    slope = raster_of([one], store, ProductKind.SLOPE)
    assert origin_tags([slope], store) == origin_tags([one], store)
    assert set(both) == set(ORIGIN_TAGS)


def test_a_raster_without_images_has_no_such_tags(store):
    assert origin_tags([raster_of([], store)], store) == {}
