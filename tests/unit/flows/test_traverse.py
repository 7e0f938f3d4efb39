"""The paper's section 4 on simulated points: the answer is known, and found to the centimetre."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.traverse.georeference import parse_points, simulate_mosaic


def run(*command):
    ran = CliRunner().invoke(app, ["traverse", *map(str, command)])
    assert ran.exit_code == 0, ran.output
    return ran.output


@pytest.mark.parametrize(("seed", "rotation"), [(1, 1.3), (2, -4.0), (3, 0.0)])
def test_rotation_differences_and_end_equal_those_put_in(tmp_path, seed, rotation):
    file = tmp_path / "points.csv"
    run("simulate-mosaic", file, "--seed", seed, "--rotation", rotation)
    truth = json.loads(file.with_suffix(".truth.json").read_text())
    (found,) = json.loads(run("georeference", file, "--json"))
    way_m = 3000.0
    assert found["rotation_deg"] == pytest.approx(rotation, abs=np.degrees(0.01 / way_m))
    assert found["scale"] == pytest.approx(truth["scale"], abs=0.01 / way_m)
    for point, residual, difference in zip(
        found["points"], truth["residuals_m"], truth["differences_m"], strict=True
    ):
        assert point["residual_east_m"] == pytest.approx(residual[0], abs=0.01)
        assert point["residual_north_m"] == pytest.approx(residual[1], abs=0.01)
        assert point["difference_m"] == pytest.approx(difference, abs=0.01)
    assert found["end_percent"] == pytest.approx(truth["end_percent"], abs=100 * 0.01 / way_m)
    assert found["end_m"] == pytest.approx(truth["differences_m"][-1], abs=0.01)


def test_displacements_are_not_part_of_a_similarity():
    made = simulate_mosaic(np.random.default_rng(5))
    left, track = made.residuals_m, made.points.map_m + made.residuals_m
    track = track - track.mean(axis=0)  # as the mosaic has it, turned and scaled
    np.testing.assert_allclose(left.sum(axis=0), 0.0, atol=1e-9)
    assert (left * track).sum() == pytest.approx(0.0, abs=1e-6)
    across = track[:, 0] * left[:, 1] - track[:, 1] * left[:, 0]
    assert across.sum() == pytest.approx(0.0, abs=1e-6)
    assert np.sqrt((left**2).sum(axis=1).mean()) == pytest.approx(8.0)


def test_the_sentence_has_the_form_of_the_papers(tmp_path):
    file = tmp_path / "points.csv"
    run("simulate-mosaic", file)
    message_ = " ".join(run("georeference", file).split())
    assert "turned by 1.300 degrees" in message_
    assert "% of the way at the end" in message_


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,east_m\nP1,2", "points.csv: the first line lacks mosaic_x_m"),
        ("name,mosaic_x_m,mosaic_y_m,east_m,north_m\nP1,1,2,x,4", "line 2: four numbers"),
        ("name,mosaic_x_m,mosaic_y_m,east_m,north_m\nP1,1,2,inf,4", "line 2: .* finite"),
    ],
)
def test_broken_tables_are_refused_with_their_line(text, message):
    with pytest.raises(TraverseError, match=message):
        parse_points(text, "points.csv")
