"""What a downlink makes reaches browsers in waves, and ends as if it had come all at once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.support.disorder import differences
from tests.support.injection import process
from tests.support.live_server import listening, serving
from tests.support.small_downlink import COARSE, write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents

pytestmark = pytest.mark.usefixtures("engine")
FIRST = {"dtm", "orthophoto", "sources", "contours", "hillshade"}
GROUND = {"slope", "aspect", "roughness", "northerly-tilt", "hazard", "viewshed", "insolation"}
MODELS = {"model", "tileset", "view-model", "points", "point-tiles", "panorama"}
DIFFER = {"havens", "dips", "far-dtm", "far-hillshade", "far-contours"}
"""What is there or not, as the simulated ground has it."""


EVERY_MOVE = f"{COARSE}[reissue]\nshift_m = 1e-6\n"
"""The pipeline that makes the maps of a stop again however little it moves."""


def wave(event: tuple, workspace: Workspace) -> dict[str, set[str]]:
    """The kinds of an event by scope; every layer that it names is there, with its file."""
    found: dict[str, set[str]] = {}
    for name in event[2]["layers"]:
        scope, kind = name.split("/")
        found.setdefault(scope, set()).add(kind)
        layer = workspace.catalogue.layer(scope, kind)
        assert workspace.store.has(layer.ref), name
    return found


def test_each_new_stop_is_published_before_its_models_are_made(tmp_path: Path):
    downlink = write_small_downlink(tmp_path / "downlink", pairs=2)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml", EVERY_MOVE))
    workspace = Workspace.open(tmp_path / "store")
    with serving(tmp_path / "store") as server, listening(f"{server}/api/events") as heard:
        assert heard.get(timeout=60)[0] == "hello"
        report = process(downlink, tmp_path / "store", pipeline)
        assert report.succeeded, report.failures
        workspace.catalogue.append_event("run.changed", {"is_over": True})
        events = [heard.get(timeout=60)]
        while "is_over" not in events[-1][2]:
            events.append(heard.get(timeout=60))
    waves = [wave(event, workspace) for event in events if event[0] == "layers.published"]
    stops = sorted({image.stop for image in workspace.catalogue.images()})

    of_stops = {stop: [found[stop] - DIFFER for found in waves if stop in found] for stop in stops}
    first, last = stops
    assert of_stops[first] == [FIRST, FIRST | GROUND | MODELS]  # the last sol moved it
    assert of_stops[last][:3] == [FIRST, GROUND, MODELS]
    for stop in stops:
        at = waves.index(next(found for found in waves if stop in found))
        assert {"traverse", "stops"} <= waves[at - 1]["mer2"]
    assert "tie-points" in waves[-2]["mer2"]
    assert {"region-dtm"} <= set.union(*waves[-1].values())


@pytest.mark.slow
def test_what_was_published_in_waves_ends_as_if_made_at_once(tmp_path: Path, monkeypatch):
    downlink = write_small_downlink(tmp_path / "downlink", pairs=2)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml", EVERY_MOVE))
    assert process(downlink, tmp_path / "store", pipeline).succeeded
    made_at_once(tmp_path, downlink, pipeline, monkeypatch)
    assert differences(Contents.of(tmp_path / "store"), Contents.of(tmp_path / "other")) == []


def made_at_once(folder: Path, downlink: Path, pipeline: str, monkeypatch) -> None:
    """Process a downlink into `other` without waves, with the products of `store`."""
    from solmap.flows.sol_waves import Waves  # noqa: PLC0415 - imports Prefect

    monkeypatch.setattr(Waves, "plan", lambda *_: None)
    monkeypatch.setattr(Waves, "show_positions", lambda *_: None)
    shutil.copytree(folder / "store" / "products", folder / "other" / "products")
    assert process(downlink, folder / "other", pipeline).succeeded


def test_layers_left_to_a_sol_that_fails_are_made(tmp_path: Path, monkeypatch):
    from solmap.flows import sol as module  # noqa: PLC0415 - imports Prefect

    downlink = write_small_downlink(tmp_path / "downlink", pairs=1)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml"))
    match_pairs, last = module.match_pairs, 156

    def failing(inputs, *rest):
        if inputs.sol == last:
            raise ValueError("no sol")
        return match_pairs(inputs, *rest)

    monkeypatch.setattr(module, "match_pairs", failing)
    report = process(downlink, tmp_path / "store", pipeline)
    assert report.failures == [f"MER2 sol {last}: ValueError: no sol"]
    workspace = Workspace.open(tmp_path / "store")
    stops = sorted({image.stop for image in workspace.catalogue.images()})
    layers = workspace.catalogue.layers()
    made = {one.ref.kind for one in layers if one.ref.scope.name == stops[0]}
    assert made >= FIRST | GROUND | MODELS

    monkeypatch.undo()
    assert process(downlink, tmp_path / "store", pipeline).succeeded
    made_at_once(tmp_path, downlink, pipeline, monkeypatch)
    assert differences(Contents.of(tmp_path / "store"), Contents.of(tmp_path / "other")) == []


def test_a_failed_wave_is_reported_and_published_by_the_last_one(tmp_path: Path, monkeypatch):
    from solmap.flows import sol_waves  # noqa: PLC0415 - imports Prefect

    downlink = write_small_downlink(tmp_path / "downlink", stops=1, pairs=1)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml"))
    real = sol_waves.publish

    def publish(mission, layers, *rest, is_last):
        if any(ref.kind == "dtm" for ref, _ in layers) and not is_last:
            raise ValueError("no wave")
        return real(mission, layers, *rest, is_last=is_last)

    monkeypatch.setattr(sol_waves, "publish", publish)
    report = process(downlink, tmp_path / "store", pipeline)
    assert report.failures == ["MER2 sol 155: publish layers: ValueError: no wave"]
    kinds = {layer.ref.kind for layer in Workspace.open(tmp_path / "store").catalogue.layers()}
    assert kinds >= FIRST | GROUND
