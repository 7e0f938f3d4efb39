"""The checks of arrays, under which unit tests run, refuse what the annotations do not allow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from beartype.roar import BeartypeCallHintViolation, BeartypeDoorHintViolation

from solmap.photogrammetry.arrays import ObjectPoints, PerPoint, Vector3
from tests.support.array_checks import checked


@checked
def weighted(points: ObjectPoints, weights: PerPoint) -> ObjectPoints:
    return points[: round(weights.max())]


@checked
def rows(points: ObjectPoints) -> Iterator[Vector3]:
    yield from points


@checked
@dataclass(frozen=True, slots=True)
class Cloud:
    points: ObjectPoints
    sigma_m: PerPoint


@checked
class Named(Cloud):
    def name(self, number: int) -> str:
        return str(number)


def test_arguments_of_different_lengths_are_refused():
    assert len(weighted(np.ones((4, 3)), np.full(4, 4.0))) == 4
    with pytest.raises(BeartypeCallHintViolation, match="weights"):
        weighted(np.ones((4, 3)), np.ones(5))


def test_an_answer_of_another_length_is_refused():
    with pytest.raises(BeartypeCallHintViolation, match="return"):
        weighted(np.ones((4, 3)), np.full(4, 2.0))


def test_fields_of_a_record_are_checked_together():
    Cloud(np.ones((4, 3)), np.ones(4))
    for record in (Cloud, Named):
        with pytest.raises(BeartypeCallHintViolation, match="sigma_m"):
            record(np.ones((4, 3)), np.ones(5))


@checked
def walked(points: ObjectPoints) -> int:
    return sum(1 for _ in rows(points[1:]))


def test_a_generator_has_axes_of_its_own():
    assert walked(np.ones((4, 3))) == 3
    with pytest.raises(BeartypeDoorHintViolation, match="dimension size 2"):
        rows(np.ones((3, 2)))
