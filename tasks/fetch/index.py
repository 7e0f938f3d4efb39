"""A volume of the archive on its mirrors, and its index: fetched, cached, and searched.

    MER         {base}/{volume}/index/edrindex.lbl, .tab
                {base}/{volume}/data/sol####/edr/{name}.img      sol of four digits, lower case
    MSL         {base}/{volume}/INDEX/INDEX.LBL, .TAB
                {base}/{volume}/DATA/SOL#####/{name}.IMG
    Mars 2020   {base}/{bundle}/data/collection_data_inventory.csv
                {base}/{bundle}/data/sol/#####/ids/edr/ncam/{name}.IMG

An index is downloaded again only if it has changed. It names folder and file; these are tried
first, the layout above after them. Both come over the network and become part of addresses and file
names, so only plain path parts are accepted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from solmap.photogrammetry.archive.labels.label import MAX_LABEL_BYTES
from solmap.photogrammetry.archive.tables.volume_index import (
    IndexEntry,
    IndexFindings,
    IndexLayout,
    IndexSelection,
    find_in_index,
    parse_index_label,
    read_index_rows,
    read_lines,
)
from solmap.photogrammetry.errors import LabelError
from solmap.tasks.fetch.answers import DiskError, FetchError, WrongContentError
from solmap.tasks.fetch.transfer import Transfer
from solmap.tasks.stage import stage

_PLAIN = re.compile(r"[A-Za-z0-9_#-][A-Za-z0-9_.#-]*\Z")
EDR_INDEX = "index/edrindex.lbl"
CHUNK_BYTES = 1 << 16
MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Volume:
    """A volume and its mirrors."""

    name: str
    base_urls: tuple[str, ...]
    index: str = EDR_INDEX
    """Its index below the volume: the label of a table (.lbl), or an inventory (.csv)."""

    def index_urls(self, file_name: str) -> list[str]:
        """Addresses of a file of the index."""
        folder = self.index.rpartition("/")[0]
        return [f"{self._at(base)}/{folder}/{file_name}" for base in self.base_urls]

    def image_urls(self, entry: IndexEntry) -> list[str]:
        """Addresses of an image, one per mirror.

        Raises:
            FetchError: the index gives an invalid name or folder.
        """
        is_mer = entry.name.mission.startswith("MER")
        paths = [f"data/sol{entry.sol:04d}/edr/{local_name(entry)}"] if is_mer else []
        if entry.path_name:
            paths.insert(0, f"{self._folder(entry)}/{_part(entry.file_name, entry)}")
        return [
            f"{self._at(base)}/{quote(path)}"
            for base in self.base_urls
            for path in dict.fromkeys(paths)
        ]

    def answering_first(self, url: str) -> Volume:
        """The same volume with the mirror of an address first."""
        order = sorted(self.base_urls, key=lambda base: not url.startswith(self._at(base) + "/"))
        return replace(self, base_urls=tuple(order))

    def _at(self, base: str) -> str:
        return f"{base.rstrip('/')}/{self.name}"

    def _folder(self, entry: IndexEntry) -> str:
        """The folder given by the index, below the volume."""
        parts = [_part(part, entry) for part in re.split(r"[/\\]", entry.path_name) if part]
        if parts and parts[0].lower() == self.name.lower():
            parts = parts[1:]
        return "/".join(parts)


def local_name(entry: IndexEntry) -> str:
    """Local name of a file: as in the archive, which has lower case for MER only."""
    if not entry.name.mission.startswith("MER"):
        return _part(entry.file_name, entry)
    return f"{entry.name.product_id.lower().replace('#', '_')}.img"


def _part(text: str, entry: IndexEntry) -> str:
    if not _PLAIN.match(text):
        raise FetchError(
            f"{entry.name.product_id}: the index should give a plain folder and file name, but "
            f"gives {entry.path_name[:60]!a} and {entry.file_name[:60]!a}"
        )
    return text


@dataclass(frozen=True, slots=True)
class Index:
    """A downloaded index."""

    volume: Volume
    """Its mirrors, the source of the index first."""
    layout: IndexLayout | None
    """Its columns; None for an inventory."""
    table: Path
    warning: str = ""

    def find(self, selection: IndexSelection) -> IndexFindings:
        """The stereo pairs of a selection."""
        if self.layout is None:
            lines = filter(None, read_lines(_chunks(self.table), self.table.name))
            return find_in_index(lines, selection)
        return find_in_index(read_index_rows(self.layout, _chunks(self.table)), selection)


@stage(task_run_name="index-{folder}", makes_products=False)
def fetch_index(
    volume: Volume,
    folder: Path,
    transfer: Transfer,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Index:
    """Fetch label and table of a volume's index; progress counts mebibytes.

    Raises:
        FetchError: no mirror provides them, and there is no earlier copy.
    """
    label = folder / volume.index.rpartition("/")[2]
    is_table = label.suffix.lower() == ".lbl"
    table = label.with_suffix(".TAB" if label.suffix.isupper() else ".tab") if is_table else label
    warning, layout = "", None
    try:
        if is_table:
            url = transfer.fetch(volume.index_urls(label.name), label, _check_label).url
            volume = volume.answering_first(url)
            layout = _layout(label)
        fetched = transfer.fetch(
            volume.index_urls(table.name),
            table,
            lambda path: _check_table(path, layout),
            _in_mebibytes(progress),
        )
        volume = volume.answering_first(fetched.url)
    except DiskError:
        raise
    except FetchError as error:
        if not (label.is_file() and table.is_file()):
            raise
        warning = f"an earlier copy of the index is used: {error}"
        layout = _layout(label) if is_table else None
    return Index(volume, layout, table, warning)


def _check_label(path: Path) -> None:
    try:
        _layout(path)
    except LabelError as error:
        raise WrongContentError(str(error)) from error


def _layout(path: Path) -> IndexLayout:
    with path.open("rb") as file:
        text = file.read(MAX_LABEL_BYTES).decode("latin-1")
    return parse_index_label(text, path.name.removesuffix(".part"))


def _check_table(path: Path, layout: IndexLayout | None) -> None:
    """Reject what is not a table: an error page, or one with another label."""
    name = path.name.removesuffix(".part")
    try:
        if layout is None:
            line = next(read_lines(_chunks(path), name), b"")
            if not line.startswith((b"P,", b"S,")):
                raise WrongContentError(f"{name} is not an inventory of a collection")
            return
        first = next(read_index_rows(layout, _chunks(path)), None)
        if first is None:
            raise WrongContentError(f"{name} is empty")
        first.integer("PLANET_DAY_NUMBER")
    except LabelError as error:
        raise WrongContentError(str(error)) from error


def _chunks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            yield chunk


def _in_mebibytes(progress: Callable[[int, int], None]) -> Callable[[int, int | None], None]:
    last = -1

    def report(here: int, length: int | None) -> None:
        nonlocal last
        done = math.ceil(here / MIB)
        if length is not None and done != last:
            progress(done, math.ceil(length / MIB))
            last = done

    return report
