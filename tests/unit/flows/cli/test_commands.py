"""What the command line is like: its panels, filters and speed; `solmap config`, `--version`."""

import json
import re
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

import solmap
from solmap.config.description import configuration_page
from solmap.config.pipeline import load_pipeline
from solmap.config.settings import Settings
from solmap.flows.cli import app
from solmap.products.catalogue.maintenance.pruning import PruningParams
from tests.support.old_store import unpack_old_store

CLI = CliRunner()


def test_the_version_is_that_of_the_package():
    assert CLI.invoke(app, ["--version"]).stdout == f"{solmap.__version__}\n"


def test_the_effective_configuration_is_printed_or_written(tmp_path):
    own, shown = tmp_path / "own.toml", tmp_path / "shown.toml"
    own.write_text("[dtm]\ncell_m = 0.16\n")
    command = ["config", "show", "--pipeline", str(own)]
    printed = CLI.invoke(app, command)
    assert "\ncell_m = 0.16  # metre\n" in printed.stdout
    assert CLI.invoke(app, [*command, "--out", str(shown)]).exit_code == 0
    assert shown.read_text() == printed.stdout
    assert load_pipeline(str(shown)) == load_pipeline(str(own))
    assert CLI.invoke(app, ["config", "check", str(shown)]).exit_code == 0


def test_the_page_of_the_docs_can_be_written(tmp_path):
    page = tmp_path / "page.md"
    assert CLI.invoke(app, ["config", "docs", "--out", str(page)]).exit_code == 0
    assert page.read_text() == configuration_page()


def test_every_fault_of_a_file_is_named(tmp_path):
    file = tmp_path / "own.toml"
    file.write_text("[dtm]\ncel_m = 1\n[slope]\nbaseline_m = 'long'\n[hillshades]\n")
    ended = CLI.invoke(app, ["config", "check", str(file)])
    assert ended.exit_code == 1
    assert "did you mean cell_m?" in ended.stderr
    assert "own.toml.slope.baseline_m takes float, not 'long'" in ended.stderr
    assert "did you mean hillshade?" in ended.stderr


@pytest.mark.parametrize("command", [["check"], ["show", "--pipeline"]])
@pytest.mark.parametrize("text", [None, "[dtm", b"\xff"])
def test_a_file_that_cannot_be_read_is_named(command, text, tmp_path):
    file = tmp_path / "own.toml"
    if text is not None:
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
    ended = CLI.invoke(app, ["config", *command, str(file)])
    assert ended.exit_code == 1
    assert "own.toml" in ended.stderr


def test_the_former_name_of_evaluate_still_works():
    commands = CLI.invoke(app, ["--help"]).stdout
    assert "evaluate" in commands
    assert "judge" not in commands
    assert CLI.invoke(app, ["judge", "--help"]).exit_code == 0


def panels(text):
    """Commands by panel, in their order."""
    found, panel = {}, None
    for line in text.splitlines():
        if title := re.match(r"╭─ (\w+) ─", line):
            panel = found.setdefault(title[1], [])
        elif command := re.match(r"│ ([a-z-]+) ", line):
            panel.append(command[1])
    return found


def test_commands_are_listed_in_panels_and_run_is_first():
    shown = panels(CLI.invoke(app, ["--help"]).stdout)
    shown.pop("Options")
    assert list(shown) == ["Process", "Inspect", "Export", "Correct", "Simulate", "Operate"]
    assert shown["Process"][0] == "run"
    assert sum(map(len, shown.values())) == len(set().union(*shown.values()))


@pytest.mark.parametrize("command", ["positions", "run", "serve", "prune"])
def test_defaults_are_shown(command):
    text = CLI.invoke(app, [command, "--help"]).stdout
    settings = Settings()
    assert f"({settings.store})" in text
    assert "SOLMAP_STORE" in text
    if command == "serve":
        assert str(settings.port) in text
        assert settings.host in text
    if command == "prune":
        params = PruningParams()
        assert f"[default: {params.youngest.days}.0]" in text
        assert f"[default: {params.versions}]" in text


def commands(group, above=()):
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*above, name))
        else:
            yield " ".join((*above, name)), {one for p in command.params for one in p.opts}


ONE_LINE = {
    *("stl", "ties", "simulate", "simulate-mission", "serve", "up", "backup", "restore"),
    *("traverse import", "traverse simulate-mosaic", "poses add", "control add", "orbital add"),
    *("token add", "token revoke", "config check"),
    *("config show", "config docs"),  # TOML and Markdown
}


def test_every_command_with_a_table_offers_json():
    options = dict(commands(typer.main.get_command(app)))
    assert {name for name, known in options.items() if "--json" not in known} == ONE_LINE
    for name in ("positions", "products", "status", "report", "export", "fetch"):
        assert "--mission" in options[name]
        assert options[name] & {"--sol", "--sols"}
    assert "--kind" in options["products"] & options["export"]


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return unpack_old_store(tmp_path_factory.mktemp("store"))


def rows(store, *words):
    ended = CLI.invoke(app, [*words, "--json", "--store", str(store)])
    assert ended.exit_code == 0, ended.output
    return json.loads(ended.stdout)


