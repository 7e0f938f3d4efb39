"""Write and read raster files: bands on one grid, in the local CRS of the landing site.

The layout of the bytes is defined in `products.formats.raster.cog`. In overviews of a DTM, values
of the band `class` are averaged, so they may lie between two class codes. Class layers contain the
names and colours of their classes; the colours can be distinguished without colour vision (Paul
Tol's bright and muted sets): traversable or visible ground is green or blue, other classes are
yellow, orange, purple or brown.

Rasters of other producers, such as orbital images in any Mars CRS, are resampled to a grid of the
map.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, get_args

import numpy as np
import rasterio
from pyproj import CRS
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import CRSError, RasterioError, RasterioIOError
from rasterio.session import DummySession
from rasterio.transform import Affine
from rasterio.warp import reproject, transform_bounds
from rasterio.windows import Window

from solmap.photogrammetry.arrays import Classes, Raster
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, Bounds, MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.traversability.hazard import Hazard
from solmap.photogrammetry.terrain.visibility.viewshed import Sight
from solmap.products.crs import height_reference
from solmap.products.errors import ProductError, ProductNotFoundError, StoreAwayError
from solmap.products.formats.raster.cog import (
    Band,
    Kind,
    OverviewResampling,
    RasterClass,
    RasterDescription,
    create_cog,
    is_held,
)

_DIRECTIONS = {"aspect"}
"""Bands with cyclic values."""
_DTM_UNITS = {"elevation": "m", "standard_deviation": "m", "observations": "", "class": ""}
_POSE_DEVIATION = "pose_deviation"
"""Present if pose errors were modelled: the part of the standard deviation that neighbouring cells
share."""
BLOCK_LEVELS = "BLOCK_LEVELS"
"""Tag of a terrain model: a digit a block, row by row: the overview that shows all of it; 0: none,
as in files without the tag."""
_REMOTE_OPTIONS = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
    "GDAL_INGESTED_BYTES_AT_OPEN": "32768",
}
"""GDAL options: no sidecar files are searched, and the header is read in one request."""
_PERMANENT_ERRORS = (
    "not recognized",
    "Access Denied",
    "AccessKeyId",
    "signature",
    "bucket does not exist",
)
"""Parts of GDAL messages for errors that a retry cannot fix: broken object, wrong keys, missing
bucket."""
_SAMPLED_CELLS = 1 << 18
"""Largest number of cells that `summarise` reads."""


@dataclass(frozen=True, slots=True)
class BandSummary:
    """Name, unit and range of a band, for catalogue and legend."""

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
    overviews: OverviewResampling | None = None,
) -> None:
    """Write bands on one grid: float32 (NaN where not measured) or uint8 (0 where not measured).

    Args:
        path: The file to write.
        grid: Grid of the cells, metres of the local map.
        bands: Cell values by the name of the band.
        crs: The local CRS of the landing site.
        unit: Unit of all bands, or of each by name: `m`, `degree`.
        tags: Further tags of the file, as text.
        overviews: Method of the overviews; default: mean; nearest cell if a band is a direction.

    Raises:
        ProductError: a band does not fit the grid, or types are mixed or unknown.
    """
    stack = _band_stack(path, grid, bands)
    units = {name: unit if isinstance(unit, str) else unit.get(name, "") for name in bands}
    kind: Kind = "float32" if stack[0].dtype == np.float32 else "uint8"
    description = _described(kind, units, tags, overviews)
    with create_cog(path, grid, crs, description) as dataset:
        for index, band in enumerate(stack, start=1):
            dataset.write(band, index)


def write_parts(
    path: Path,
    grid: MapGrid,
    units: Mapping[str, str],
    parts: Iterable[tuple[tuple[slice, slice], Mapping[str, Raster]]],
    crs: CRS,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write float32 bands from windows: rows and columns, values by the name of the band.

    `units` are those of the bands. Cells outside all windows are NaN.
    """
    with create_cog(path, grid, crs, _described("float32", units, tags)) as dataset:
        for (rows, cols), bands in parts:
            stack = np.stack([bands[name] for name in units])
            dataset.write(stack, window=Window.from_slices(rows, cols))


def _described(
    kind: Kind,
    units: Mapping[str, str],
    tags: Mapping[str, str] | None,
    overviews: OverviewResampling | None = None,
) -> RasterDescription:
    """Bands with their units, the first shown as grey."""
    colours = [ColorInterp.gray, *[ColorInterp.undefined] * (len(units) - 1)]
    bands = (Band(n, units[n], colour=c) for n, c in zip(units, colours, strict=True))
    averaged = overviews or ("NEAREST" if _DIRECTIONS & set(units) else "AVERAGE")
    return RasterDescription(kind, tuple(bands), averaged, tags)


