"""`solmap rig` on a store of a traverse: a bent rig stands out, and nothing changes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from tests.support.adjustment.bent_rigs import with_bent_rig
from tests.support.mission_growth import walked
from tests.support.simulated_sols import SimulatedSols

CLI = CliRunner()
STOPS = 2
BENT_DEG = np.array([0.02, 0.05, -0.03])
"""Toe-in of 1.1 pixels."""
LANDING = LandingPoint("somewhere", 175.47, -14.57, 3_396_190.0, "chosen")


def walked_store(root, bend_deg):
    sols = SimulatedSols.of(STOPS, inter_ties=200, intra_ties=20)
    mission = sols.mission
    network = with_bent_rig(mission.network, mission.truth, np.radians(bend_deg), 0.0)
    sols = replace(sols, mission=replace(mission, network=network))
    for _ in walked(sols, STOPS, root):
        pass
    return root


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    return walked_store(tmp_path_factory.mktemp("bent"), BENT_DEG)


def rows_of(root, *options):
    ended = CLI.invoke(app, ["rig", "--json", "--store", str(root), *options])
    assert ended.exit_code == 0, ended.stderr
    return json.loads(ended.stdout)


def test_a_bent_rig_is_found_and_marked(bent):
    rows = rows_of(bent, "--mission", "mer2")
    assert [(row["camera"], row["unit"]) for row in rows] == [
        *3 * [("NAVCAM", "degree")],
        ("NAVCAM", "mm"),
    ]
    true = np.append(BENT_DEG, 0.0)
    for row, expected in zip(rows, true, strict=True):
        assert abs(row["value"] - expected) < 4 * row["sigma"], row
        assert row["pairs"] == 10 * STOPS
        assert row["pairs_rotated_by_matching"] == 0
    toe_in = rows[1]
    assert toe_in["component"] == "toe-in, about y"
    assert toe_in["stands_out"]
    assert toe_in["sigma"] < 0.01  # degrees: a fifth of the bend
    assert toe_in["parallax_px"] == pytest.approx(1.1, abs=0.4)
    assert not rows[3]["stands_out"]
    assert toe_in["sigma0_corrected"] < toe_in["sigma0_labelled"]


@pytest.mark.slow
def test_a_rig_that_agrees_with_its_label_is_not_marked(tmp_path):
    rows = rows_of(walked_store(tmp_path, np.zeros(3)))
    assert not any(row["stands_out"] for row in rows)


def test_the_table_marks_outliers_and_makes_no_product(bent):
    store = Workspace.open(bent).store
    before = set(store.refs())
    ended = CLI.invoke(app, ["rig", "--store", str(bent)])
    assert ended.exit_code == 0
    assert "toe-in, about y" in ended.stdout
    assert "nothing was changed" in ended.stdout
    assert set(store.refs()) == before


def test_missions_without_a_rig_are_refused(bent, tmp_path):
    def refused(root):
        ended = CLI.invoke(app, ["rig", "--mission", "MER1", "--store", str(root)])
        assert ended.exit_code == 1
        return ended.stderr

    assert "holds MER2; MER1 is not one of them" in refused(bent)
    workspace = Workspace.open(tmp_path)
    workspace.catalogue.publish(missions=[MissionEntry("MER1", "Opportunity", LANDING, None)])
    assert "no network of MER1 has been adjusted yet" in refused(tmp_path)
