"""What files, labels and messages hold reaches a terminal as text, whatever it is."""

import io
import json
import logging
import re

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from solmap.flows.cli import console
from solmap.flows.runtime.progress import Step
from solmap.products.store.process import JsonLineFormatter

ANSI = re.compile(r"\x1b\[[0-9;]*m")
HOSTILE = "[/red][bold]:smile: \x1b[31m\x9b2J\r\n\u202etxt\u2028\x00 \udcff {0} %s"


def shown(capsys):
    captured = capsys.readouterr()
    (captured.out + captured.err).encode()  # no lone surrogate is left
    return captured.out + captured.err


def assert_harmless(text, lines=1):
    assert text.count("\n") == lines
    assert text.replace("\n", "").isprintable()


def test_terminal_control_characters_are_escaped():
    assert console.printable(HOSTILE) == (
        r"[/red][bold]:smile: \x1b[31m\x9b2J\r\n\u202etxt\u2028\x00 \udcff {0} %s"
    )
    assert console.printable("Größe 5 µm") == "Größe 5 µm"


@given(st.text(st.characters(), max_size=40))
def test_every_text_is_one_printable_line(text):
    assert console.printable(text).isprintable()
    console.printable(text).encode()


def fail(text):
    with pytest.raises(typer.Exit):
        console.fail(text)


@pytest.mark.parametrize(
    "put",
    [
        console.print_line,
        lambda text: console.note("failed", text),
        fail,
        lambda text: console._print_finished(Step(text, 2, 2)),
    ],
)
def test_a_line_is_printed_unchanged(put, capsys):
    put(HOSTILE)
    text = shown(capsys)
    assert console.printable(HOSTILE) in text
    assert_harmless(text)


def test_a_piped_table_has_cells_separated_by_tabs(capsys):
    rows = [{"subject": HOSTILE, "notes": [HOSTILE], "at": 1.23456}, {"subject": "b"}]
    console.show_rows(rows, ["subject", "notes", "at"], as_json=False)
    text = shown(capsys)
    lines = [line.split("\t") for line in text.splitlines()]
    harmless = console.printable(HOSTILE)
    assert lines == [["subject", "notes", "at"], [harmless, harmless, "1.235"], ["b", "", ""]]
    assert_harmless(text.replace("\t", ""), 3)


@pytest.mark.parametrize("width", [40, 80])
def test_a_table_fits_the_terminal(width, monkeypatch):
    terminal = Console(force_terminal=True, width=width, soft_wrap=True, file=io.StringIO())
    monkeypatch.setattr(console, "_out", terminal)
    path = "/a/long/path/of/a/product/" + 8 * "0123456789" + ".tif"
    console.show_rows([{"kind": HOSTILE, "path": path}], ["kind", "path"], as_json=False)
    text = ANSI.sub("", terminal.file.getvalue())
    assert max(map(len, text.splitlines())) <= width
    cells = [line.split("│") for line in text.splitlines() if "│" in line]
    assert "".join(cell[2].strip() for cell in cells) == path  # folded, nothing is cut off
    assert_harmless(text, text.count("\n"))


def test_rows_as_json_are_ascii(capsys):
    console.show_rows([{"subject": HOSTILE}], ["subject"], as_json=True)
    text = shown(capsys)
    assert text.isascii()
    assert json.loads(text) == [{"subject": HOSTILE}]


def test_a_progress_bar_has_the_unchanged_label_of_the_stage():
    bars = console._bars()
    listener = console._BarListener(bars)
    listener(Step(HOSTILE, 1, 2))
    listener(Step(HOSTILE, 2, 2))
    (task,) = bars.tasks
    (label, *_) = (column(task) for column in bars.columns)
    assert str(label).strip() == console.printable(HOSTILE)


def test_a_line_of_a_log_is_ascii_json():
    record = logging.makeLogRecord({"msg": HOSTILE, "file": HOSTILE})
    line = JsonLineFormatter().format(record)
    assert line.isascii()
    assert "\n" not in line
    assert json.loads(line)["message"] == HOSTILE
