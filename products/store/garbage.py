"""How often a process collects garbage.

Imports nothing of solmap, so that a command may call it before its other imports.
"""

import gc

_OBJECTS = 50_000
"""New objects before a collection; Python's default is 700. Documents of a long mission are a
million lists without a cycle, and collecting would take twice as long as reading them."""


def collect_garbage_rarely() -> None:
    """Let this process collect garbage less often than by default."""
    gc.set_threshold(_OBJECTS)


def exempt_objects_from_collection() -> None:
    """Exempt the existing objects from garbage collection: modules and routes of a server.

    Scanning the 180,000 of them stops all threads for 0.15 s of processor time.
    """
    gc.collect()
    gc.freeze()
