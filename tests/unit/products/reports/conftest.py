"""What figures are drawn from: a textured plane, and two stops on rolling ground."""

from tests.support.rolling_stops import first_stand, first_stop, second_stand, second_stop
from tests.support.textured_planes import ground, scene

__all__ = ["first_stand", "first_stop", "ground", "scene", "second_stand", "second_stop"]