def test_rows_are_selected_by_mission_sol_and_kind(store):
    for command in ("positions", "products", "status", "report"):
        every = rows(store, command)
        sols = {sol for row in every for sol in row["sols"]}
        assert len(every) > 0
        of_mission = [row for row in every if row["mission"] == "MER2"]
        for alias in ("MER2", "mer2", "Spirit", "MER-A"):
            assert rows(store, command, "--mission", alias) == of_mission
        first = min(sols)
        of_sol = rows(store, command, "--sol", str(first))
        assert of_sol == [row for row in every if first in row["sols"]]
        assert rows(store, command, "--sol", f"{first}-{max(sols)}") == [
            row for row in every if row["sols"]
        ]
        assert rows(store, command, "--sol", "99999") == []
    kinds = rows(store, "products", "--kind", "dtm", "--kind", "slope")
    assert {row["kind"] for row in kinds} == {"dtm", "slope"}


def test_a_token_is_valid_until_it_is_revoked(tmp_path):
    store = unpack_old_store(tmp_path)
    where = ["--store", str(store)]
    made = CLI.invoke(app, ["token", "add", "Ada", "--role", "analyst", *where])
    assert made.exit_code == 0, made.output
    (token,) = (one for one in rows(store, "token", "list") if one["name"] == "Ada")
    assert token["state"] == "valid"
    assert CLI.invoke(app, ["token", "revoke", token["id"], *where]).exit_code == 0
    assert {**token, "state": "revoked"} in rows(store, "token", "list")


def test_poses_of_a_file_are_taken_into_the_store(tmp_path):
    store = unpack_old_store(tmp_path)
    file = tmp_path / "poses.csv"
    file.write_text("site,drive,x_m,y_m,z_m\n10,0,0,0,0\n")
    ended = CLI.invoke(app, ["poses", "add", str(file), "--store", str(store)])
    assert ended.exit_code == 0, ended.output
    assert "poses.csv" in ended.output


def test_the_store_of_the_environment_is_used(store, monkeypatch):
    monkeypatch.setenv("SOLMAP_STORE", str(store))
    assert len(json.loads(CLI.invoke(app, ["positions", "--json"]).stdout)) > 0
    monkeypatch.setenv("SOLMAP_STORE", "")
    assert "solmap-store is not a store" in CLI.invoke(app, ["positions"]).stderr


def test_files_of_poses_are_checked_before_the_engine_starts(tmp_path):
    ended = CLI.invoke(app, ["run"])
    assert ended.exit_code == 1
    assert "name the folder that the downlink's files lie in" in ended.stderr
    file = tmp_path / "notes.csv"
    where = ["--store", str(tmp_path / "store")]
    ended = CLI.invoke(app, ["run", "--places", str(file), *where])
    assert "notes.csv does not exist" in ended.stderr
    file.write_text("site,drive,x_m,y_m,z_m\n1,2,0,0,north\n")
    ended = CLI.invoke(app, ["run", "--places", str(file), *where])
    assert ended.exit_code == 1
    assert "notes.csv, row 1: x_m, y_m, z_m should be numbers" in ended.stderr
    file.write_text("site,drive,x_m,y_m,z_m\n1,2,0,0,0\n")
    ended = CLI.invoke(app, ["run", "--places", str(file), *where])
    assert ended.exit_code == 1
    assert "store" in ended.stderr
    assert not (tmp_path / "store").exists()


def test_a_folder_without_images_is_refused_before_the_engine_starts(tmp_path):
    (tmp_path / "empty" / "below").mkdir(parents=True)
    (tmp_path / "empty" / "notes.txt").touch()
    words = ["run", str(tmp_path / "empty"), "--store", str(tmp_path / "store")]
    command = [sys.executable, "-m", "solmap.flows.cli", *words]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "it holds no image (.img, .png, .jpg) and no vector file" in ended.stderr
    assert not (tmp_path / "store").exists()


MODULES = """
import sys
from typer.testing import CliRunner
from solmap.flows.cli import app
assert CliRunner().invoke(app, sys.argv[1:]).exit_code == 0
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""


@pytest.mark.parametrize(
    ("words", "unwanted"),
    [
        (["--help"], {"numpy", "sqlalchemy", "pydantic", "scipy", "prefect"}),
        (["run", "--help"], {"numpy", "sqlalchemy", "scipy", "prefect"}),
        (["traverse", "export", "--help"], {"numpy", "sqlalchemy", "scipy", "prefect"}),
        (["positions"], {"scipy", "cv2", "rasterio", "matplotlib", "prefect", "tenacity"}),
        (["products"], {"scipy", "cv2", "rasterio", "matplotlib", "prefect", "tenacity"}),
    ],
    ids=lambda one: one[0] if isinstance(one, list) else "",
)
def test_a_command_imports_only_what_it_needs(words, unwanted, store):
    words = words if "--help" in words else [*words, "--store", str(store)]
    command = [sys.executable, "-c", MODULES, *words]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert set(ended.stdout.split()) & unwanted == set()
