"""Whatever a command is called with, it ends in a few lines and an exit code, and no traceback."""

import json
import logging
import os
import random
import shutil
import socket

import pytest
import typer
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.flows.runtime import engine
from solmap.products.store.process import log_to_store
from tests.support.old_store import unpack_old_store

CLI = CliRunner()
CODES = {0, 1, 2, 130}
SERVERS = {("serve",), ("up",)}
WRITTEN = {"--out", "--png", "--linearised", "--figure"}
UNSAFE = {"--yes", "--replace", "--repair", "--open"}
"""Options that would change the stores that the tests share, or open a browser."""
STORES = ("absent", "empty", "whole", "text", "truncated", "file", "hostile [red]\x1b[31m")
NUMBERS = ("0", "-1", "1", "155", "999999", "99999999999", "1" + "0" * 400, "nan", "inf", "-1e308")
WORDS = ("", "MER2", "mer1", "XX", "[/red]", "\x1b[31m\udcff", "../..", "nan,nan", "1e308,1", "1,2")
STOP = "MER2-site137-drive0000"


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """Stores that are whole, broken in several ways, or none."""
    folder = tmp_path_factory.mktemp("stores")
    unpack_old_store(folder).rename(folder / "whole")
    for name in ("text", "truncated"):
        shutil.copytree(folder / "whole", folder / name)
    (folder / "text" / "catalogue.sqlite").write_text("no database")
    os.truncate(folder / "truncated" / "catalogue.sqlite", 5000)
    (folder / "empty").mkdir()
    (folder / "file").write_text("no store")
    shutil.copytree(folder / "empty", folder / STORES[-1])
    return folder


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Files and folders that no command expects."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "text.csv").write_text("a,b\n1,nan\n[/red],\x1b[31m\n")
    (folder / "bytes.img").write_bytes(bytes(range(256)) * 20)
    (folder / "[red]\x1b[31m\n\udcff.lbl").write_text("PDS_VERSION_ID = PDS3\n")
    (folder / "empty.toml").touch()
    os.mkfifo(folder / "fifo.img")
    (folder / "folder").mkdir()
    there = sorted(map(str, folder.iterdir()))
    return [*there, "/dev/null", "/dev/null/x", str(folder / "new"), ""]


@pytest.fixture(autouse=True)
def no_engine(monkeypatch, tmp_path):
    """An engine that does not start, no browser, and a folder to write into."""
    # a log handler of one call holds that call's console, which is closed in the next one
    monkeypatch.setattr(logging, "raiseExceptions", False)

    def refuse(*_):
        raise TimeoutError("no engine")

    monkeypatch.setattr(engine, "start_engine", refuse)
    monkeypatch.setattr(typer, "launch", lambda *_: 0)
    monkeypatch.chdir(tmp_path)


def commands(group=None, above=()):
    for name, command in (group or typer.main.get_command(app)).commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*above, name))
        else:
            yield (*above, name), command


COMMANDS = dict(commands())


def absurd(command, store, paths, rng):
    """Arguments of a command, each of its kind or of another."""
    words = []
    for one in command.params:
        kinds = str(one.type_descriptor.annotation)
        option = one.opts[0] if one.opts[0].startswith("-") else None
        if option == "--help" or option in UNSAFE:
            continue
        if option == "--store":
            words += [option, store]
            continue
        if not one.required and rng.random() < 0.5:
            continue
        if "bool" in kinds:
            words.append(option)
            continue
        numbers = "int" in kinds or "float" in kinds
        values = NUMBERS if numbers else paths if "Path" in kinds else (*WORDS, STOP, *paths[:2])
        if option in WRITTEN or command.name in {"stl", "simulate-mosaic"}:
            values = [value for value in values if "fifo" not in value]  # written to, they wait
        words += ([option] if option else []) + [rng.choice(values)]
    return words


def check(words):
    ended = CLI.invoke(app, words)
    assert ended.exit_code in CODES, (words, ended.output, ended.exc_info)
    assert "Traceback" not in ended.output, words
    if ended.exit_code:
        assert len(ended.stderr.splitlines()) <= 12, (words, ended.output)
        assert ended.stderr.replace("\n", "").isprintable(), (words, ended.output)
        assert ended.stderr.strip(), words


