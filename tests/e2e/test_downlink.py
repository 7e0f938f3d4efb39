"""From PDS3 files to a tile, held against the truth of the world they were rendered from."""

import json
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.flows.cli.tables import position_rows, product_rows
from solmap.flows.dips import dips_of_rocks
from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.measure.facets import FacetParams, PlanarRegionParams
from solmap.products.formats.mesh.models import extent_of_model
from solmap.products.formats.mesh.tiles3d import box_of, read_tileset
from solmap.products.formats.raster.raster import read_dtm, read_raster
from solmap.products.model import ProductKind
from tests.support.gltf_validator import validate_glb

STOP_KINDS = {"dtm", "orthophoto", "sources", "slope", "aspect", "hillshade", "contours"}
STOP_KINDS |= {"model", "view-model", "tileset", "points", "point-tiles", "panorama"}
REGION_KINDS = {"traverse", "stops", "footprints", "pointing", "tie-points"}

OF_HALF_SIZE = FacetParams(
    max_relative_sigma=0.02,
    regions=PlanarRegionParams(window_px=9, step_px=2),
    max_sigma_deg=20.0,
    correlation_px=5.0,
)
"""As many degrees of the view as the defaults have of images of full size."""


def error_m(row: dict, truth: dict, solution: str) -> float:
    return float(np.linalg.norm(np.subtract(row[solution], truth["position"])))


def test_every_sol_is_processed_and_every_product_is_made(mapped):
    assert mapped.report.succeeded, mapped.report.failures
    rows = product_rows(mapped.workspace)
    for stop in ("mer2-site0010-drive0000",):
        assert {row["kind"] for row in rows if row["scope"] == stop} >= STOP_KINDS
    assert {row["kind"] for row in rows if row["scope"] == "mer2"} >= REGION_KINDS
    assert len([row for row in rows if row["kind"] == "browse"]) == 24


def finest_tiles(path: Path) -> list[dict]:
    """The leaves of a tileset."""
    tiles = [read_tileset(path)["root"]]
    while any("children" in tile for tile in tiles):
        tiles = [one for tile in tiles for one in tile.get("children", [tile])]
    return tiles


def test_a_stop_has_a_model_and_its_rocks_have_strike_and_dip(mapped):
    stop = "mer2-site0010-drive0000"
    paths = {
        r["kind"]: Path(r["path"]) for r in product_rows(mapped.workspace) if r["scope"] == stop
    }
    for kind in ("model", "view-model"):
        assert validate_glb(paths[kind])["issues"]["numErrors"] == 0
    west, south, east, north = extent_of_model(paths["model"])[0]
    # coarser tiles keep squares of which half was seen, so the box of all may be larger
    boxes = np.array(
        [box_of(tile["boundingVolume"]["box"]) for tile in finest_tiles(paths["tileset"])]
    )
    tiles = [*boxes[:, 0, :2].min(axis=0), *boxes[:, 1, :2].max(axis=0)]
    np.testing.assert_allclose(tiles, (west, south, east, north), atol=0.01)
    seen = extent_of_model(paths["view-model"])[0]
    assert max(west - seen[0], south - seen[1], seen[2] - east, seen[3] - north) < 0.5
    facets = dips_of_rocks(stop, OF_HALF_SIZE, mapped.workspace)
    assert facets
    assert all(max(f["sigma_strike_deg"], f["sigma_dip_deg"]) <= 20 for f in facets)
    assert mapped.workspace.catalogue.layer(stop, ProductKind.DIPS).type == "vector"


def test_the_adjustment_removes_most_of_the_slip(mapped):
    rows, truths = position_rows(mapped.workspace), mapped.truth["stops"]
    assert [row["held"] for row in rows] == [True, False]
    telemetry = error_m(rows[1], truths[1], "telemetry_ned_m")
    adjusted = error_m(rows[1], truths[1], "adjusted_ned_m")
    driven_m = np.linalg.norm(np.subtract(truths[1]["position"], truths[0]["position"]))
    assert adjusted < 0.01 * driven_m, f"telemetry {telemetry:.3f} m, adjusted {adjusted:.3f} m"
    assert adjusted < 0.5 * telemetry


