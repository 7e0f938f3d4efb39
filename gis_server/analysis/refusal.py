"""What is asked for and cannot be computed, said in one sentence."""

from __future__ import annotations


class RefusedError(Exception):
    """The question has no answer as it stands; says what was expected and what to try."""
