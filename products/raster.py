"""Rasters on disk: Cloud Optimised GeoTIFF in the local CRS of the landing site.

Everything about the format is decided here, once:

- Blocks of 256 x 256 cells, which are the tiles of the site's tile matrix set, and overviews that
  halve down to one block, which are its lower zooms. Blocks with nothing measured are left out.
- Measured values are 32-bit floats, NaN where nothing was measured; deflate with the floating
  point predictor, lossless, readable by every GDAL since 1.8.
- Orthophotos are pictures: one band of 8 bits, 0 where nothing was seen and 1 to 255 otherwise.
  The band's scale and offset lead back to brightness. Deflate with the horizontal predictor:
  lossless (JPEG and WebP would smear the edge of what was seen, and JPEG cannot keep 0 as 0), half
  as much to read as grey with alpha, and a tile is the block with a palette.
- Overviews average what was measured and ignore the rest; directions (aspect) cannot be averaged
  and take the nearest cell. An averaged `class` of a DTM lies between its classes.
- Names, units, scales and tags travel inside. No dates do: equal input gives equal bytes.
"""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
from pyproj import CRS
from rasterio.errors import RasterioError, RasterioIOError
from rasterio.shutil import copy as copy_raster
from rasterio.transform import Affine
from rasterio.windows import Window

from photogrammetry.arrays import Raster
from photogrammetry.terrain.grid import BLOCK, MapGrid
from photogrammetry.terrain.records import Dtm
from products.disk import is_full
from products.errors import ProductError, ProductNotFoundError

_LOSSLESS = {"BLOCKSIZE": BLOCK, "COMPRESS": "DEFLATE", "SPARSE_OK": "TRUE", "BIGTIFF": "IF_SAFER"}
_PREDICTOR = {"float32": "FLOATING_POINT", "uint8": "STANDARD"}
_NODATA = {"float32": math.nan, "uint8": 0}
_DIRECTIONS = {"aspect"}
"""Bands whose values run in a circle."""
_DTM_UNITS = {"elevation": "m", "standard_deviation": "m", "observations": "", "class": ""}
_POSE_DEVIATION = "pose_deviation"
"""Band of a DTM whose poses are not taken for true: the part of the deviation that cells share."""
_STRETCH_PERCENTILES = (0.5, 99.5)
"""Brightness that becomes black and white: what lies beyond is glint, deep shadow or noise."""
_LOOK = 1 << 20
"""Cells that are looked at for a summary: an overview of at most this many."""


@dataclass(frozen=True, slots=True)
class BandSummary:
    """What a catalogue or legend wants to know of a band."""

    name: str
    unit: str
    range: tuple[float, float] | None
    """1st and 99th percentile of the measured values; None where nothing was measured."""


