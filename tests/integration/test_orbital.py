"""An orbital image from its file to the base layer, on ground whose true place is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from rasterio.transform import Affine
from typer.testing import CliRunner

from solmap.config.landing import landing_site
from solmap.config.settings import Settings
from solmap.flows.cli import app
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import local_crs, lon_lat
from solmap.products.errors import ProductError
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import read_dtm, write_dtm
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel, untied_map
from solmap.tasks.mission.publish import publish
from tests.support.orbital_scenes import enlarged, middle_of, scene
from tests.support.product_readers import read_orthophoto

SITE = landing_site("MER2", Settings().landing_sites)
# as GDAL's users keep Mars: an equirectangular map of the sphere, not the local one
PLATE = CRS.from_proj4(
    f"+proj=eqc +lat_ts={SITE.landing.latitude} +lat_0={SITE.landing.latitude} "
    f"+lon_0={SITE.landing.longitude} +R={SITE.landing.radius_m} +units=m +no_defs"
)


@pytest.fixture(scope="module")
def hills():
    return middle_of(scene(109))


@pytest.fixture
def image(hills, tmp_path):
    file = tmp_path / "hirise.tif"
    write_image(file, hills.image.brightness, hills.image.grid)
    return file


def write_image(file, values, grid):
    low, high = np.percentile(values, (0.5, 99.5))
    place = Affine(grid.cell_m, 0, grid.west, 0, -grid.cell_m, grid.north)
    with rasterio.open(
        file, "w", driver="GTiff", width=grid.cols, height=grid.rows, count=1, dtype="uint8",
        crs=rasterio.CRS.from_wkt(PLATE.to_wkt()), transform=place,
    ) as dataset:  # fmt: skip
        dataset.write(np.clip(1 + 254 * (values - low) / (high - low), 1, 255).astype(np.uint8), 1)


@pytest.fixture
def store(hills, tmp_path):
    """A store in which the scene's ground is mapped."""
    workspace = Workspace.open(tmp_path / "store")
    ground, crs = hills.ground, local_crs(SITE.landing)
    shape = ground.grid.shape
    dtm = Dtm(
        ground.grid,
        ground.elevation,
        np.full(shape, 0.01, np.float32),
        np.ones(shape, np.float32),
        np.ones(shape, np.uint8),
    )
    scope = Scope(ScopeLevel.STOP, "mer2-site0010-drive0000")
    made = [
        workspace.store.make(
            Recipe(ProductKind.DTM, scope), lambda path: write_dtm(path, dtm, crs)
        ),
        workspace.store.make(
            Recipe(ProductKind.ORTHOPHOTO, scope),
            lambda path: write_orthophoto(path, ground.grid, ground.brightness, crs),
        ),
    ]
    entry = MissionEntry("MER2", SITE.title, SITE.landing, None)
    publish.fn(entry, [(ref, (155,)) for ref in made], (), (), workspace)
    return workspace


def added(image, workspace, *options):
    command = ["orbital", "add", str(image), "--store", str(workspace.store.root), *options]
    return CliRunner().invoke(app, command)


def test_an_image_in_another_crs_is_registered_and_drawn_at_its_true_place(hills, image, store):
    ran = added(image, store)
    assert ran.exit_code == 0, ran.output
    assert "moved by" in ran.output
    (ref,) = store.catalogue.pointers(ProductKind.ORBITAL_REGISTRATION)
    found = json.loads(store.store.path(ref).read_text())["correction"]
    off = np.hypot(found["east_m"] - hills.east_m, found["north_m"] - hills.north_m)
    assert off < 0.25
    assert found["rotation_deg"] == pytest.approx(hills.rotation_deg, abs=0.1)
    layer = next(k for k in store.catalogue.layers() if k.ref.kind is ProductKind.ORBITAL)
    assert layer.cell_m == 0.16
    grid, drawn = read_orthophoto(store.store.path(layer.ref))
    east, north = grid.centres()
    middle = np.ix_(np.abs(north) < 20, np.abs(east) < 20)
    assert np.isfinite(drawn[middle]).all()


def test_an_image_that_cannot_be_registered_keeps_its_georeference_and_states_it(
    hills, tmp_path, store, rng
):
    plain = tmp_path / "noise.tif"
    write_image(plain, 100 + 20 * rng.normal(size=hills.image.grid.shape), hills.image.grid)
    ran = added(plain, store)
    assert ran.exit_code == 0, ran.output
    assert "not registered" in ran.output


