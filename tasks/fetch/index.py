"""The index of a volume: brought here, asked for again only if it has changed, and searched."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from solmap.photogrammetry.archive.labels.label import MAX_LABEL_BYTES
from solmap.photogrammetry.archive.tables.volume_index import (
    IndexFindings,
    IndexLayout,
    IndexRow,
    IndexSelection,
    find_in_index,
    parse_index_label,
    read_index_rows,
)
from solmap.photogrammetry.errors import LabelError
from solmap.tasks.fetch.errors import DiskError, FetchError, WrongContentError
from solmap.tasks.fetch.transfer import Transfer
from solmap.tasks.fetch.volume import Volume
from solmap.tasks.stage import stage

INDEX = "edrindex"
CHUNK_BYTES = 1 << 16
MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Index:
    """An index that is here."""

    volume: Volume
    """Its mirrors, the one that gave the index in front."""
    layout: IndexLayout
    table: Path
    warning: str = ""

    def rows(self) -> Iterator[IndexRow]:
        """The rows, one at a time."""
        return read_index_rows(self.layout, _chunks(self.table))

    def find(self, selection: IndexSelection) -> IndexFindings:
        """The stereo pairs of a selection."""
        return find_in_index(self.rows(), selection)


@stage(task_run_name="index-{folder}")
def fetch_index(
    volume: Volume,
    folder: Path,
    transfer: Transfer,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Index:
    """Bring label and table of a volume's index here; progress counts mebibytes.

    Raises:
        FetchError: no mirror gives them, and they are not here from an earlier time.
    """
    label, table = folder / f"{INDEX}.lbl", folder / f"{INDEX}.tab"
    warning = ""
    try:
        url = transfer.fetch(volume.index_urls(label.name), label, _check_label).url
        volume = volume.answering_first(url)
        layout = _layout(label)
        transfer.fetch(
            volume.index_urls(table.name),
            table,
            lambda path: _check_table(path, layout),
            _in_mebibytes(progress),
        )
    except DiskError:
        raise
    except FetchError as error:
        if not (label.is_file() and table.is_file()):
            raise
        warning = f"the index from an earlier time is used: {error}"
        layout = _layout(label)
    return Index(volume, layout, table, warning)


def _check_label(path: Path) -> None:
    try:
        _layout(path)
    except LabelError as error:
        raise WrongContentError(str(error)) from error


def _layout(path: Path) -> IndexLayout:
    with path.open("rb") as file:
        return parse_index_label(file.read(MAX_LABEL_BYTES).decode("latin-1"), f"{INDEX}.lbl")


def _check_table(path: Path, layout: IndexLayout) -> None:
    """Refuse what is no table: a page that says sorry, or one that another label describes."""
    try:
        first = next(read_index_rows(layout, _chunks(path)), None)
        if first is None:
            raise WrongContentError(f"{INDEX}.tab is empty")
        first.integer("PLANET_DAY_NUMBER")
    except LabelError as error:
        raise WrongContentError(str(error)) from error


def _chunks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            yield chunk


def _in_mebibytes(progress: Callable[[int, int], None]) -> Callable[[int, int | None], None]:
    last = -1

    def tell(here: int, length: int | None) -> None:
        nonlocal last
        done = math.ceil(here / MIB)
        if length is not None and done != last:
            progress(done, math.ceil(length / MIB))
            last = done

    return tell
