"""Two stops of a simulated downlink become one instrument, and their far ground a layer."""

from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.synthetic.downlink import simulate_downlink
from solmap.photogrammetry.synthetic.scene import World, WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import FAR_KINDS, Layer, ProductKind

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

WORLD = WorldParams(
    "hills", TraverseParams(stops=2, spacing_m=(9.0, 10.0), local_solar_hours=(11.0, 11.3))
)
SEED = 8


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(WORLD, SEED)


@pytest.fixture(scope="module")
def mapped(engine, tmp_path_factory) -> tuple[Workspace, Path, Path]:  # noqa: ARG001
    """The downlink processed with far ground enabled: store, downlink and settings."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    folder = tmp_path_factory.mktemp("far")
    downlink, settings = folder / "downlink", folder / "far.toml"
    for file in simulate_downlink(WORLD, SEED):
        path = downlink / file.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.data)
    settings.write_text("[wide]\nenabled = true\n")
    report = process_downlink(downlink, folder / "store", str(settings))
    assert report.succeeded, report.failures
    return Workspace.open(folder / "store"), downlink, settings


def far_layers(workspace: Workspace) -> dict[ProductKind, Layer]:
    return {
        layer.ref.kind: layer
        for layer in workspace.catalogue.layers()
        if layer.ref.kind in FAR_KINDS.values()
    }


def test_far_ground_is_published_beside_the_map_of_the_later_stop(mapped):
    layers = far_layers(mapped[0])
    assert layers.keys() == set(FAR_KINDS.values())
    later = max(layer.ref.scope.name for layer in mapped[0].catalogue.layers())
    for layer in layers.values():
        assert layer.ref.scope.name == later
        assert layer.title.startswith("Far ")
        west, south, east, north = layer.bounds
        assert max(east - west, north - south) > 200


def test_far_ground_has_its_true_coordinates(mapped, world):
    dtm = read_dtm(mapped[0].store.path(far_layers(mapped[0])[ProductKind.FAR_DTM].ref))
    for (low, high), most_m, cells in (((100, 200), 0.5, 10_000), ((200, 300), 0.5, 10_000)):
        error_m, sigma_m = errors(dtm, world, low, high)
        assert len(error_m) > cells
        assert np.median(np.abs(error_m)) < most_m
        # the tilt of the left camera is not part of sigma: 0.04 degrees are 0.14 m at 200 m
        assert (np.abs(error_m) < 3 * sigma_m).mean() > 0.8


def errors(dtm: Dtm, world: World, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors of cells in a band of range, and what is stated for them."""
    east, north = dtm.grid.centres()
    range_m = np.hypot(north[:, None], east[None, :])
    row, col = np.nonzero(np.isfinite(dtm.elevation) & (range_m >= low) & (range_m < high))
    true_m = world.terrain.elevation(north[row], east[col])
    return dtm.elevation[row, col] - true_m, dtm.sigma_m[row, col]


def test_a_second_run_skips_existing_products(mapped):
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415

    workspace, downlink, settings = mapped
    products = workspace.store.root / "products"
    before = {path: path.stat().st_mtime_ns for path in products.rglob("*.*")}
    assert process_downlink(downlink, workspace.store.root, str(settings)).succeeded
    assert {path: path.stat().st_mtime_ns for path in products.rglob("*.*")} == before
