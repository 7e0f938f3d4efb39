"""Features of a layer as GeoJSON text in local metres, each encoded once.

A moving map requests the same features repeatedly, from layers with ten thousand footprints or a
hundred thousand tie points. Their file is read once, its coordinates are transformed to the local
map together, and for each feature only the box is stored besides the file's own values; a feature
is encoded when first requested.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from cachetools import LRUCache, cached

from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.products.crs import crs_text
from solmap.products.formats.vector.geojson import PlacedFeatures, read_placed

_KEPT, _LEAST = 150_000_000, 1_000_000
"""Bytes of files whose features are kept in memory, which take three times that; smaller files
count with a least size."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureTexts:
    """The features of a product, in the order of its file."""

    placed: PlacedFeatures
    boxes: np.ndarray
    """(n, 4): west, south, east, north of each, metres."""
    numbers: Mapping[str, int]
    """Index of a feature by its identifier."""
    texts: list[bytes | None] = field(repr=False)

    def within(self, bounds: Bounds) -> Sequence[int]:
        """The features whose box intersects a box."""
        west, south, east, north = bounds
        w, s, e, n = self.boxes.T
        meets = (w <= east) & (e >= west) & (s <= north) & (n >= south)
        numbers: list[int] = np.flatnonzero(meets).tolist()
        return numbers

    def find(self, names: Iterable[str]) -> Sequence[int]:
        """The features of some identifiers; unknown ones are skipped."""
        return [self.numbers[name] for name in names if name in self.numbers]

    def collection(self, numbers: Iterable[int] | None = None) -> bytes:
        """GeoJSON in local metres of some features, or of all."""
        if numbers is None:
            numbers = range(len(self.texts))
        crs = json.dumps(crs_text(self.placed.landing))
        head = f'{{"type":"FeatureCollection","solmap:crs":{crs},"features":['
        return head.encode() + b",".join(self._text(number) for number in numbers) + b"]}"

    def _text(self, number: int) -> bytes:
        text = self.texts[number]
        if text is None:
            item = _in_metres(self.placed.items[number], self.placed.rings_of(number))
            text = json.dumps(item, separators=(",", ":"), ensure_ascii=False).encode()
            self.texts[number] = text
        return text


def _in_metres(item: Mapping[str, Any], rings: Sequence[np.ndarray]) -> dict[str, Any]:
    form = item["geometry"]["type"]
    nested: list[Any] = [ring.tolist() for ring in rings]
    if form != "Polygon":
        nested = nested[0][0] if form == "Point" else nested[0]
    return {**item, "geometry": {"type": form, "coordinates": nested}}


def feature_texts(path: Path) -> FeatureTexts:
    """The features of a file. Products never change, so they are read once.

    Concurrent requests wait: a map requests a dozen boxes at a time, and each would read the file.
    """
    return _reading(path).texts()


@dataclass(slots=True, eq=False)
class _Reading:
    path: Path
    size: int
    lock: threading.Lock = field(default_factory=threading.Lock)
    found: FeatureTexts | None = None

    def texts(self) -> FeatureTexts:
        with self.lock:
            if self.found is None:
                self.found = _read(self.path)
            return self.found


@cached(LRUCache(_KEPT, getsizeof=lambda reading: reading.size), lock=threading.Lock())
def _reading(path: Path) -> _Reading:
    size = path.stat().st_size if path.is_file() else 0
    return _Reading(path, max(size, _LEAST))


def _read(path: Path) -> FeatureTexts:
    placed = read_placed(path)
    numbers = {str(item["id"]): number for number, item in enumerate(placed.items) if "id" in item}
    return FeatureTexts(placed, placed.boxes(), numbers, [None] * len(placed.items))
