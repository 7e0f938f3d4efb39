"""A traverse, sol by sol at network level: what a sol keeps does not grow, all of it is there."""

import json
from datetime import timedelta
from itertools import pairwise

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.quality.weaknesses import shared_ties
from solmap.products.catalogue.maintenance.pruning import PruningParams, prune
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.network import read_network, whole_network
from tests.support.mission_growth import walked
from tests.support.simulated_sols import SimulatedSols

STOPS, PAIRS = 10, 2


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
