"""A small store whose every value is known in closed form, and a client of its server."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.traversability.hazard import Hazard
from solmap.products.catalogue.catalogue import Catalogue, ImageEntry, MissionEntry
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import (
    HAZARD_CLASSES,
    summarise,
    write_classes,
    write_dtm,
    write_raster,
)
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
CRS = local_crs(LANDING)
CELL_M = 0.08
GRID = MapGrid.covering((-40.0, -40.0, 40.0, 40.0), CELL_M)
STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0064")
REGION = Scope(ScopeLevel.REGION, "mer2")
UNSEEN_WEST_OF_M = -30.0


def elevation_at(east, north):
    """A tilted plane: 1 in 10 to the east, 1 in 20 to the north."""
    return 5.0 + 0.1 * east + 0.05 * north


def plane() -> np.ndarray:
    east, north = GRID.centres()
    surface = elevation_at(east[None, :], north[:, None])
    surface[:, east < UNSEEN_WEST_OF_M] = np.nan
    return surface.astype(np.float32)


@dataclass(frozen=True)
class SmallWorld:
    root: Path
    store: ProductStore
    catalogue: Catalogue

    def publish_raster(self, kind: ProductKind, scope: Scope, write, version: int = 0) -> Layer:
        ref = self.store.make(Recipe(kind, scope, params=(version,)), write)
        grid, bands = summarise(self.store.path(ref))
        layer = Layer(
            ref=ref,
            mission="MER2",
            title=f"{kind} of {scope}",
            type="raster",
            bounds=grid.bounds,
            cell_m=grid.cell_m,
            unit=bands[0].unit or None,
            range=bands[0].range,
            sols=(156,),
            made_at=self.store.made_at(ref),
        )
        self.catalogue.publish(layers=[layer])
        return layer

    def publish_features(
        self, kind: ProductKind, features: list[Feature], version: int = 0
    ) -> Layer:
        recipe = Recipe(kind, REGION, params=(version,))
        ref = self.store.make(recipe, lambda path: write_features(path, features, LANDING))
        boxes = np.array([feature.bounds for feature in features])
        bounds = (*boxes[:, :2].min(axis=0).tolist(), *boxes[:, 2:].max(axis=0).tolist())
        layer = Layer(
            ref, "MER2", str(kind), "vector", bounds, None, None, None, (156,), "2026-01-01"
        )
        self.catalogue.publish(layers=[layer])
        return layer


def dtm() -> Dtm:
    surface = plane()
    seen = np.isfinite(surface)
    return Dtm(
        GRID,
        surface,
        np.where(seen, np.float32(0.02), np.float32(np.nan)),
        np.where(seen, np.float32(3.0), np.float32(0.0)),
        seen.astype(np.uint8),
    )


def brightness() -> np.ndarray:
    """Grey runs from 0 in the west to 254 in the east."""
    columns = np.linspace(0.0, 254.0, GRID.cols, dtype=np.float32)
    return np.where(np.isfinite(plane()), columns[None, :], np.nan).astype(np.float32)


def constant(value: float):
    field = np.where(np.isfinite(plane()), np.float32(value), np.float32(np.nan))

    def write(path: Path) -> None:
        write_raster(path, GRID, {"value": field}, CRS, unit="degree")

    return write


def hazards(path: Path) -> None:
    """Steep in the north, traversable in the south."""
    codes = np.where(np.isfinite(plane()), Hazard.TRAVERSABLE, Hazard.UNKNOWN).astype(np.uint8)
    codes[: GRID.rows // 2][codes[: GRID.rows // 2] > 0] = Hazard.STEEP
    write_classes(path, GRID, codes, CRS, name="hazard", classes=HAZARD_CLASSES)


def haven() -> Feature:
    """A square of 10 m with a hole of 2 m."""
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    return Feature("Polygon", square - 20.0, {"area_m2": 96.0}, "haven-1", [square / 5 - 16.0])


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> SmallWorld:
    """A world to look at."""
    return build(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="session")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a world that no server has opened."""
    return build(tmp_path_factory.mktemp("untouched") / "store").root


