"""A bounded pool of open rasters.

Opening a raster costs more than reading a tile of it, and its decoded blocks are forgotten when it
is closed. Datasets are not safe to share between threads, so a thread borrows one for itself.
Products never change, so an open one never goes stale.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

import rasterio
from rasterio.errors import RasterioError

from solmap.products.formats.raster.raster import open_raster, unreadable

# Of a machine's memory GDAL would take a twentieth for blocks. The variable counts megabytes and is
# read once; set as an option from Python the same number would count bytes.
os.environ.setdefault("GDAL_CACHEMAX", "256")


class RasterPool:
    """Idle datasets, the least recently used closed first."""

    def __init__(self, idle: int = 16) -> None:
        """Keep at most `idle` datasets open while nobody reads them."""
        self._limit = idle
        self._idle: OrderedDict[int, tuple[Path | str, rasterio.DatasetReader]] = OrderedDict()
        self._lock = threading.Lock()
        self._found = [0, 0]

    @property
    def waiting(self) -> int:
        """How many are open and idle."""
        return len(self._idle)

    @property
    def lookups(self) -> tuple[int, int]:
        """How often a dataset was open already, and how often not."""
        return self._found[0], self._found[1]

    @contextlib.contextmanager
    def reading(self, address: Path | str) -> Iterator[rasterio.DatasetReader]:
        """Borrow an open dataset of a file or object.

        Raises:
            ProductNotFoundError: the file is not there.
            StoreAwayError: the object store does not answer.
            ProductError: it cannot be read.
        """
        dataset = self._take(address) or open_raster(address)
        try:
            yield dataset
        except RasterioError as error:
            dataset.close()
            raise unreadable(address, error) from error
        except BaseException:
            dataset.close()
            raise
        self._give(address, dataset)

    def close(self) -> None:
        """Close what is idle."""
        with self._lock:
            for _, dataset in self._idle.values():
                dataset.close()
            self._idle.clear()

    def _take(self, address: Path | str) -> rasterio.DatasetReader | None:
        with self._lock:
            for key in reversed(self._idle):
                if self._idle[key][0] == address:
                    self._found[0] += 1
                    return self._idle.pop(key)[1]
            self._found[1] += 1
        return None

    def _give(self, address: Path | str, dataset: rasterio.DatasetReader) -> None:
        with self._lock:
            self._idle[id(dataset)] = (address, dataset)
            surplus = len(self._idle) - self._limit
            evicted = [self._idle.popitem(last=False)[1][1] for _ in range(surplus)]
        for old in evicted:
            old.close()
