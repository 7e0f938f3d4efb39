"""Models of a stop: where the terrain is, with their provenance, published and served."""

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.mesh.surface_mesh import ModelParams, TilesetParams
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.mesh.gltf import box_of_glb, read_glb
from solmap.products.formats.mesh.tiles3d import read_member, read_tileset
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import write_dtm
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.tasks.maps.models import model_terrain
from solmap.tasks.mission.publish import layer_of
from tests.support.gltf_validator import validate_glb

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0064")
GRID = MapGrid(40.96, 20.48, 0.04, 512, 512)


def elevation_at(east, north):
    return 3.0 + 0.1 * east + 0.2 * np.sin(north)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory) -> Workspace:
    return Workspace.open(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def inputs(workspace) -> tuple[ProductRef, ProductRef]:
    """A terrain model with a hole, and an orthophoto whose brightness grows towards east."""
    east, north = np.meshgrid(*GRID.centres())
    elevation = elevation_at(east, north).astype(np.float32)
    elevation[200:220, 100:300] = np.nan
    sigma = np.where(np.isfinite(elevation), np.float32(0.01), np.float32(np.nan))
    ground = np.where(np.isfinite(elevation), GroundClass.MEASURED, GroundClass.UNSEEN)
    count = np.ones_like(elevation)
    dtm = Dtm(GRID, elevation, sigma, count, ground.astype(np.uint8))
    fine = MapGrid(GRID.west, GRID.north, 0.02, 1024, 1024)
    brightness = np.broadcast_to(fine.centres()[0].astype(np.float32), fine.shape)
    crs, store = local_crs(LANDING), workspace.store
    return (
        store.make(Recipe(ProductKind.DTM, STOP), lambda path: write_dtm(path, dtm, crs)),
        store.make(
            Recipe(ProductKind.ORTHOPHOTO, STOP),
            lambda path: write_orthophoto(path, fine, np.array(brightness), crs),
        ),
    )


@pytest.fixture(scope="module")
def models(inputs, workspace) -> tuple[ProductRef, ProductRef]:
    tiling = TilesetParams(texture_px=256)
    return model_terrain.fn(*inputs, ModelParams(), tiling, LANDING, workspace.store)


@pytest.fixture(scope="module")
def model(models) -> ProductRef:
    return models[0]


@pytest.fixture(scope="module")
def tileset(models) -> ProductRef:
    return models[1]


def test_the_model_agrees_with_the_terrain(model, workspace):
    low, high = box_of_glb(workspace.store.path(model).read_bytes())
    east, north = GRID.centres()
    ends = (east[0], north[-1]), (east[-1], north[0])
    np.testing.assert_allclose((low[:2], high[:2]), ends, atol=1e-5)
    up = 3 + 0.1 * east[[0, -1]] + (-0.2, 0.2)
    np.testing.assert_allclose((low[2], high[2]), up, atol=0.01 + ModelParams().tolerance_m)


def test_the_model_is_valid_and_names_its_inputs(model, inputs, workspace):
    path = workspace.store.path(model)
    document, _ = read_glb(path.read_bytes())
    extras = document["nodes"][0]["extras"]
    assert extras["frame"] == "local map of Columbia Memorial Station"
    assert extras["product"] == f"model/{STOP}/{model.digest}"
    assert extras["inputs"] == [f"{ref.kind}/{STOP}/{ref.digest}" for ref in inputs]
    assert validate_glb(path)["issues"]["numErrors"] == 0


def test_every_tile_is_valid(tileset, workspace, tmp_path):
    path = workspace.store.path(tileset)
    root = read_tileset(path)["root"]
    uris = [root["content"]["uri"], *(child["content"]["uri"] for child in root["children"])]
    assert len(uris) == 1 + 4
    for uri in uris:
        glb = tmp_path / uri.replace("/", "-")
        glb.write_bytes(read_member(path, uri))
        assert validate_glb(glb)["issues"]["numErrors"] == 0


def test_models_are_published_beside_the_map_and_served(model, tileset, workspace):
    layers = [layer_of("MER2", ref, (156,), workspace) for ref in (model, tileset)]
    mission = MissionEntry("MER2", "Spirit", LANDING, None)
    workspace.catalogue.publish(missions=[mission], layers=layers)
    with TestClient(create_app(workspace.store.root)) as client:
        assert client.get("/api/missions/MER2/layers").json() == []
        known = {one["kind"]: one for one in client.get("/api/missions/MER2/models").json()}
        assert known.keys() == {"model", "tileset"}
        assert known["model"]["bounds"] == pytest.approx((40.98, 0.02, 61.42, 20.46), abs=1e-5)
        glb = client.get(known["model"]["open"])
        assert glb.headers["content-type"] == "model/gltf-binary"
        assert glb.content == workspace.store.path(model).read_bytes()
        address = known["tileset"]["open"]
        tree = client.get(address).json()
        tile = client.get(address.replace("tileset.json", tree["root"]["content"]["uri"]))
        assert tile.content[:4] == b"glTF"
        region = client.get("/api/missions/MER2/tileset.json").json()
        assert region["root"]["content"]["uri"] == address
        missing = client.get(address.replace("tileset.json", "9/9-9.glb"))
        assert missing.status_code == 404
        assert client.get(address.replace("tileset.json", "../../x")).status_code in {404, 422}
        place = client.get("/api/missions/MER2/identify?east=50&north=10").json()
        assert place["layers"] == place["features"] == []
