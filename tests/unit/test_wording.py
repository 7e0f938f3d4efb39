"""The prose of finished packages has no word of the list; the list catches what it is for."""

from pathlib import Path

import pytest

from tests.support.wording import FOLDERS, ROOT, Text, faults, texts


@pytest.mark.parametrize("folder", FOLDERS)
def test_prose_has_no_word_of_the_list(folder):
    found = [str(fault) for text in texts(ROOT, folder) for fault in faults(text)]
    assert found == [], f"`python -m tests.support.wording --list {folder}` prints them"


@pytest.mark.parametrize(
    "sentence",
    [
        "Say what nothing refers to any more.",
        "Addresses, mirrors and patience stand in the archive's file.",
        "What images do not tell of a stop.",
        "Ties by the shape of the ground, where its looks say little of bearing.",
        "A stop that has left the window is spoken of no more.",
        "The weighted mean, made anew, one row a pair.",
        "`folder` is no folder of a store.",
    ],
)
def test_a_sentence_that_must_be_read_twice_is_caught(sentence):
    assert list(faults(Text(Path("x.py"), 1, "docstring", sentence)))


@pytest.mark.parametrize(
    "sentence",
    [
        "There is no unit: the two largest eigenvalues are no longer equal, at any size.",
        "The rover stands on a slope of 5 degrees; the position is known to 2 cm.",
        "Code such as `told` or `judge(what_is_left)` is not prose.",
        "One row per pair, with the standard deviation that matching states.",
    ],
)
def test_a_plain_sentence_is_not_caught(sentence):
    assert not [str(one) for one in faults(Text(Path("x.py"), 1, "docstring", sentence))]
