"""What goes wrong while fetching, and what helps against it."""

from __future__ import annotations


class FetchError(Exception):
    """Something could not be fetched; names the file and what every mirror answered."""


class WrongContentError(FetchError):
    """A file came whole, but is not what it should be."""


class DiskError(FetchError):
    """The disk is full or the folder cannot be written: nothing further can be fetched."""


class TryAgainError(Exception):
    """A fault that may pass; `reached` says whether the host was there at all."""

    def __init__(self, reason: str, wait_s: float = 0.0, *, reached: bool = True) -> None:
        super().__init__(reason)
        self.wait_s = wait_s
        self.reached = reached


class NextMirrorError(Exception):
    """A fault that asking the same server again does not mend."""
