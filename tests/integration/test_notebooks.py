"""The notebooks of the documentation run in their stated time, and have the expected results."""

import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "tutorials"


def run(name, monkeypatch):
    """The variables after all cells of a notebook."""
    monkeypatch.setattr(mpl, "rcParams", mpl.rcParams.copy())
    mpl.use("agg")
    cells = json.loads((FOLDER / name).read_text())["cells"]
    namespace = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "outputs are not kept"
            exec(compile("".join(cell["source"]), f"{name}:{cell['id']}", "exec"), namespace)  # noqa: S102
    mpl.pyplot.close("all")
    return namespace


def test_a_notebook_turns_one_pair_into_a_terrain_model(monkeypatch, capsys):
    made = run("pair_to_dtm.ipynb", monkeypatch)
    assert np.median(abs(made["left_over"])) < 0.02
    assert "interest points" in capsys.readouterr().out


def test_a_notebook_shows_that_stated_uncertainty_is_true(monkeypatch, capsys):
    made = run("uncertainty.ipynb", monkeypatch)
    inside, error, sigma = made["within"], made["error"], made["dtm"].sigma_m
    assert (abs(error) <= 2 * sigma)[inside].mean() > 0.9
    assert "within 1, 2, 3 sigma" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_notebook_turns_a_traverse_into_a_map(monkeypatch):
    made = run("traverse_to_map.ipynb", monkeypatch)
    assert np.linalg.norm(made["error"][1]) < 0.05 < np.linalg.norm(made["error_before"][1])
    assert np.nanmedian(abs(made["height_error"])) < 0.02


def test_every_notebook_is_run():
    text = Path(__file__).read_text()
    assert all(f'run("{path.name}"' in text for path in FOLDER.glob("*.ipynb"))
