"""An archive volume on its mirrors: which addresses a file may have.

    {base}/{volume}/index/edrindex.lbl, .tab
    {base}/{volume}/data/sol####/edr/{name}.img        #### = sol, four digits; names in lower case

The index names folder and file; what it says is tried first, the layout above after it. Both come
over the network and end up in addresses and file names, so nothing but plain path parts is taken.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import quote

from solmap.photogrammetry.archive.tables.volume_index import IndexEntry
from solmap.tasks.fetch.errors import FetchError

_PLAIN = re.compile(r"[A-Za-z0-9_#-][A-Za-z0-9_.#-]*\Z")


@dataclass(frozen=True, slots=True)
class Volume:
    """A volume and where it can be had."""

    name: str
    base_urls: tuple[str, ...]

    def index_urls(self, file_name: str) -> list[str]:
        """Addresses of a file of the index."""
        return [f"{self._at(base)}/index/{file_name}" for base in self.base_urls]

    def image_urls(self, entry: IndexEntry) -> list[str]:
        """Addresses of an image, mirror by mirror.

        Raises:
            FetchError: the index gives a name or folder that is none.
        """
        paths = [f"data/sol{entry.sol:04d}/edr/{local_name(entry)}"]
        if entry.path_name:
            paths.insert(0, f"{self._folder(entry)}/{_part(entry.file_name, entry)}")
        return [
            f"{self._at(base)}/{quote(path)}"
            for base in self.base_urls
            for path in dict.fromkeys(paths)
        ]

    def answering_first(self, url: str) -> Volume:
        """The same volume, the mirror that an address belongs to in front."""
        order = sorted(self.base_urls, key=lambda base: not url.startswith(self._at(base) + "/"))
        return Volume(self.name, tuple(order))

    def _at(self, base: str) -> str:
        return f"{base.rstrip('/')}/{self.name}"

    def _folder(self, entry: IndexEntry) -> str:
        """The folder that the index gives, below the volume."""
        parts = [_part(part, entry) for part in re.split(r"[/\\]", entry.path_name) if part]
        if parts and parts[0].lower() == self.name.lower():
            parts = parts[1:]
        return "/".join(parts)


def local_name(entry: IndexEntry) -> str:
    """How a file is called here: as in the archive, in lower case."""
    return f"{entry.name.product_id.lower().replace('#', '_')}.img"


def _part(text: str, entry: IndexEntry) -> str:
    if not _PLAIN.match(text):
        raise FetchError(
            f"{local_name(entry)}: the index should give a plain folder and file name, but gives "
            f"{entry.path_name[:60]!a} and {entry.file_name[:60]!a}"
        )
    return text
