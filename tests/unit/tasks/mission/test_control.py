"""Measured control becomes a product, and enters the next network."""

import json
from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.network import select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.synthetic.networks import simulate_network
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint, lon_lat
from solmap.products.errors import ProductError
from solmap.products.formats.documents.adjusted_network import network_document
from solmap.products.formats.documents.archives import pose_document
from solmap.products.formats.documents.control import read_control
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel
from solmap.tasks.mission.control import FrameParams, control_of, take_control
from solmap.tasks.mission.publish import publish
from tests.support.adjustment.control_statistics import in_mosaic

LANDING = LandingPoint("somewhere", 175.47, -14.57, 3_396_190.0, "chosen")
EXACT = FrameParams(0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def network():
    return simulate_network(
        np.random.default_rng(3), stops=3, pairs_per_stop=5, inter_ties=6, intra_ties=0
    )


@pytest.fixture
def stored(network, tmp_path):
    """A store with the adjusted network."""
    workspace = Workspace.open(tmp_path / "store")
    adjusted, report = adjust_overall(network[0], AdjustmentParams())
    document = {
        "mission": "TEST",
        "sol": 3,
        "stops": [
            {"mission": s.stop.mission, "site": s.stop.site, "drive": s.stop.drive, "sols": [1],
             "telemetry": pose_document(s.lsl_from_rover)}
            for s in network[0].stops
        ],
        "network": network_document(adjusted, [report]),
        "reports": [],
        "links": [],
    }  # fmt: skip
    recipe = Recipe(ProductKind.NETWORK, Scope(ScopeLevel.SOL, "test-sol0003"))
    ref = workspace.store.make(recipe, lambda path: path.write_text(json.dumps(document)) and None)
    return workspace, ref


def taken(stored, text, params=None, name="by_hand.csv"):
    workspace, ref = stored
    data = text.encode()
    return take_control(name, data, ref, params or FrameParams(), LANDING, workspace.store)


def test_places_in_degrees_are_transformed_to_the_local_map(stored):
    lon, lat = lon_lat(LANDING, 21.5, -8.25)
    text = f"stop,longitude,latitude,sigma_m\n1/10,{lon[0]:.12f},{lat[0]:.12f},0.5\n"
    frame, (control,) = read_control(taken(stored, text), stored[0].store)
    assert (control.east_m, control.north_m) == pytest.approx((21.5, -8.25), abs=1e-4)
    assert frame.name == "by_hand-csv"
    np.testing.assert_allclose(frame.centre_m, [21.5, -8.25], atol=1e-4)


def test_a_point_seen_from_the_stop_places_it_as_precisely_as_north_is_known(stored):
    workspace, ref = stored
    stop = read_network(ref, workspace.store).adjusted.stops[1]
    north, east, _ = stop.lsl_from_rover.translation_m
    text = (
        "stop,east_m,north_m,sigma_m,map_east_m,map_north_m\n"
        f"1/10,104.0,203.0,0.5,{east + 20.0},{north}\n"
    )
    ref = taken(stored, text, FrameParams(rotation_deg=1.0))
    _, (control,) = read_control(ref, workspace.store)
    assert (control.east_m, control.north_m) == pytest.approx((84.0, 203.0))
    sigma = np.hypot(0.5, 20.0 * np.radians(1.0))
    np.testing.assert_allclose(np.sqrt(np.diagonal(control.covariance)), sigma)


def test_a_stop_outside_the_network_is_refused_with_the_existing_ones(stored):
    with pytest.raises(AdjustmentError, match=r"by_hand.csv: test-site0009-drive0001 is not in"):
        taken(stored, "stop,east_m,north_m,sigma_m\n9/1,1,2,3\n")


def test_places_in_a_mosaic_are_less_certain_farther_from_its_middle(stored):
    text = "stop,east_m,north_m,sigma_m\n1/10,0,0,0.1\n1/20,2000,0,0.1\n"
    for params, sigma_m in ((FrameParams(), 2.5), (EXACT, 0.0)):
        _, control = read_control(taken(stored, text, params), stored[0].store)
        for one in control:
            np.testing.assert_allclose(np.diagonal(one.covariance), 0.1**2 + sigma_m**2)


def test_a_negative_standard_deviation_of_the_frame_is_refused():
    with pytest.raises(ProductError, match="shift_m is a standard deviation: zero"):
        FrameParams(shift_m=-1.0)


def test_published_control_counts_for_its_mission_and_moves_the_next_network(network, stored):
    workspace, _ = stored
    net, truth = network
    north, east, _ = truth.lsl_from_rover[2].translation_m
    ref = taken(stored, f"stop,east_m,north_m,sigma_m\n1/20,{east + 3.0},{north},0.001\n", EXACT)
    entry = MissionEntry("TEST", "test", LANDING, None)
    publish.fn(entry, [], [ref], (), workspace)
    assert control_of("TEST", workspace) == (ref,)
    assert control_of("MER2", workspace) == ()
    frame, control = read_control(ref, workspace.store)
    loose = replace(net, ties=without_ties(net))
    moved, _ = adjust_overall(
        with_control(loose, [frame], control, AdjustmentParams()), AdjustmentParams()
    )
    assert moved.stops[2].lsl_from_rover.translation_m[1] == pytest.approx(east + 3.0, abs=0.05)


def test_a_rotated_mosaic_without_stated_errors_rotates_no_stop():
    """It was turned by 1.3 degrees, and took the network with it."""
    for seed in (0, 1):
        found = in_mosaic(seed, turn_deg=1.3)
        assert found.first_turned_deg == 0.0
        assert found.azimuth_deg[1] < 0.12
        assert found.plan_m[1] < 1.2 * found.plan_m[0]


def test_a_mosaic_wrongly_stated_as_exact_is_refused():
    """What is exact lies on the map itself, which begins with the first stop."""
    found = in_mosaic(0, turn_deg=1.3, params=EXACT)
    assert found.first_turned_deg == 0.0
    assert found.refused == 3
    assert found.plan_m[1] == pytest.approx(found.plan_m[0], rel=0.05)


@pytest.mark.slow
def test_a_mosaic_without_stated_errors_helps_and_sigmas_stay_true():
    found = [in_mosaic(seed) for seed in range(60)]
    plan_m, azimuth_deg = (
        np.array([getattr(one, name) for one in found]) for name in ("plan_m", "azimuth_deg")
    )
    assert np.median(plan_m[:, 1]) < 0.75 * np.median(plan_m[:, 0])
    assert np.median(azimuth_deg[:, 1]) < 0.5 * np.median(azimuth_deg[:, 0])
    assert 0.85 < np.mean([one.nees[1] for one in found]) < 1.15
    # worse than without it as often as chance has it; margin: two deviations of 60 networks
    shares, expected = (np.array([getattr(one, name) for one in found]) for name in
                        ("no_larger", "expected"))  # fmt: skip
    assert (shares.mean(axis=(0, 1)) > expected.mean(axis=(0, 1)) - 0.1).all()


def without_ties(net):
    """No ties: telemetry and control alone."""
    return select(net.ties, np.zeros(len(net.ties), dtype=bool))
