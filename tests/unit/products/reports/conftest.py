"""Textured planes, and two stops on rolling ground."""

from tests.support.rolling_stops import (
    first_stand,
    first_stop,
    foreign_stop,
    second_stand,
    second_stop,
)
from tests.support.textured_planes import ground, rock, scene, sky

__all__ = [
    "first_stand",
    "first_stop",
    "foreign_stop",
    "ground",
    "rock",
    "scene",
    "second_stand",
    "second_stop",
    "sky",
]