def test_the_georeference_may_be_trusted_without_registration(image, store):
    ran = added(image, store, "--as-claimed")
    assert ran.exit_code == 0, ran.output
    assert "where it claims to" in ran.output
    assert store.catalogue.pointers(ProductKind.ORBITAL_REGISTRATION) == []


def test_images_of_other_ground_and_missing_images_end_with_one_line(hills, tmp_path, store):
    far = tmp_path / "far.tif"
    grid = hills.image.grid
    moved = type(grid)(grid.west + 50_000, grid.north, grid.cell_m, grid.rows, grid.cols)
    write_image(far, hills.image.brightness, moved)
    ran = added(far, store)
    assert ran.exit_code == 1
    assert "does not show the mapped ground" in ran.output
    text = tmp_path / "notes.tif"
    text.write_text("no picture")
    ran = added(text, store)
    assert ran.exit_code == 1
    assert "notes.tif" in ran.output or "cannot be read" in ran.output


def untied(store):
    """The same ground on a map of site 10, which nothing ties to the lander."""
    catalogue = store.catalogue
    old = {layer.ref.kind: layer.ref for layer in catalogue.layers()}
    ground = read_dtm(store.store.path(old[ProductKind.DTM]))
    grid, brightness = read_orthophoto(store.store.path(old[ProductKind.ORTHOPHOTO]))
    name = untied_map("MER2", 10)
    site = landing_site(name, Settings().landing_sites)
    crs, scope = local_crs(site.landing), old[ProductKind.DTM].scope
    made = [
        store.store.make(
            Recipe(ProductKind.DTM, scope, params="untied"),
            lambda path: write_dtm(path, ground, crs),
        ),
        store.store.make(
            Recipe(ProductKind.ORTHOPHOTO, scope, params="untied"),
            lambda path: write_orthophoto(path, grid, brightness, crs),
        ),
    ]
    entry = MissionEntry(name, site.title, site.landing, None)
    publish.fn(entry, [(ref, (155,)) for ref in made], (), (), store)
    return name


def test_an_image_locates_a_map_that_is_not_tied_to_the_lander(hills, tmp_path, store):
    """Where the image has the ground, 200 m off where it is looked for."""
    from solmap.flows.external_data import (  # noqa: PLC0415 - imports Prefect
        OrbitalOptions,
        add_orbital,
        tie_by_image,
    )
    from solmap.tasks.mission.control import FrameParams  # noqa: PLC0415

    name, far_m = untied(store), (820.0, -1530.0)
    grid = hills.image.grid
    file = tmp_path / "hirise.tif"
    write_image(
        file,
        hills.image.brightness,
        replace(grid, west=grid.west + far_m[0], north=grid.north + far_m[1]),
    )
    near = tuple(float(k[0]) for k in lon_lat(SITE.landing, far_m[0] - 150.0, far_m[1] + 130.0))
    options = OrbitalOptions(control=FrameParams(shift_m=5.0), near_deg=near)
    line, vectors = tie_by_image(file, name, store.store.root, options)
    (solution,) = vectors.solutions
    assert (vectors.mission, solution.counter, solution.reference_site) == ("MER2", (10,), 0)
    # the image claims c + t of what lies at c, so the ground is there less its shift
    turn = enlarged(hills.rotation_deg, hills.scale)
    true = np.array(far_m) - np.linalg.solve(turn, [hills.east_m, hills.north_m])
    north, east, down = solution.offset_m
    assert np.hypot(*(np.array([east, north]) - true)) < 0.25
    assert down == 0.0
    assert solution.sigma_m == pytest.approx(5.0, abs=0.1)
    assert "by hirise.tif" in line
    refused = replace(options, near_deg=None, reach_m=10.0)
    elsewhere = tmp_path / "noise.tif"
    rng = np.random.default_rng(5)
    write_image(elsewhere, 100 + 20 * rng.normal(size=grid.shape), grid)
    with pytest.raises(ProductError, match=r"does not locate MER2-ORIGIN10.*--near"):
        tie_by_image(elsewhere, name, store.store.root, refused)
    with pytest.raises(ProductError, match=r"solmap orbital add IMAGE --mission MER2-ORIGIN10"):
        add_orbital(file, name, store.store.root)


def test_a_store_without_maps_is_refused(image, tmp_path):
    ran = added(image, Workspace.open(tmp_path / "empty"))
    assert ran.exit_code == 1
    assert "holds no mission yet; name one by --mission" in ran.output
