"""Cloud Optimised GeoTIFFs: all properties of the format are defined here.

- Blocks of 256 x 256 cells, which are the tiles of the site's tile matrix set, and overviews that
  halve down to one block, which are its lower zooms. Blocks with nothing measured are left out.
- Measured values are 32-bit floats, NaN where nothing was measured. Images and classes have 8 bits,
  0 where there is no data.
- Deflate with the horizontal predictor: lossless, readable by every GDAL since 1.8. The one for
  floats takes twice as long to read, and saves a twentieth of the size or costs a tenth. JPEG and
  WebP would smear the edge of what was seen, and JPEG cannot keep 0 as 0; grey is half as much to
  read as grey with alpha, and a tile is the block with a palette.
- Overviews average what was measured and ignore the rest; directions (aspect) and classes cannot be
  averaged and take the nearest cell.
- Names, units, scales, colours and tags travel inside. No dates do: equal input gives equal bytes.
  GeoTIFF has no place for the names of classes, so they are in the tag `CLASSES`.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
from pyproj import CRS
from rasterio.enums import ColorInterp
from rasterio.errors import RasterBlockError, RasterioError
from rasterio.shutil import copy as copy_raster
from rasterio.transform import Affine
from rasterio.windows import Window

from solmap.photogrammetry.kernels import halve
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.products.crs import untied_origin
from solmap.products.store.faults import is_disk_full

Kind = Literal["float32", "uint8"]
OverviewResampling = Literal["AVERAGE", "NEAREST"]
_LOSSLESS = {
    "BLOCKSIZE": BLOCK,
    "COMPRESS": "DEFLATE",
    "PREDICTOR": "STANDARD",
    "LEVEL": 1,  # 6 takes a third longer for two percent of the size
    "SPARSE_OK": "TRUE",
    "BIGTIFF": "IF_SAFER",
    "NUM_THREADS": "ALL_CPUS",  # the bytes are the same
}
_NODATA = {"float32": math.nan, "uint8": 0}


@dataclass(frozen=True, slots=True)
class Band:
    """Name, unit, scale and colour of a band."""

    name: str
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    """True values are scale x stored + offset."""
    colour: ColorInterp = ColorInterp.gray


@dataclass(frozen=True, slots=True)
class RasterClass:
    """A value of a class layer: its meaning, and its colour."""

    value: int
    """1 to 255; 0 is unknown."""
    name: str
    colour: str
    """`#rrggbb`."""

    @property
    def rgb(self) -> tuple[int, int, int]:
        """Red, green and blue, 0 to 255."""
        red, green, blue = (int(self.colour[i : i + 2], 16) for i in (1, 3, 5))
        return red, green, blue


@dataclass(frozen=True, slots=True)
class RasterDescription:
    """The properties of a file besides the values and positions of its cells."""

    kind: Kind
    bands: tuple[Band, ...]
    overview_resampling: OverviewResampling = "AVERAGE"
    """Method of the overviews."""
    tags: Mapping[str, str] | None = None
    classes: tuple[RasterClass, ...] = ()
    """Classes of the only band of a class layer."""


@contextlib.contextmanager
def create_cog(
    path: Path, grid: MapGrid, crs: CRS, description: RasterDescription
) -> Iterator[rasterio.io.DatasetWriter]:
    """A dataset to write bands or windows to; it becomes a COG at `path` when complete.

    Windows that are never written take no space.
    """
    draft = path.with_name(f"{path.name}.draft")
    profile = _profile(grid, crs, description)
    try:
        with rasterio.open(draft, "w", **profile) as dataset:
            yield dataset
            _describe(dataset, description, untied_origin(crs))
        _write_overviews(draft, profile, description.overview_resampling)
        copy_raster(draft, path, driver="COG", **_LOSSLESS)
    except RasterioError as error:  # GDAL only reports that writing failed
        if is_disk_full(path.parent, error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        raise
    finally:
        for made in path.parent.glob(f"{draft.name}*"):
            made.unlink()


def _write_overviews(path: Path, profile: Mapping[str, Any], how: OverviewResampling) -> None:
    """Write overviews down to one block, each beside that of twice its size, as GDAL finds them.

    They are made of blocks that are held: GDAL would average empty ones as well.
    """
    while max(profile["height"], profile["width"]) > BLOCK:
        profile = {**profile, **{side: -(-profile[side] // 2) for side in ("height", "width")}}
        half = path.with_name(f"{path.name}.half")
        with rasterio.open(path) as full, rasterio.open(half, "w", **profile) as overview:
            whole = Window(0, 0, full.width, full.height)
            for (row, col), window in overview.block_windows(1):
                places = ((2 * row + down, 2 * col + right) for down in (0, 1) for right in (0, 1))
                if any(is_held(full, *place) for place in places):
                    wide = Window(*(2 * side for side in window.flatten()))
                    cells = full.read(window=wide.intersection(whole))
                    overview.write(_halved(cells, how), window=window)
        path = half.rename(f"{path}.ovr")


def _halved(cells: np.ndarray, how: OverviewResampling) -> np.ndarray:
    """Bands at half their size; a last row or column without a neighbour is used twice."""
    odd = [(0, side % 2) for side in cells.shape[1:]]
    cells = np.pad(cells, [(0, 0), *odd], mode="edge") if any(map(any, odd)) else cells
    if how == "NEAREST":
        return cells[:, 1::2, 1::2]
    if cells.dtype == np.float32:
        return halve(cells)
    means = halve(np.where(cells, cells, np.float32(np.nan)))
    return np.floor(np.nan_to_num(means) + np.float32(0.5)).astype(cells.dtype)


def is_held(dataset: rasterio.io.DatasetReader, row: int, col: int) -> bool:
    """Whether a file holds a block of some band: it does not where nothing is known."""
    for band in dataset.indexes:
        with contextlib.suppress(RasterBlockError):
            if dataset.block_size(band, row, col):
                return True
    return False


def _profile(grid: MapGrid, crs: CRS, description: RasterDescription) -> dict[str, Any]:
    return {
        "driver": "GTiff",
        "width": grid.cols,
        "height": grid.rows,
        "count": len(description.bands),
        "dtype": description.kind,
        "nodata": _NODATA[description.kind],
        "crs": rasterio.CRS.from_wkt(crs.to_wkt()),
        "transform": Affine(grid.cell_m, 0.0, grid.west, 0.0, -grid.cell_m, grid.north),
        "interleave": "band",
        "tiled": True,
        "blockxsize": BLOCK,
        "blockysize": BLOCK,
        "sparse_ok": True,
        "bigtiff": "IF_SAFER",
    }


def _describe(
    dataset: rasterio.io.DatasetWriter, description: RasterDescription, origin: str | None
) -> None:
    bands: Sequence[Band] = description.bands
    dataset.descriptions = tuple(band.name for band in bands)
    dataset.units = tuple(band.unit for band in bands)
    dataset.scales = tuple(band.scale for band in bands)
    dataset.offsets = tuple(band.offset for band in bands)
    named = {"ORIGIN": origin} if origin else {}
    if description.classes:
        dataset.write_colormap(1, {one.value: (*one.rgb, 255) for one in description.classes})
        named["CLASSES"] = json.dumps({one.value: one.name for one in description.classes})
    else:
        dataset.colorinterp = tuple(band.colour for band in bands)
    dataset.update_tags(AREA_OR_POINT="Area", **named, **(description.tags or {}))