@pytest.fixture
def own_world(untouched: Path, tmp_path: Path) -> SmallWorld:
    """A world to change."""
    return opened(shutil.copytree(untouched, tmp_path / "store"))


def opened(root: Path) -> SmallWorld:
    return SmallWorld(root, ProductStore.open(root), Catalogue.open(root))


def build(root: Path) -> SmallWorld:
    root.mkdir(exist_ok=True)
    small = opened(root)
    small.catalogue.publish(
        missions=[MissionEntry("MER2", "Spirit, Gusev crater", LANDING, None)],
        images=[image_of(small.store)],
    )
    small.publish_raster(ProductKind.DTM, STOP, lambda path: write_dtm(path, dtm(), CRS))
    small.publish_raster(
        ProductKind.ORTHOPHOTO,
        STOP,
        lambda path: write_orthophoto(path, GRID, brightness(), CRS, stretch=(0.0, 254.0)),
    )
    for kind, value in (
        (ProductKind.SLOPE, 20.0),
        (ProductKind.ASPECT, 90.0),
        (ProductKind.HILLSHADE, 0.5),
        (ProductKind.NORTHERLY_TILT, -5.0),
    ):
        small.publish_raster(kind, STOP, constant(value))
    small.publish_features(
        ProductKind.FOOTPRINTS,
        [
            Feature("Polygon", np.array([[0, 0], [20, 0], [20, 20], [0, 20]]), {"sol": 156}, "A"),
            Feature("Polygon", np.array([[5, 5], [9, 5], [9, 9], [5, 9]]), {"sol": 157}, "B"),
        ],
    )
    small.publish_raster(ProductKind.HAZARD, STOP, hazards)
    small.publish_features(ProductKind.HAVENS, [haven()])
    small.publish_features(
        ProductKind.STOPS, [Feature("Point", np.array([[7.0, 6.0, 6.1]]), {"site": 10}, "stop")]
    )
    return small


IMAGE_BYTES = b"PDS_VERSION_ID = PDS3\r\nEND\r\n" + bytes(range(256))


def image_of(store: ProductStore) -> ImageEntry:
    scope = Scope(ScopeLevel.IMAGE, "2n140000000effa000p1600l0m1")
    original = store.make(
        Recipe(ProductKind.IMAGE, scope), lambda path: _write_bytes(path, IMAGE_BYTES)
    )
    image = cv2.imencode(".png", np.full((8, 8), 77, np.uint8))[1].tobytes()
    browse = store.make(Recipe(ProductKind.BROWSE, scope), lambda path: _write_bytes(path, image))
    return ImageEntry(
        id=scope.name.upper(),
        mission="MER2",
        stop=STOP.name,
        site=10,
        drive=64,
        sol=156,
        instrument="NAVCAM",
        eye="left",
        product_type="EDR",
        start_time="2004-06-11T10:00:00Z",
        local_solar_time="12:00:00",
        partner=None,
        unpaired_because="the right image was never sent",
        ref=original,
        browse=browse,
    )


def _write_bytes(path: Path, data: bytes) -> None:
    path.write_bytes(data)


@pytest.fixture(scope="session")
def client(world: SmallWorld) -> Iterator[TestClient]:
    with TestClient(create_app(world.root)) as opened:
        yield opened


def ref_of(world: SmallWorld, kind: ProductKind, scope: Scope = STOP) -> ProductRef:
    return world.catalogue.layer(scope.name, kind).ref


def image_in(body: bytes) -> np.ndarray:
    """Red, green, blue and alpha of a PNG or WebP; the latter has no alpha where all is opaque."""
    decoded = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)
    has_alpha = decoded.shape[2] == 4
    return cv2.cvtColor(decoded, cv2.COLOR_BGRA2RGBA if has_alpha else cv2.COLOR_BGR2RGBA)
