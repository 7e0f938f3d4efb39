"""What files, labels and messages hold reaches a terminal as text, whatever it is."""

import json
import logging

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

from solmap.flows.cli import console
from solmap.flows.runtime.progress import Step
from solmap.products.store.process import JsonLineFormatter

HOSTILE = "[/red][bold]:smile: \x1b[31m\x9b2J\r\n\u202etxt\u2028\x00 \udcff {0} %s"


def shown(capsys):
    captured = capsys.readouterr()
    (captured.out + captured.err).encode()  # no lone surrogate is left
    return captured.out + captured.err


def assert_harmless(text, lines=1):
    assert text.count("\n") == lines
    assert text.replace("\n", "").isprintable()


def test_what_steers_a_terminal_is_shown_as_an_escape():
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
        console.say,
        lambda text: console.note("failed", text),
        fail,
        lambda text: console._print_finished(Step(text, 2, 2)),
    ],
)
def test_a_line_is_printed_as_it_is(put, capsys):
    put(HOSTILE)
    text = shown(capsys)
    assert console.printable(HOSTILE) in text
    assert_harmless(text)


def test_cells_of_a_table_are_printed_as_they_are(capsys):
    console.show_rows(
        [{"subject": HOSTILE, "notes": [HOSTILE]}], ["subject", "notes"], as_json=False
    )
    text = shown(capsys)
    assert text.count(r"[/red][bold]:smile: \x1b[31m") == 2
    assert_harmless(text, text.count("\n"))


def test_rows_as_json_are_ascii(capsys):
    console.show_rows([{"subject": HOSTILE}], ["subject"], as_json=True)
    text = shown(capsys)
    assert text.isascii()
    assert json.loads(text) == [{"subject": HOSTILE}]


def test_a_bar_is_labelled_with_the_stage_as_it_is():
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
