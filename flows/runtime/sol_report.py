"""Reports of sols and downlinks: what was made, and one line per failure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from solmap.photogrammetry.imagery import StopId
from solmap.products.model import ProductRef
from solmap.tasks.network.orientations import Standing


@dataclass(slots=True)
class SolReport:
    """Report of a sol: what was made, and one line per failure."""

    mission: str
    sol: int
    standing: Standing | None = None
    layers: int = 0
    notes: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    published: tuple[ProductRef, ...] = ()
    """The layers."""
    pointed: tuple[ProductRef, ...] = ()
    """Other published products: networks, reports, results of matching."""
    postponed: frozenset[StopId] = frozenset()
    """Stops whose layers the next sol of the run makes, because it may move them."""

    def add_failures(self, what: str, failed: Mapping[Any, str]) -> None:
        """Add the failures that have a cause of their own."""
        self.failures += [f"{what} {key}: {cause}" for key, cause in failed.items() if cause]

    def add_findings(
        self, what: str, failed: Mapping[str, str], lacking: str, *findings: type[Exception]
    ) -> None:
        """Add errors caused by the images as notes, all others as failures.

        Args:
            what: The stage, for failures.
            failed: Causes, as `settled` returns them.
            lacking: Beginning of a note.
            findings: Errors caused by the images and not by a fault: different light, ground too
                far.
        """
        named = tuple(f"{error.__name__}: " for error in findings)
        found = {key: cause for key, cause in failed.items() if cause.startswith(named)}
        self.notes += [
            f"{lacking} {key}: {cause.partition(': ')[2]}" for key, cause in found.items()
        ]
        self.add_failures(what, {key: cause for key, cause in failed.items() if key not in found})


@dataclass(slots=True)
class DownlinkReport:
    """Report of a downlink."""

    images: int = 0
    sols: list[SolReport] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    seams: list[str] = field(default_factory=list)
    """Lines on differences between the stops of a region."""
    poses: list[str] = field(default_factory=list)
    """Lines on the poses used from other sources."""

    @property
    def succeeded(self) -> bool:
        """Whether every sol that could be processed was."""
        return not self.failures

    @property
    def lines(self) -> list[str]:
        """Outcome of every sol."""
        layers = sum(sol.layers for sol in self.sols)
        lines = [f"{self.images} images, {len(self.sols)} sols, {layers} layers of stops published"]
        for sol in self.sols:
            lines += [f"{sol.mission} sol {sol.sol}", *(f"  {note}" for note in sol.notes)]
        return self.poses + lines + self.seams