def test_the_terrain_of_the_first_stop_agrees_with_the_truth(mapped):
    layer = mapped.workspace.catalogue.layer("mer2-site0010-drive0000", ProductKind.DTM)
    dtm = read_dtm(mapped.workspace.store.path(layer.ref))
    grid, bands = read_raster(mapped.downlink / "truth" / "dtm.tif")
    east, north = dtm.grid.centres()
    rows = np.floor((grid.north - north) / grid.cell_m).astype(int)
    cols = np.floor((east - grid.west) / grid.cell_m).astype(int)
    inside = np.ix_((rows >= 0) & (rows < grid.rows), (cols >= 0) & (cols < grid.cols))
    true = np.full(dtm.grid.shape, np.nan)
    true[inside] = bands["elevation"][rows.clip(0, grid.rows - 1)][:, cols.clip(0, grid.cols - 1)][
        inside
    ]
    range_m = np.hypot(north[:, None], east[None, :])
    near = np.isfinite(dtm.elevation) & np.isfinite(true) & (range_m < 10.0)
    assert near.sum() > 100_000, "cells within 10 m of the rover that were mapped"
    errors = np.abs(dtm.elevation - true)[near]
    assert np.median(errors) < 0.02  # 10 m range at 0.25 px is 0.1 m along a ray that dips 1 in 7
    assert np.percentile(errors, 90) < 0.08


def test_unseen_ground_has_no_elevation(mapped):
    layer = mapped.workspace.catalogue.layer("mer2-site0010-drive0000", ProductKind.DTM)
    dtm = read_dtm(mapped.workspace.store.path(layer.ref))
    known = np.isin(dtm.ground, (GroundClass.MEASURED, GroundClass.INTERPOLATED))
    np.testing.assert_array_equal(np.isfinite(dtm.elevation), known)
    assert (~known).mean() > 0.1, "shadows of rocks and the ground beyond reach"
    assert (dtm.ground == GroundClass.OCCLUDED).mean() > 0.01, "shadows of rocks"


def test_a_second_run_skips_finished_work(mapped):
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    made = {path: path.stat().st_mtime_ns for path in (mapped.store / "products").rglob("*.*")}
    again = process_downlink(mapped.downlink, mapped.store)
    assert again.succeeded
    assert {
        path: path.stat().st_mtime_ns for path in (mapped.store / "products").rglob("*.*")
    } == made


def test_the_server_shows_the_mapped_layers(mapped):
    from solmap.gis_server.app import create_app  # noqa: PLC0415 - after the flow

    with TestClient(create_app(mapped.store)) as client:
        assert client.get("/healthz").status_code == 200
        (mission,) = client.get("/api/missions").json()
        assert mission["mission"] == "MER2"
        layers = client.get("/api/missions/MER2/layers").json()
        ortho = next(layer for layer in layers if layer["kind"] == "orthophoto")
        sizes = mission["tile_matrix_set"]["cell_sizes"]
        zoom = len(sizes) - 1
        west, _, _, north = mission["tile_matrix_set"]["extent"]
        # the tile 5 m south of the first stop
        column = int((0.0 - west) / (sizes[zoom] * 256))
        row = int((north + 5.0) / (sizes[zoom] * 256))
        url = ortho["tiles"].format(z=zoom, x=column, y=row)
        tile = client.get(url)
        assert tile.headers["content-type"] == "image/webp"
        assert "immutable" in tile.headers["cache-control"]
        identified = client.get("/api/missions/MER2/identify?east=0&north=-5").json()
        assert identified["elevation_m"] == pytest.approx(0.0, abs=3.0)


@pytest.mark.parametrize("command", ["positions", "products", "status"])
def test_scripts_get_json_from_commands(mapped, command):
    result = CliRunner().invoke(app, [command, "--store", str(mapped.store), "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)
    assert isinstance(rows, list)
    assert rows


def test_positions_have_the_documented_fields(mapped):
    row = position_rows(mapped.workspace)[0]
    assert {
        "mission", "site", "drive", "sols", "telemetry_ned_m", "adjusted_ned_m",
        "adjusted_quaternion", "sigma_ned_m", "covariance", "held",
    } <= set(row)  # fmt: skip


def test_products_have_the_documented_fields(mapped):
    row = product_rows(mapped.workspace)[0]
    assert {"kind", "scope", "path", "crs", "cell_m", "made_at"} <= set(row)
