"""A simulated mission fills a store with all that the map shows of a traverse, and no images."""

import json
from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.synthetic.mission import MissionPlan
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.vector.geojson import read_features
from solmap.products.model import ProductKind

STOPS = 8
PLAN = MissionPlan(stops=STOPS, distance_m=112.0, gaps=1)
KINDS = {
    ProductKind.TRAVERSE,
    ProductKind.STOPS,
    ProductKind.FOOTPRINTS,
    ProductKind.POINTING,
    ProductKind.TIE_POINTS,
}


def simulated(root, plan=PLAN):
    from solmap.flows.simulation import simulate_into  # noqa: PLC0415 - needs the engine's settings

    return simulate_into(root, plan, 1)


@pytest.fixture(scope="module")
def root(tmp_path_factory, engine):  # noqa: ARG001 - flows run on it
    folder = tmp_path_factory.mktemp("mission") / "store"
    assert simulated(folder).startswith(f"{STOPS} stops, {20 * STOPS} images")
    return folder


@pytest.fixture(scope="module")
def workspace(root):
    return Workspace.open(root)


@pytest.mark.slow
def test_every_layer_of_a_traverse_is_published(workspace):
    layers = {layer.ref.kind: layer for layer in workspace.catalogue.layers("MER2")}
    assert set(layers) >= KINDS
    counts = {
        kind: len(read_features(workspace.store.path(layers[kind].ref)).features) for kind in KINDS
    }
    assert counts[ProductKind.TRAVERSE] == 2
    assert counts[ProductKind.STOPS] == 2 * STOPS
    assert counts[ProductKind.POINTING] == 20 * STOPS
    assert counts[ProductKind.FOOTPRINTS] == 20 * STOPS
    assert counts[ProductKind.TIE_POINTS] > 100 * (STOPS - 1)


@pytest.mark.slow
def test_images_have_labels_and_partners_and_are_marked_without_pixels(workspace):
    entries = workspace.catalogue.images("MER2")
    assert len(entries) == 20 * STOPS
    by_id = {entry.id: entry for entry in entries}
    for entry in entries[:5]:
        assert entry.notes == ("simulated: there are no pixels",)
        assert by_id[entry.partner].partner == entry.id
        assert image_record(entry, workspace).stop == entry.stop_id
        assert workspace.store.path(entry.browse).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_adjusted_stops_are_nearer_to_the_truth_than_telemetry(root, workspace):
    truth = json.loads((root / "truth.json").read_text())["stops"]
    true = {row["stop"]: row["lsl_from_rover"]["translation_m"] for row in truth}
    layer = workspace.catalogue.layer("mer2", ProductKind.STOPS)
    off = {"telemetry": [], "adjusted": []}
    for feature in read_features(workspace.store.path(layer.ref)).features:
        reported = feature.properties
        north, east, _ = true[reported["stop"]]
        place = np.asarray(feature.points).ravel()[:2]
        off[reported["solution"]].append(np.hypot(*(place - [east, north])))
    assert max(off["adjusted"]) < max(off["telemetry"])
    assert max(off["adjusted"]) < 1.0


@pytest.mark.slow
def test_the_same_mission_again_makes_nothing_and_another_one_is_refused(root, workspace):
    before = {layer.ref for layer in workspace.catalogue.layers()}
    simulated(root)
    assert {layer.ref for layer in workspace.catalogue.layers()} == before
    with pytest.raises(PhotogrammetryError, match="name an empty store"):
        simulated(root, replace(PLAN, stops=9))