def check_at_random(path, stores, paths, rounds):
    rng = random.Random(" ".join(path))  # noqa: S311 - repeatable
    has_store = any("--store" in one.opts for one in COMMANDS[path].params)
    for store in STORES if has_store else STORES[:2]:
        for _ in range(rounds):
            check([*path, *absurd(COMMANDS[path], str(stores / store), paths, rng)])


RANDOM = sorted(set(COMMANDS) - SERVERS - {("simulate",)})


@pytest.mark.parametrize("path", RANDOM, ids="-".join)
def test_invalid_arguments_are_refused(path, stores, paths):
    check_at_random(path, stores, paths, rounds=1)


@pytest.mark.slow
@pytest.mark.parametrize("path", RANDOM, ids="-".join)
def test_many_invalid_arguments_are_refused(path, stores, paths):
    check_at_random(path, stores, paths, rounds=30)


SLIPS = [
    (["token", "add", "me", "--days", "99999999999"], 2, "36500"),
    (["report", "MER2", "9999999"], 2, "SOL"),
    (["report", "MER2", "999999"], 1, "MER2 has no image of sol 999999"),
    (["report", "MER2", "999"], 1, "MER2 has no image of sol 999"),
    (["report", "spirit", "999"], 1, "MER2 has no image of sol 999"),
    (["report", "opportunity", "156"], 1, "holds MER2; MER1 is not one of them"),
    (["positions", "--mission", "MER-B"], 1, "nothing is of MER1; there are MER2"),
    (["products", "--kind", "dem"], 1, "nothing is of kind dem; there are"),
    (["products", "--sol", "x"], 2, "sols should be like 155, 155-157"),
    (["report", "MER2"], 1, "name the sol too"),
    (["report", "MER2", "155", "--out", "/nodir/x"], 1, "/nodir/x: No such file or directory"),
    (["report", "--mission", "XX"], 1, "XX is not one of them"),
    (["rig", "--mission", "XX"], 1, "XX is not one of them"),
    (["evaluate", "."], 1, "truth.json: No such file or directory"),
    (["judge", "."], 1, "truth.json: No such file or directory"),
    (["control", "list", "--mission", "MER1"], 1, "MER1 is not one of them"),
    (["orbital", "add", "/nonexistent"], 1, "/nonexistent does not exist"),
    (["orbital", "add", "/dev/zero"], 1, "/dev/zero is not a file"),
    (["traverse", "export", "out", "--mission", "MSL"], 1, "MSL is not one of them"),
    (["dip", "ground", "XX", "--corner", "nan,nan"], 1, "XX"),
    (["dip", "rocks", "XX"], 1, "XX"),
    (["stl", "XX", "x.stl"], 1, "no stop XX has a terrain model"),
    (["stl", "XX", "x.stl", "--base-m", "nan"], 2, "less than or equal to 1000"),
    (["prune", "--older-than", "nan"], 2, "less than or equal to 36500"),
    (["run", "/nonexistent"], 1, "/nonexistent is not a folder"),
    (["run", "/dev/null"], 1, "/dev/null is not a folder"),
    (["adjust", "--mission", "opportunity"], 1, "holds MER2; MER1 is not one of them"),
    (["adjust"], 1, "no engine"),
    (["adjust", "--overall"], 1, "no engine"),
    (["fetch", "--mission", "moon", "--sols", "1", "--out", "x"], 1, "no mission 'MOON'"),
    (["fetch", "--mission", "spirit", "--sols", "x", "--out", "x"], 2, "155, 155-157"),
    (["ties", "/nonexistent"], 1, "/nonexistent does not exist"),
    (["inspect", "/dev/zero", "."], 1, "/dev/zero"),
]


@pytest.mark.parametrize(("words", "code", "text"), SLIPS, ids=lambda one: str(one)[:40])
def test_a_common_typing_error_is_reported_in_one_line(words, code, text, stores):
    has_store = "--store" in {name for one in COMMANDS[_path(words)].params for name in one.opts}
    ended = CLI.invoke(app, [*words, *["--store", str(stores / "whole")] * has_store])
    assert ended.exit_code == code, ended.output
    assert text in " ".join(ended.stderr.replace("│", "").split())
    assert code == 2 or ended.stderr.count("\n") == len(ended.stderr.splitlines()) <= 2


def _path(words):
    return tuple(words[:1]) if tuple(words[:1]) in COMMANDS else tuple(words[:2])


