"""Parts of products: the cells or features in a box, as files of the same kind.

Cells are copied as they are stored: the box grows to whole cells, nothing is resampled, and the
part names its source. Lines and areas are cut at the box.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio
import shapely
from pyproj import CRS
from rasterio.errors import RasterioError
from rasterio.windows import Window

from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.products.errors import OutsideCoverageError, ProductError
from solmap.products.formats.raster.cog import Band, RasterClass, RasterDescription, create_cog
from solmap.products.formats.raster.raster import (
    band_names,
    class_names,
    grid_of,
    open_raster,
    read_error,
)
from solmap.products.formats.vector.geojson import Feature, FeatureCollection

MOST_CELLS = 50_000_000
"""Most cells of all bands: 200 MB of floats."""
_AT_ONCE = 1024
"""Rows copied at a time."""
_CUT_FROM = "CUT_FROM"
_OWN = {"CLASSES", "AREA_OR_POINT"}
"""Tags that are written again for every file."""


def crop_raster(source: Path | str, target: Path, bounds: Bounds) -> MapGrid:
    """Write the cells that a box touches as a Cloud Optimised GeoTIFF; returns the part's grid.

    Raises:
        OutsideCoverageError: the box touches no cell.
        ProductError: it touches more cells than may be downloaded at once.
        StoreAwayError: the object store does not respond.
    """
    with open_raster(source) as dataset:
        window, part = _window(dataset, bounds)
        cells = part.rows * part.cols * dataset.count
        if cells > MOST_CELLS:
            raise ProductError(
                f"the box has {part.cols} x {part.rows} cells in {dataset.count} bands, more than "
                f"the {MOST_CELLS} that may be downloaded at once; use a smaller box, or the "
                "whole file"
            )
        crs = CRS.from_wkt(dataset.crs.to_wkt(version="WKT2_2019"))
        with create_cog(target, part, crs, _description_of(dataset)) as out:
            for row in range(0, part.rows, _AT_ONCE):
                rows = min(_AT_ONCE, part.rows - row)
                here = Window(window.col_off, window.row_off + row, part.cols, rows)
                out.write(_cells(dataset, source, here), window=Window(0, row, part.cols, rows))
    return part


def _cells(dataset: rasterio.DatasetReader, source: Path | str, window: Window) -> np.ndarray:
    try:
        return dataset.read(window=window)
    except RasterioError as error:
        raise read_error(source, error) from error


def _window(dataset: rasterio.DatasetReader, bounds: Bounds) -> tuple[Window, MapGrid]:
    """The window of the cells that a box touches, and their grid."""
    grid = grid_of(dataset)
    west, south, east, north = bounds
    left = max(0, math.floor((west - grid.west) / grid.cell_m))
    right = min(grid.cols, math.ceil((east - grid.west) / grid.cell_m))
    top = max(0, math.floor((grid.north - north) / grid.cell_m))
    bottom = min(grid.rows, math.ceil((grid.north - south) / grid.cell_m))
    if left >= right or top >= bottom:
        raise OutsideCoverageError(
            f"no cell is in the box {bounds}; the layer covers {grid.bounds}, metres"
        )
    window = Window(left, top, right - left, bottom - top)
    return window, grid.part(top, left, bottom - top, right - left)


def _description_of(dataset: rasterio.DatasetReader) -> RasterDescription:
    """Metadata of the whole file, marked as a part of it."""
    classes = class_names(dataset)
    colours = dataset.colormap(1) if classes else {}
    properties = zip(
        band_names(dataset),
        dataset.units,
        dataset.scales,
        dataset.offsets,
        dataset.colorinterp,
        strict=True,
    )
    bands = tuple(Band(name, unit or "", *rest) for name, unit, *rest in properties)
    averaged = not classes and "aspect" not in {band.name for band in bands}
    tags = {name: text for name, text in dataset.tags().items() if name not in _OWN}
    return RasterDescription(
        kind="uint8" if dataset.dtypes[0] == "uint8" else "float32",
        bands=bands,
        overview_resampling="AVERAGE" if averaged else "NEAREST",
        tags={**tags, _CUT_FROM: tags.get("PRODUCT", Path(dataset.name).name)},
        classes=tuple(
            RasterClass(value, name, "#" + bytes(colours[value][:3]).hex())
            for value, name in classes.items()
        ),
    )


def crop_features(collection: FeatureCollection, bounds: Bounds) -> FeatureCollection:
    """The features in a box; lines and areas are cut at it and may have several parts."""
    box = shapely.box(*bounds)
    cut = tuple(part for one in collection.features for part in _cut(one, box))
    return replace(collection, features=cut)


def _cut(feature: Feature, box: shapely.Geometry) -> Iterator[Feature]:
    shape = feature.shape
    if box.contains(shape):
        yield feature
        return
    for part in shapely.get_parts(shapely.intersection(shape, box)):
        if part.geom_type != feature.geometry or part.is_empty:
            continue  # a line that only touches a corner is not a line
        rings = [part.exterior, *part.interiors] if feature.geometry == "Polygon" else [part]
        first, *others = (_rows(ring) for ring in rings)
        yield replace(feature, points=first, holes=tuple(others))


def _rows(ring: shapely.Geometry) -> np.ndarray:
    return shapely.get_coordinates(ring, include_z=bool(ring.has_z))