def write_raster(  # noqa: PLR0913 - the properties of one file
    path: Path,
    grid: MapGrid,
    bands: Mapping[str, Raster | np.ndarray],
    crs: CRS,
    *,
    unit: str | Mapping[str, str] = "",
    tags: Mapping[str, str] | None = None,
    overviews: Literal["AVERAGE", "NEAREST"] | None = None,
    scale: tuple[float, float] = (1.0, 0.0),
) -> None:
    """Write the bands of one grid, float32 with NaN or uint8 with 0 where nothing was measured.

    Args:
        path: The file to write.
        grid: Where the cells lie, metres of the local map.
        bands: Cell values by the name of the band.
        crs: The local CRS of the landing site.
        unit: Unit of all bands, or of each by name: `m`, `degree`.
        tags: What else to keep with the file, as text.
        overviews: How four cells become one; by default the mean, but of directions the nearest.
        scale: (scale, offset) from stored to true values.

    Raises:
        ProductError: a band does not fit the grid, or types are mixed or unknown.
    """
    stack = _stacked(path, grid, bands)
    units = {name: unit if isinstance(unit, str) else unit.get(name, "") for name in bands}
    kind = stack[0].dtype.name
    rows = path.with_name(f"{path.name}.rows")
    halving = overviews or ("NEAREST" if _DIRECTIONS & set(bands) else "AVERAGE")
    options = {**_LOSSLESS, "PREDICTOR": _PREDICTOR[kind], "OVERVIEW_RESAMPLING": halving}
    try:
        with rasterio.open(rows, "w", **_profile(grid, stack, crs)) as dataset:
            for index, (name, band) in enumerate(zip(bands, stack, strict=True), start=1):
                dataset.write(band, index)
                dataset.set_band_description(index, name)
            dataset.units = tuple(units.values())
            dataset.scales, dataset.offsets = ((value,) * len(stack) for value in scale)
            dataset.update_tags(AREA_OR_POINT="Area", **(tags or {}))
        copy_raster(rows, path, driver="COG", **options)
    except RasterioError as error:  # GDAL only says that writing failed
        if is_full(path.parent, error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        raise
    finally:
        rows.unlink(missing_ok=True)


def _stacked(
    path: Path, grid: MapGrid, bands: Mapping[str, Raster | np.ndarray]
) -> list[np.ndarray]:
    if not bands:
        raise ProductError(f"{path.name} would have no band")
    stack = [np.asarray(band) for band in bands.values()]
    types = {band.dtype.name for band in stack}
    if len(types) > 1 or not types <= set(_PREDICTOR):
        raise ProductError(f"{path.name}: bands are all float32 or all uint8, not {sorted(types)}")
    for name, band in zip(bands, stack, strict=True):
        if band.shape != grid.shape:
            raise ProductError(
                f"{path.name}: band {name} has {band.shape} cells on a grid of {grid.shape}"
            )
    return stack


def _profile(grid: MapGrid, stack: list[np.ndarray], crs: CRS) -> dict[str, Any]:
    kind = stack[0].dtype.name
    return {
        "driver": "GTiff",
        "width": grid.cols,
        "height": grid.rows,
        "count": len(stack),
        "dtype": kind,
        "nodata": _NODATA[kind],
        "crs": rasterio.CRS.from_wkt(crs.to_wkt()),
        "transform": Affine(grid.cell_m, 0.0, grid.west, 0.0, -grid.cell_m, grid.north),
        "interleave": "band",
        "bigtiff": "IF_SAFER",
    }


def open_raster(path: Path) -> rasterio.DatasetReader:
    """Open a raster for reading.

    Raises:
        ProductNotFoundError: there is no such file.
        ProductError: it cannot be read as a raster.
    """
    try:
        return rasterio.open(path)
    except RasterioIOError as error:
        if not path.is_file():
            raise ProductNotFoundError(f"{path.name} is not there") from error
        raise ProductError(f"{path.name} cannot be read as a raster: {error}") from error


def grid_of(dataset: rasterio.DatasetReader) -> MapGrid:
    """Where the cells of an open raster lie."""
    transform = dataset.transform
    return MapGrid(transform.c, transform.f, transform.a, dataset.height, dataset.width)


def read_raster(path: Path) -> tuple[MapGrid, dict[str, np.ndarray]]:
    """The grid and the stored values of every band, by name: what `write_raster` was given.

    Raises:
        ProductNotFoundError: there is no such file.
        ProductError: the file is broken.
    """
    with open_raster(path) as dataset:
        try:
            stack = dataset.read()
        except RasterioError as error:
            raise ProductError(f"{path.name} is broken: {error}; make it again") from error
        return grid_of(dataset), dict(zip(_names(dataset), stack, strict=True))


def _names(dataset: rasterio.DatasetReader) -> list[str]:
    return [name or f"band {i}" for i, name in enumerate(dataset.descriptions, start=1)]


def crs_of(path: Path) -> CRS:
    """The CRS that a raster carries."""
    with open_raster(path) as dataset:
        return CRS.from_wkt(dataset.crs.to_wkt(version="WKT2_2019"))


def summarise(path: Path) -> tuple[MapGrid, tuple[BandSummary, ...]]:
    """Grid, and name, unit and range of true values of every band, from an overview."""
    with open_raster(path) as dataset:
        shrink = max(1.0, math.sqrt(dataset.width * dataset.height / _LOOK))
        shape = (math.ceil(dataset.height / shrink), math.ceil(dataset.width / shrink))
        looks = dataset.read(out_shape=(dataset.count, *shape), masked=True)
        bands = zip(
            _names(dataset), dataset.units, looks, dataset.scales, dataset.offsets, strict=True
        )
        return grid_of(dataset), tuple(
            BandSummary(name, unit or "", _range_of(look, scale, offset))
            for name, unit, look, scale, offset in bands
        )


def _range_of(
    values: np.ma.MaskedArray[Any, Any], scale: float, offset: float
) -> tuple[float, float] | None:
    measured = values.compressed()
    if not measured.size:
        return None
    low, high = np.percentile(measured.astype(np.float64) * scale + offset, (1.0, 99.0))
    return float(low), float(high)


def write_dtm(path: Path, dtm: Dtm, crs: CRS, *, tags: Mapping[str, str] | None = None) -> None:
    """Write a terrain model: elevation, deviation, observations, class, deviation of the pose."""
    bands = {
        "elevation": dtm.elevation,
        "standard_deviation": dtm.sigma_m,
        "observations": dtm.observations,
        "class": dtm.ground.astype(np.float32),
        **({} if dtm.pose_sigma_m is None else {_POSE_DEVIATION: dtm.pose_sigma_m}),
    }
    units = {**_DTM_UNITS, _POSE_DEVIATION: "m"}
    notes = {"VERTICAL": "metres above the tangent plane at the landing point", **(tags or {})}
    write_raster(path, dtm.grid, bands, crs, unit=units, tags=notes)


def read_dtm(path: Path) -> Dtm:
    """Read what `write_dtm` wrote.

    Raises:
        ProductError: the file is no terrain model.
    """
    grid, bands = read_raster(path)
    missing = [name for name in _DTM_UNITS if name not in bands]
    if missing:
        raise ProductError(f"{path.name} is no terrain model: it has no band {missing[0]}")
    return Dtm(
        grid=grid,
        elevation=bands["elevation"],
        sigma_m=bands["standard_deviation"],
        observations=bands["observations"],
        ground=bands["class"].astype(np.uint8),
        pose_sigma_m=bands.get(_POSE_DEVIATION),
    )


def write_orthophoto(
    path: Path,
    grid: MapGrid,
    brightness: Raster,
    crs: CRS,
    *,
    stretch: tuple[float, float] | None = None,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write brightness (NaN where nothing was seen) as an 8-bit picture.

    Args:
        path: The file to write.
        grid: Where the cells lie.
        brightness: Grey values of any unit.
        crs: The local CRS of the landing site.
        stretch: Brightness shown black and white; by default two percentiles of what was seen.
        tags: What else to keep with the file.
    """
    low, high = stretch or _stretch_of(brightness)
    scale = (high - low) / 254.0  # 1 is black, 255 is white
    seen = np.isfinite(brightness)
    grey = np.zeros(brightness.shape, np.uint8)
    grey[seen] = np.clip(np.rint((brightness[seen] - low) / scale) + 1.0, 1.0, 255.0)
    write_raster(path, grid, {"brightness": grey}, crs, tags=tags, scale=(scale, low - scale))


def _stretch_of(brightness: Raster) -> tuple[float, float]:
    seen = brightness[np.isfinite(brightness)]
    if not seen.size:
        return 0.0, 254.0
    low, high = (float(value) for value in np.percentile(seen, _STRETCH_PERCENTILES))
    return (low, high) if high > low else (low - 1.0, low + 1.0)


def read_orthophoto(path: Path) -> tuple[MapGrid, Raster]:
    """Brightness as `write_orthophoto` was given it, to half a grey step; NaN where unseen."""
    with open_raster(path) as dataset:
        grey = dataset.read(1)
        brightness = grey.astype(np.float32) * dataset.scales[0] + dataset.offsets[0]
        return grid_of(dataset), np.where(grey > 0, brightness, np.nan).astype(np.float32)


def values_at(path: Path, east: float, north: float) -> dict[str, float] | None:
    """True values of every band at a place; see `values_in`."""
    with open_raster(path) as dataset:
        return values_in(dataset, east, north)


def values_in(
    dataset: rasterio.DatasetReader, east: float, north: float
) -> dict[str, float] | None:
    """True values of every band in the cell that holds a place; None beyond the raster's edge.

    NaN where nothing was measured.
    """
    grid = grid_of(dataset)
    row = math.floor((grid.north - north) / grid.cell_m)
    col = math.floor((east - grid.west) / grid.cell_m)
    if not (0 <= row < grid.rows and 0 <= col < grid.cols):
        return None
    cell = dataset.read(window=Window(col, row, 1, 1), masked=True)[:, 0, 0]
    stored = np.ma.filled(cell.astype(np.float64), np.nan)
    true = stored * np.array(dataset.scales) + np.array(dataset.offsets)
    return dict(zip(_names(dataset), (float(value) for value in true), strict=True))
