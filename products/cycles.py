"""How often Python looks for cycles among the objects that it holds."""

from __future__ import annotations

import gc

_OBJECTS = 50_000
"""So many new ones before it looks; by itself it looks after 700. What is read of a long mission is
a million lists and no cycle: looking takes twice as long as reading."""


def look_seldom() -> None:
    """Have this process look seldom; to say it again changes nothing."""
    gc.set_threshold(_OBJECTS)
