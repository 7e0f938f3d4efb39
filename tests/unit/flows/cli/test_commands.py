"""`solmap config` and `solmap --version`."""

import pytest
from typer.testing import CliRunner

import solmap
from solmap.config.description import configuration_page
from solmap.config.pipeline import load_pipeline
from solmap.flows.cli import app

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


def test_everything_wrong_with_a_file_is_named(tmp_path):
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


def test_judge_is_another_name_of_evaluate():
    commands = CLI.invoke(app, ["--help"]).stdout
    assert "evaluate" in commands
    assert "judge" not in commands
    assert CLI.invoke(app, ["judge", "--help"]).exit_code == 0
