"""From a folder of an own stereo rig to maps: the K10 pair, and a simulated drive."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import ProductKind
from tests.support.field_rig import drive_with_a_rig, elevation

pytestmark = pytest.mark.usefixtures("engine")
RIG = """mission = "K10"
[left]
images = "left*.png"
calibration = "black_left.tsai"
[right]
images = "right*.png"
calibration = "black_right.tsai"
"""


def run(folder: Path, store: Path) -> tuple[list[str], Workspace]:
    """The lines of a run, and what it made."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    report = process_downlink(folder, store)
    assert report.failures == []
    return [*report.warnings, *report.lines], Workspace.open(store)


def models(workspace: Workspace, mission: str):
    """The terrain models of stops on the map."""
    layers = workspace.catalogue.layers(mission)
    refs = [layer.ref for layer in layers if layer.ref.kind is ProductKind.DTM]
    return [workspace.store.path(ref) for ref in refs]


def errors_of(path: Path) -> np.ndarray:
    """Elevation less that of the simulated ground, cell by cell, metres."""
    terrain = read_dtm(path)
    east, north = terrain.grid.centres()
    off = terrain.elevation - elevation(east[None, :], north[:, None])
    return off[np.isfinite(off)]


@pytest.mark.slow
def test_the_k10_pair_becomes_a_map_without_a_planet(shared_data, tmp_path):
    pair = shared_data / "analogue_k10_pair"
    if not pair.is_dir():
        pytest.skip("the pair of K10 is not among the shared data")
    folder = Path(shutil.copytree(pair, tmp_path / "k10"))
    folder.chmod(0o755)
    (folder / "rig.toml").write_text(RIG)
    lines, workspace = run(folder, tmp_path / "store")
    assert any("calibrate the rig again" in line for line in lines)
    kinds = {layer.ref.kind for layer in workspace.catalogue.layers("K10")}
    assert {ProductKind.DTM, ProductKind.ORTHOPHOTO, ProductKind.SLOPE} <= kinds
    assert ProductKind.INSOLATION not in kinds
    (path,) = models(workspace, "K10")
    with rasterio.open(path) as dtm:
        assert "not tied to a planet" in dtm.crs.to_wkt()
        assert dtm.tags()["MISSION"] == "K10"
    terrain = read_dtm(path)
    east, north = terrain.grid.centres()
    x, y = np.meshgrid(east, north)
    near = np.isfinite(terrain.elevation) & (np.hypot(x, y) < 6.0)
    assert near.sum() * terrain.grid.cell_m**2 > 15.0
    design = np.column_stack([x[near], y[near], np.ones(near.sum())])
    heights = terrain.elevation[near].astype(float)
    off = heights - np.median(heights)
    for _ in range(30):
        weights = 1.0 / (1.0 + (off / 0.05) ** 2)
        plane = np.linalg.lstsq(design * weights[:, None], heights * weights, rcond=None)[0]
        off = heights - design @ plane
    assert 1.4826 * np.median(np.abs(off[np.abs(off) < 0.1])) < 0.04
    client = TestClient(create_app(workspace.store.root))
    for address in (
        "/api/missions",
        "/ogc/K10",
        "/ogc/K10/wmts?service=WMTS&request=GetCapabilities",
    ):
        answer = client.get(address)
        assert answer.is_success, address
        assert "Mars" not in answer.text, address
        assert "not tied to a planet" in answer.text, address
    assert all("Mars" not in item.read_text() for item in (tmp_path / "store/stac").rglob("*.json"))


@pytest.mark.slow
def test_twenty_pairs_of_a_field_rover_agree_with_the_true_ground(tmp_path):
    drive = drive_with_a_rig(tmp_path / "drive", 20, size=(1024, 768))
    _, workspace = run(drive.folder, tmp_path / "store")
    paths = models(workspace, "FIELD")
    assert len(paths) == 20
    first = [errors_of(path) for path in sorted(paths)[:3]]
    assert all(np.median(np.abs(off)) < 0.02 for off in first), "before odometry has drifted"


@pytest.mark.slow
@pytest.mark.parametrize("model", ["pinhole", "brown-conrady", "fisheye"])
def test_a_small_drive_is_mapped_with_every_camera_model(model, tmp_path):
    drive = drive_with_a_rig(tmp_path / "drive", 2, model=model, size=(320, 240))
    _, workspace = run(drive.folder, tmp_path / "store")
    for path in models(workspace, "FIELD"):
        off = errors_of(path)
        assert len(off) * 0.0016 > 8.0
        assert 1.4826 * np.median(np.abs(off - np.median(off))) < 0.015