@pytest.mark.parametrize(
    "words",
    [
        ["positions"],
        ["products"],
        ["status"],
        ["report"],
        ["report", "MER2", "1"],
        ["rig"],
        ["evaluate", "."],
        ["stl", "XX", "x.stl"],
        ["dip", "rocks", "XX"],
        ["traverse", "export", "out"],
        ["control", "list"],
        ["adjust"],
        ["serve"],
        ["ties", __file__],
        ["traverse", "import", __file__],
        ["prune"],
        ["token", "list"],
    ],
    ids=" ".join,
)
def test_commands_that_read_create_no_store(words, tmp_path):
    (tmp_path / "empty").mkdir()
    for store in (tmp_path / "empty", tmp_path / "absent"):
        ended = CLI.invoke(app, [*words, "--store", str(store)])
        assert ended.exit_code == 1, ended.output
        assert "is not a store" in ended.stderr
    assert not (tmp_path / "absent").exists()
    assert not list((tmp_path / "empty").iterdir())


@pytest.mark.parametrize("terrain", ["hill", "[/red]", ""])
def test_unknown_ground_is_named(terrain, tmp_path):
    ended = CLI.invoke(app, ["simulate", str(tmp_path / "out"), "--terrain", terrain])
    assert ended.exit_code == 1
    assert "plains" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def raising(error, monkeypatch):
    """Result of a command in which an error is raised."""

    def fail(*_):
        raise error

    monkeypatch.setattr("solmap.config.description.configuration_page", fail)
    return CLI.invoke(app, ["config", "docs"])


def test_an_unexpected_error_is_a_line(monkeypatch):
    ended = raising(KeyError("x[/red]"), monkeypatch)
    assert ended.exit_code == 70
    assert ended.stderr == (
        "error unexpected KeyError: 'x[/red]'; the traceback is shown with SOLMAP_DEBUG=1, "
        "please report it\n"
    )


def test_its_traceback_is_shown_on_request(monkeypatch):
    monkeypatch.setenv("SOLMAP_DEBUG", "1")
    error = KeyError("x")
    assert raising(error, monkeypatch).exception is error


def test_its_traceback_is_in_the_log_of_a_run(monkeypatch, tmp_path):
    log_to_store(tmp_path, "flows")
    try:
        ended = raising(KeyError("x"), monkeypatch)
    finally:
        for handler in logging.getLogger("solmap").handlers[:]:
            logging.getLogger("solmap").removeHandler(handler)
            handler.close()
    file = tmp_path / "logs" / "flows.jsonl"
    assert f"the traceback is in {file}" in ended.stderr
    assert "Traceback" in json.loads(file.read_text())["traceback"]


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (KeyboardInterrupt(), 130, "error interrupted; what was made stays\n"),
        (MemoryError(), 1, "error there is not enough memory\n"),
        (PermissionError(13, "Permission denied", "a/b"), 1, "error a/b: Permission denied\n"),
        (TimeoutError("no answer"), 1, "error no answer\n"),
        (BrokenPipeError(32, "Broken pipe"), 1, ""),
    ],
)
def test_other_exit_causes(error, code, text, monkeypatch):
    ended = raising(error, monkeypatch)
    assert (ended.exit_code, ended.stderr) == (code, text)


@pytest.mark.parametrize("command", ["serve", "up"])
def test_an_invalid_port_is_refused(command):
    ended = CLI.invoke(app, [command, "--port", "0"])
    assert ended.exit_code == 2
    assert "equal to 1 " in ended.stderr


def test_a_wrong_setting_ends_a_command_with_a_line(monkeypatch):
    monkeypatch.setenv("SOLMAP_PORT", "abc")
    monkeypatch.setenv("SOLMAP_STOR", "x")
    ended = CLI.invoke(app, ["positions"])
    assert ended.exit_code == 1
    assert (
        "warning SOLMAP_STOR is not a setting of solmap; did you mean SOLMAP_STORE?" in ended.stderr
    )
    assert "error SOLMAP_PORT=abc: it should be a valid integer" in ended.stderr


@pytest.mark.parametrize("command", ["serve", "up"])
def test_a_port_in_use_is_named_before_anything_starts(command, stores):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        said = CLI.invoke(app, [command, "--store", str(stores / "whole"), "--port", port])
    assert said.exit_code == 1
    assert f"cannot listen at 127.0.0.1:{port}" in " ".join(said.output.split())
    assert "map at" not in said.output
