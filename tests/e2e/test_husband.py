"""The path-traced three-stop traverse is processed and compared with the goals.

They are those of `make accuracy`: 0.1 % of the way and 0.05 degrees in the median, 0.3 % at worst,
stated covariances that are true, and ground of the held stop to half a centimetre in the median.
All of it is slow: goals are checked by `make test-all`, not by `make test`.
"""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from solmap.flows.cli.evaluation import evaluate_positions, evaluate_terrain, true_stops
from solmap.flows.cli.tables import position_rows, product_rows
from solmap.products.catalogue.workspace import Workspace

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def store(engine: None, husband: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: ARG001
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    folder = tmp_path_factory.mktemp("husband")
    report = process_downlink(husband, folder)
    assert report.succeeded, report.failures
    return folder


@pytest.fixture(scope="module")
def evaluated(store: Path, husband: Path) -> list[dict[str, Any]]:
    rows = position_rows(Workspace.open(store))
    return evaluate_positions(rows, true_stops(husband / "truth"))


def test_every_stop_has_every_product(store):
    kinds: dict[str, set[str]] = {}
    for row in product_rows(Workspace.open(store)):
        kinds.setdefault(row["scope"], set()).add(row["kind"])
    of_linked = {"far-dtm", "far-contours", "far-hillshade"}  # together with an earlier stop
    for stop, far in (("site0010-drive0000", set()), ("site0010-drive0064", of_linked),
                      ("site0011-drive0000", of_linked)):  # fmt: skip
        assert kinds[f"mer2-{stop}"] == far | {
            "dtm", "orthophoto", "sources", "slope", "aspect", "hillshade", "contours",
            "northerly-tilt", "roughness", "hazard", "havens", "insolation", "viewshed",
            "model", "view-model", "tileset", "points", "point-tiles", "panorama",
        }  # fmt: skip


def test_stops_are_within_a_tenth_of_a_percent_of_the_distance(evaluated):
    assert [row["stop"] for row in evaluated] == [
        "mer2-site0010-drive0000",
        "mer2-site0010-drive0064",
        "mer2-site0011-drive0000",
    ]
    for row in evaluated[1:]:
        assert "cross-site ties" in row["held_by"]
        assert row["percent"] <= 0.3, row
    assert np.median([row["percent"] for row in evaluated[1:]]) <= 0.1


def test_attitudes_are_within_a_twentieth_of_a_degree(evaluated):
    for name in ("azimuth_error_deg", "tilt_error_deg"):
        assert np.median([abs(row[name]) for row in evaluated[1:]]) <= 0.05, evaluated


def test_errors_of_stops_agree_with_their_covariances(evaluated):
    # the mean of NEES/6 over worlds is to lie between 0.6 and 1.5; two stops of one scatter more:
    # twelve freedoms, of which 99.9 % are below 2.8
    nees = np.mean([row["nees"] for row in evaluated[1:]])
    assert 0.1 < nees < 2.8, evaluated


@pytest.mark.parametrize(
    ("range_m", "limit_m"), [((0, 10), 0.005), ((10, 20), 0.005), ((20, 30), 0.01)]
)
def test_ground_of_the_held_stop_has_no_height_bias(store, husband, range_m, limit_m):
    rows = evaluate_terrain(Workspace.open(store), husband / "truth")
    held = {tuple(row["range_m"]): row for row in rows if "site0010-drive0000" in row["stop"]}
    assert abs(held[range_m]["bias_m"]) <= limit_m, held[range_m]


def test_a_mosaic_with_a_rotated_georeference_makes_no_stop_worse(
    store, husband, evaluated, tmp_path
):
    """By 1.3 degrees and some metres; it turned every stop by a degree, the first one too."""
    from solmap.flows.external_data import add_orbital  # noqa: PLC0415 - needs the engine's settings
    from solmap.flows.overall import readjust  # noqa: PLC0415

    with rasterio.open(husband / "orbital" / "orbital_image.tif") as dataset:
        profile, values = dataset.profile, dataset.read()
    off = Affine.translation(-5.5, 2.5) * Affine.rotation(1.3)
    turned, controlled = tmp_path / "turned.tif", tmp_path / "store"
    with rasterio.open(
        turned, "w", **{**profile, "transform": off * profile["transform"]}
    ) as image:
        image.write(values)
    shutil.copytree(store, controlled, ignore=shutil.ignore_patterns("prefect"))
    message = add_orbital(turned, "MER2", controlled)
    assert any("found on their own: 3 of 3 stops" in line for line in message), message
    assert not readjust("MER2", controlled).failures
    rows = evaluate_positions(
        position_rows(Workspace.open(controlled)), true_stops(husband / "truth")
    )
    assert rows[0]["held_by"] == "held as the datum"
    for row, without in zip(rows[1:], evaluated[1:], strict=True):
        assert "control: its position in turned-tif" in row["held_by"]
        assert row["percent"] < without["percent"] + 0.03
        assert abs(row["azimuth_error_deg"]) < max(abs(without["azimuth_error_deg"]), 0.08)
    assert 0.1 < np.mean([row["nees"] for row in rows[1:]]) < 2.8
