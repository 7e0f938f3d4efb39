"""A traverse, sol by sol at network level: what a sol keeps does not grow, all of it is there."""

import json
from datetime import timedelta
from itertools import pairwise

import numpy as np
import pytest

from solmap.flows.sol_inputs import read_map
from solmap.photogrammetry.adjustment.quality.weaknesses import shared_ties
from solmap.photogrammetry.terrain.visibility.footprints import FootprintParams
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.maintenance.pruning import PruningParams, prune
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.network import read_network, whole_network
from solmap.products.model import ProductKind
from solmap.tasks.mission import vectors
from solmap.tasks.mission.vectors import draw_vectors
from tests.support.mission_growth import walked
from tests.support.simulated_sols import SimulatedSols

STOPS, PAIRS = 10, 2
OUTLINES = (ProductKind.FOOTPRINTS, ProductKind.POINTING)


@pytest.fixture(scope="module")
def traverse(tmp_path_factory):
    """(workspace, what every sol left) of a traverse with few ties, a stop a sol."""
    root = tmp_path_factory.mktemp("traverse")
    sols = SimulatedSols.of(
        STOPS, spacing_m=20.0, pairs_per_stop=PAIRS, inter_ties=12, intra_ties=8
    )
    standings = [standing for standing, _ in walked(sols, STOPS, root)]
    return Workspace.open(root), standings


def test_documents_of_sols_hold_the_stops_they_changed(traverse):
    workspace, standings = traverse
    touched = [read_network(one.network, workspace.store).telemetry for one in standings]
    assert max(map(len, touched)) < STOPS
    for sol, (standing, stops) in enumerate(zip(standings, touched, strict=True), 1):
        mapped = json.loads(workspace.store.path(standing.orientations).read_text())
        assert {row["stop"] for row in mapped["mapped"]} == set(map(str, stops))
        assert len(mapped["holders"]) == sol - len(stops)
        reported = workspace.store.provenance(standing.network)["recipe"]["params"]
        named = [row for row in json.dumps(reported).split('"') if row.startswith("mer2-site")]
        assert set(named) == set(map(str, stops))


def test_the_assembled_network_has_every_stop_with_its_pairs_and_links(traverse):
    workspace, standings = traverse
    ref = standings[-1].network
    part, whole = read_network(ref, workspace.store), whole_network(ref, workspace.store)
    stops = [stop.stop for stop in whole.adjusted.stops]
    assert len(stops) == STOPS > len(part.adjusted.stops)
    assert stops == list(whole.telemetry) == list(whole.sols)
    assert len(whole.adjusted.pairs) == PAIRS * STOPS
    links = shared_ties(whole.adjusted)
    assert all(links[one, other] >= 5 for one, other in pairwise(stops))
    assert not whole.references


def test_a_marginalised_stop_is_as_in_its_last_sol(traverse):
    workspace, standings = traverse
    whole = whole_network(standings[-1].network, workspace.store).adjusted
    gone = {stop.stop for stop in whole.stops} - set(
        read_network(standings[-1].network, workspace.store).telemetry
    )
    for stop in gone:
        parts = [read_network(one.network, workspace.store) for one in standings]
        last = [part for part in parts if stop in part.telemetry][-1].adjusted.stop(stop)
        np.testing.assert_array_equal(last.covariance, whole.stop(stop).covariance)


def test_outlines_of_images_at_unchanged_stops_are_kept_as_they_stand(traverse, monkeypatch):
    workspace, standings = traverse
    (*_, before), (*_, last) = standings[:-1], standings
    entries, landing = workspace.catalogue.images("MER2"), read_map("MER2", workspace).entry.landing

    def draw(network, entries):
        params, kinds = FootprintParams(), OUTLINES
        return draw_vectors.fn("MER2", network, entries, params, landing, workspace, kinds=kinds)

    redrawn = {ref: workspace.store.path(ref).read_bytes() for ref in draw(last.network, entries)}
    for ref in redrawn:
        workspace.store.remove(ref)
    earlier = [entry for entry in entries if entry.sol < STOPS]
    workspace.catalogue.publish(pointers=draw(before.network, earlier))
    drawn = set()
    monkeypatch.setattr(
        vectors, "image_record", lambda *of: drawn.add(of[0].stop) or image_record(*of)
    )
    assert {r: workspace.store.path(r).read_bytes() for r in draw(last.network, entries)} == redrawn
    old, new = (read_network(one.network, workspace.store).references for one in (before, last))
    kept = {stop for stop, ref in new.items() if old.get(stop) == ref}
    assert kept
    assert drawn == {entry.stop for entry in entries} - kept


def test_pruning_keeps_the_parts_of_the_latest_network(traverse):
    workspace, standings = traverse
    ref = standings[-1].network
    before = whole_network(ref, workspace.store)
    prune(workspace, PruningParams(versions=1, youngest=timedelta(0)))
    after = whole_network(ref, workspace.store)
    assert [s.stop for s in after.adjusted.stops] == [s.stop for s in before.adjusted.stops]
    held = next(iter(read_network(ref, workspace.store).references.values()))
    workspace.store.remove(held)
    with pytest.raises(ProductNotFoundError, match="settled"):
        whole_network(ref, workspace.store)
