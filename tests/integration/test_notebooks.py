"""The notebooks of the documentation run in their stated time, and have the expected results."""

import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
SIZE = "averaging=2"
"""Of the images in notebooks; rendering and matching smaller ones takes a fifth of the time."""
sizes = pytest.mark.parametrize("size", ["averaging=4", pytest.param(SIZE, marks=pytest.mark.slow)])


def run(name, monkeypatch, size=SIZE):
    """The variables after all cells of a notebook, whose images may be made of another size."""
    monkeypatch.setattr(mpl, "rcParams", mpl.rcParams.copy())
    mpl.use("agg")
    cells = json.loads((FOLDER / name).read_text())["cells"]
    namespace = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "outputs are not kept"
            source = "".join(cell["source"]).replace(SIZE, size)
            exec(compile(source, f"{name}:{cell['id']}", "exec"), namespace)  # noqa: S102
    mpl.pyplot.close("all")
    return namespace


@sizes
def test_a_notebook_turns_one_pair_into_a_terrain_model(monkeypatch, capsys, size):
    made = run("pair_to_dtm.ipynb", monkeypatch, size)
    assert np.median(abs(made["left_over"])) < 0.02
    assert "interest points" in capsys.readouterr().out


@sizes
def test_a_notebook_shows_that_stated_uncertainty_is_true(monkeypatch, capsys, size):
    made = run("uncertainty.ipynb", monkeypatch, size)
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