def write_classes(  # noqa: PLR0913 - the properties of one file
    path: Path,
    grid: MapGrid,
    codes: Classes,
    crs: CRS,
    *,
    name: str,
    classes: Sequence[RasterClass],
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write a class layer, 0 where unknown, with class names and colours stored in the file."""
    if codes.shape != grid.shape:
        raise ProductError(
            f"{path.name}: class codes have shape {codes.shape}, but the grid has {grid.shape}"
        )
    band = Band(name, colour=ColorInterp.palette)
    description = RasterDescription("uint8", (band,), "NEAREST", tags, tuple(classes))
    with create_cog(path, grid, crs, description) as dataset:
        dataset.write(codes, 1)


def _band_stack(
    path: Path, grid: MapGrid, bands: Mapping[str, Raster | np.ndarray]
) -> list[np.ndarray]:
    if not bands:
        raise ProductError(f"{path.name}: no bands were given")
    stack = [np.asarray(band) for band in bands.values()]
    types = {band.dtype.name for band in stack}
    if len(types) > 1 or not types <= set(get_args(Kind)):
        raise ProductError(
            f"{path.name}: bands must be all float32 or all uint8; got {', '.join(sorted(types))}"
        )
    for name, band in zip(bands, stack, strict=True):
        if band.shape != grid.shape:
            raise ProductError(
                f"{path.name}: band {name} has shape {band.shape}, but the grid has {grid.shape}"
            )
    return stack


def open_raster(address: Path | str) -> rasterio.DatasetReader:
    """Open a raster for reading: a file, or an object in a store, by its GDAL path.

    Raises:
        ProductNotFoundError: there is no such file.
        StoreAwayError: the object store does not respond.
        ProductError: it cannot be read as a raster.
    """
    try:
        if isinstance(address, Path):
            return rasterio.open(address)
        with rasterio.Env(DummySession(), **_REMOTE_OPTIONS):
            return rasterio.open(address)
    except RasterioIOError as error:
        name = PurePosixPath(address).name
        if (
            not Path(address).is_file()
            if isinstance(address, Path)
            else "key does not" in str(error)
        ):
            raise ProductNotFoundError(
                f"{name} does not exist; run the processing that makes it (`solmap run`)"
            ) from error
        if isinstance(address, str) and not any(word in str(error) for word in _PERMANENT_ERRORS):
            raise StoreAwayError(f"the store of {name} does not respond: {error}") from error
        raise ProductError(f"{name} cannot be read as a raster: {error}") from error


def read_error(address: Path | str, error: RasterioError) -> ProductError:
    """The error for a part of an open raster that cannot be read."""
    name = PurePosixPath(address).name
    if isinstance(address, str):
        # GDAL does not distinguish a missing response from a broken object
        return StoreAwayError(
            f"the store of {name} does not respond, or the object is broken: {error}"
        )
    return ProductError(
        f"{name} is broken: {error}; `solmap check --repair` removes it, "
        "the next run makes it again"
    )


def grid_of(dataset: rasterio.DatasetReader) -> MapGrid:
    """The grid of an open raster."""
    transform = dataset.transform
    return MapGrid(transform.c, transform.f, transform.a, dataset.height, dataset.width)


def read_raster(
    path: Path, names: Collection[str] | None = None
) -> tuple[MapGrid, dict[str, np.ndarray]]:
    """The grid, and the stored values by band name; all bands, or those in `names`.

    Raises:
        ProductNotFoundError: there is no such file.
        ProductError: the file is broken.
    """
    with open_raster(path) as dataset:
        numbers = {
            name: number
            for number, name in enumerate(band_names(dataset), start=1)
            if names is None or name in names
        }
        try:
            stack = dataset.read(list(numbers.values()))  # each block holds all bands
        except RasterioError as error:
            raise read_error(path, error) from error
        return grid_of(dataset), dict(zip(numbers, stack, strict=True))


def band_names(dataset: rasterio.DatasetReader) -> list[str]:
    """The names of the bands of an open raster."""
    return [name or f"band {i}" for i, name in enumerate(dataset.descriptions, start=1)]


def class_names(dataset: rasterio.DatasetReader) -> dict[int, str]:
    """The names of the values of a class layer; empty for other rasters."""
    named = json.loads(dataset.tags().get("CLASSES", "{}"))
    return {int(value): str(name) for value, name in named.items()}


def summarise(path: Path) -> tuple[MapGrid, tuple[BandSummary, ...]]:
    """The grid, and for each band name, unit and range of scaled values.

    The range is estimated from an overview.
    """
    with open_raster(path) as dataset:
        shrink = max(1.0, math.sqrt(dataset.width * dataset.height / _SAMPLED_CELLS))
        shape = (math.ceil(dataset.height / shrink), math.ceil(dataset.width / shrink))
        bands_read = dataset.read(out_shape=(dataset.count, *shape), masked=True)
        bands = zip(
            band_names(dataset),
            dataset.units,
            bands_read,
            dataset.scales,
            dataset.offsets,
            strict=True,
        )
        return grid_of(dataset), tuple(
            BandSummary(name, unit or "", _range_of(values, scale, offset))
            for name, unit, values, scale, offset in bands
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
    """Write a terrain model: elevation, deviation, observations, class, pose deviation."""
    bands = {
        "elevation": dtm.elevation,
        "standard_deviation": dtm.sigma_m,
        "observations": dtm.observations,
        "class": dtm.ground.astype(np.float32),
        **({} if dtm.pose_sigma_m is None else {_POSE_DEVIATION: dtm.pose_sigma_m}),
    }
    units = {**_DTM_UNITS, _POSE_DEVIATION: "m"}
    all_tags = {"VERTICAL": height_reference(crs), **(tags or {})}
    write_raster(path, dtm.grid, bands, crs, unit=units, tags=all_tags)


def read_dtm(path: Path) -> Dtm:
    """The inverse of `write_dtm`.

    Raises:
        ProductError: the file is not a terrain model.
    """
    with open_dtm(path) as stored:
        grid = stored.grid
        return stored.part(slice(0, grid.rows), slice(0, grid.cols))


@contextlib.contextmanager
def open_dtm(path: Path) -> Iterator[StoredDtm]:
    """A terrain model to be read in parts.

    Raises:
        ProductError: the file is not a terrain model, or it is broken.
    """
    with open_raster(path) as dataset:
        names = band_names(dataset)
        missing = [name for name in _DTM_UNITS if name not in names]
        if missing:
            raise ProductError(f"{path.name} is not a terrain model: it has no band {missing[0]}")
        try:
            yield StoredDtm(grid_of(dataset), dataset)
        except RasterioError as error:
            raise read_error(path, error) from error


@dataclass(frozen=True, slots=True, eq=False)
class StoredDtm:
    """An open terrain model; blocks not stored in the file are not decoded."""

    grid: MapGrid
    _dataset: rasterio.DatasetReader

    def block_steps(self) -> np.ndarray:
        """Side of the largest cells that show all of a block, in cells; 0 where none is stored."""
        rows, cols = (-(-count // BLOCK) for count in self.grid.shape)
        held = [[is_held(self._dataset, row, col) for col in range(cols)] for row in range(rows)]
        levels = self._dataset.tags().get(BLOCK_LEVELS, "").split()
        steps = [[2 ** int(level) for level in row] for row in levels]
        return np.array(held, np.int32) * np.array(steps or 1, np.int32)

    def part(self, rows: slice, cols: slice) -> Dtm:
        """A window of the model, inside its grid; with a step, from an overview of the file."""
        grid = self.grid.window(rows, cols)
        window = Window(cols.start, rows.start, cols.stop - cols.start, rows.stop - rows.start)
        known = {name: k for k, name in enumerate(band_names(self._dataset), start=1)}
        names = [name for name in (*_DTM_UNITS, _POSE_DEVIATION) if name in known]
        # one call: each block holds all bands
        stack = self._dataset.read(
            [known[name] for name in names],
            window=window,
            out_shape=grid.shape,
            resampling=Resampling.average,
        )
        bands = dict(zip(names, stack, strict=True))
        bands["observations"] *= np.float32((grid.cell_m / self.grid.cell_m) ** 2)
        return Dtm(
            grid,
            elevation=bands["elevation"],
            sigma_m=bands["standard_deviation"],
            # blocks without data are not stored and read as NaN
            observations=np.nan_to_num(bands["observations"], copy=False),
            ground=np.nan_to_num(bands.pop("class"), copy=False).astype(np.uint8),
            pose_sigma_m=bands.get(_POSE_DEVIATION),
        )


def values_in(
    dataset: rasterio.DatasetReader, east: float, north: float
) -> dict[str, float] | None:
    """Scaled values of every band in the cell at a position; None outside the raster.

    NaN where nothing was measured.
    """
    found = grid_of(dataset).cell_at(east, north)
    if found is None:
        return None
    row, col = found
    cell = dataset.read(window=Window(col, row, 1, 1), masked=True)[:, 0, 0]
    stored = np.ma.filled(cell.astype(np.float64), np.nan)
    scaled = stored * np.array(dataset.scales) + np.array(dataset.offsets)
    return dict(zip(band_names(dataset), (float(value) for value in scaled), strict=True))


HAZARD_CLASSES = (
    RasterClass(Hazard.TRAVERSABLE, "traversable", "#44bb99"),
    RasterClass(Hazard.ROUGH, "too rough", "#eedd88"),
    RasterClass(Hazard.STEP, "step too high", "#ee8866"),
    RasterClass(Hazard.STEEP, "too steep", "#aa3377"),
)
VISIBILITY_CLASSES = (
    RasterClass(Sight.VISIBLE, "visible", "#77aadd"),
    RasterClass(Sight.HIDDEN, "hidden", "#664422"),
)


_PLANE = "+proj=eqc +R=3396190 +units=m +no_defs"
"""Stand-in CRS for source and target if both are the same engineering CRS, so that nothing is
transformed."""
MOST_CELLS = 100_000_000
"""Largest number of cells that may be read at once: 10,000 x 10,000."""


def bounds_on_map(path: Path, crs: CRS) -> tuple[Bounds, float]:
    """(west, south, east, north) of a raster on the local map, and the side of its cells, metres.

    Raises:
        ProductError: it has no CRS, or its CRS cannot be transformed to this map.
    """
    with open_raster(path) as dataset:
        if dataset.crs is None:
            raise ProductError(f"{path.name} has no CRS: georeference it, or give control points")
        try:
            source, target = _crs_of(dataset, crs)
            bounds = transform_bounds(source, target, *dataset.bounds, densify_pts=21)
        except (CRSError, RasterioError) as error:
            raise ProductError(f"{path.name} cannot be transformed to this map: {error}") from error
        if not np.isfinite(bounds).all():
            raise ProductError(f"{path.name} is not near the landing site")
        width_m = (bounds[2] - bounds[0]) / dataset.width
        height_m = (bounds[3] - bounds[1]) / dataset.height
    return bounds, float(np.sqrt(width_m * height_m))


def _crs_of(dataset: rasterio.DatasetReader, crs: CRS) -> tuple[str, str]:
    """The CRS of a raster and a map, in PROJ's form.

    PROJ has no operation from an engineering CRS to itself: a raster of a map that is not tied to
    the lander is not transformed.
    """
    own = dataset.crs.to_wkt()
    if crs.is_engineering and own.startswith(f'LOCAL_CS["{crs.name}"'):
        return _PLANE, _PLANE
    return own, crs.to_wkt()


def read_onto_grid(path: Path, grid: MapGrid, crs: CRS) -> Raster:
    """The first band of a raster on a grid of the local map; NaN where it has no data.

    Source cells smaller than two thirds of the grid's are averaged; others are interpolated.

    Raises:
        ProductError: the grid has too many cells, or the file is broken.
    """
    if grid.rows * grid.cols > MOST_CELLS:
        raise ProductError(
            f"{path.name} on {grid.shape} cells has too many cells: request a smaller area"
        )
    out = np.full(grid.shape, np.nan, dtype=np.float32)
    transform = Affine(grid.cell_m, 0.0, grid.west, 0.0, -grid.cell_m, grid.north)
    with open_raster(path) as dataset:
        source_is_finer = abs(dataset.transform.a) < grid.cell_m / 1.5
        try:
            source, target = _crs_of(dataset, crs)
            values = dataset.read(1, masked=True).astype(np.float32).filled(np.nan)
            reproject(
                values,
                out,
                src_transform=dataset.transform,
                src_crs=source,
                src_nodata=np.nan,
                dst_transform=transform,
                dst_crs=target,
                dst_nodata=np.nan,
                resampling=Resampling.average if source_is_finer else Resampling.cubic,
            )
        except (CRSError, RasterioError) as error:
            raise ProductError(f"{path.name} cannot be read: {error}") from error
        scale, offset = dataset.scales[0], dataset.offsets[0]
    return out * np.float32(scale) + np.float32(offset)
