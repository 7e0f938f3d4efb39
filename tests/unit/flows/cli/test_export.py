"""`solmap export` and reports as PDF, as they are typed."""

import json

import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app
from tests.unit.gis_server.conftest import build

CLI = CliRunner()


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> str:
    return str(build(tmp_path_factory.mktemp("store")).root)


def test_a_folder_is_exported_and_updated(store, tmp_path):
    target = tmp_path / "out"
    requested = ["export", str(target), "--store", store, "--mission", "Spirit", "--sol", "155-157"]
    requested += ["--stop", "10/64", "--kind", "dtm", "--kind", "slope", "--since", "2020-01-01"]
    first = CLI.invoke(app, requested)
    assert first.exit_code == 0, first.stderr
    assert {path.name for path in (target / "maps").iterdir()} == {
        "MER2_sol0156_site010_drive0064_dtm_8cm.tif",
        "MER2_sol0156_site010_drive0064_slope_8cm.tif",
    }
    again = CLI.invoke(app, requested)
    assert "0 written, 10 unchanged, 0 removed" in again.stdout.replace("\n", " ")
    message = json.loads(CLI.invoke(app, [*requested, "--json"]).stdout)
    assert (message["written"], message["unchanged"], message["removed"]) == (0, 10, 0)
    assert all((target / name).is_file() for name in message["files"])


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--kind", "dem"], "there is no kind dem"),
        (["--stop", "south"], "does not name a stop; SITE/DRIVE is expected"),
        (["--sol", "900"], "nothing is selected"),
    ],
)
def test_a_failed_export_is_one_line_and_leaves_no_file(store, tmp_path, options, text):
    ended = CLI.invoke(app, ["export", str(tmp_path / "out"), "--store", store, *options])
    assert ended.exit_code == 1
    assert text in ended.stderr.replace("\n", " ")
    assert list(tmp_path.iterdir()) == []


def test_the_report_of_a_sol_is_a_pdf_for_a_pdf_file_name(store, tmp_path):
    file = tmp_path / "sol.pdf"
    ended = CLI.invoke(app, ["report", "MER2", "156", "--store", store, "--out", str(file)])
    assert ended.exit_code == 0, ended.stderr
    assert file.read_bytes().startswith(b"%PDF")
