"""Hand ties from the command line: `solmap ties FILE` takes a file into the store."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from solmap.config.workspace import open_workspace
from solmap.photogrammetry.matching.hand_ties import HandAction
from solmap.products.catalogue.catalogue import Outcome
from solmap.tasks.downlink_files import file_bytes
from solmap.tasks.hand_ties import names_in, take_hand_ties, wishes_in


@dataclass(frozen=True, slots=True)
class TakenTies:
    """What a file of hand ties holds."""

    name: str
    counts: dict[HandAction, int]
    strangers: tuple[str, ...]
    """Images and stops that it names and the store does not have yet."""

    def __str__(self) -> str:
        said = ", ".join(f"{count} to {action}" for action, count in self.counts.items())
        return f"{self.name}: {said}; the next run carries them out"


def take_ties_file(file: Path, root: Path) -> TakenTies:
    """Take a file of hand ties into the store at `root`; an earlier one of its name is replaced.

    Raises:
        PhotogrammetryError: the file cannot be read; one line says where and why.
        OSError: there is no such file.
    """
    data = file_bytes(file)
    wishes = wishes_in(data, file.name)
    workspace = open_workspace(root)
    ref = take_hand_ties(file.name, data, workspace.store)
    entries = workspace.catalogue.images()
    known = {entry.id for entry in entries} | {entry.stop for entry in entries}
    counts = {action: sum(wish.action is action for wish in wishes) for action in HandAction}
    taken = TakenTies(file.name, counts, tuple(sorted(names_in(wishes) - known)))
    workspace.catalogue.publish(
        pointers=[ref],
        outcomes=[Outcome.now(file.name, (str(taken),))],
    )
    return taken
