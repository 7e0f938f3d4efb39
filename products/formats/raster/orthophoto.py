"""Orthophotos on disk: 8-bit images, grey or colour, their sources, and textures cut from them.

Brightness is stretched to 1 .. 255, band by band, and 0 where there is no image; a band's scale and
offset convert back to brightness. The sources are a separate class layer at the cells of the
terrain model: the name of the image of each cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from pyproj import CRS
from rasterio.enums import ColorInterp, Resampling
from rasterio.windows import Window

from solmap.photogrammetry.arrays import Classes, EightBits, Float32, Raster
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.products.errors import ProductError
from solmap.products.formats.raster.cog import Band, RasterClass, RasterDescription, create_cog
from solmap.products.formats.raster.raster import (
    grid_of,
    open_raster,
    write_classes,
)

Stretch = tuple[float, float]
"""Brightness shown as black and as white."""
BrightnessBlock = tuple[int, int, Float32[np.ndarray, "bands rows cols"]]
"""First row and column of a block of an image, and its brightness; NaN where there is no image."""
_GREY = (("brightness", ColorInterp.gray),)
_COLOUR = (("red", ColorInterp.red), ("green", ColorInterp.green), ("blue", ColorInterp.blue))
_STRETCH_PERCENTILES = (0.5, 99.5)
"""Percentiles of brightness shown as black and white: beyond them are glint, deep shadow or
noise."""
_MOST_SOURCES = 255


def write_brightness_blocks(
    path: Path,
    grid: MapGrid,
    blocks: Iterable[BrightnessBlock],
    crs: CRS,
    *,
    stretches: Sequence[Stretch],
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write an image block by block, grey with one stretch and colour with three.

    Args:
        path: The file to write.
        grid: Grid of the cells.
        blocks: The blocks of the image; cells outside all of them have no image.
        crs: The local CRS of the landing site.
        stretches: Brightness shown black and white, by band.
        tags: Further tags of the file.
    """
    kinds = _GREY if len(stretches) == 1 else _COLOUR
    bands = [
        Band(name, "", scale, low - scale, colour)
        for (name, colour), (low, scale) in zip(kinds, map(_step, stretches), strict=True)
    ]
    with create_cog(
        path, grid, crs, RasterDescription("uint8", tuple(bands), tags=tags)
    ) as dataset:
        for row, col, brightness in blocks:
            shape = brightness.shape
            stack = [_grey(band, s) for band, s in zip(brightness, stretches, strict=True)]
            dataset.write(np.stack(stack), window=Window(col, row, shape[2], shape[1]))


def write_orthophoto(
    path: Path,
    grid: MapGrid,
    brightness: Raster,
    crs: CRS,
    *,
    stretch: Stretch | None = None,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write brightness (NaN where there is no image) as a grey image.

    By default, two percentiles of the brightness are shown as black and white.
    """
    stretches = [stretch or _stretch_of(brightness)]
    write_brightness_blocks(
        path, grid, [(0, 0, brightness[None])], crs, stretches=stretches, tags=tags
    )


def write_sources(
    path: Path,
    grid: MapGrid,
    source: Classes,
    names: Sequence[str],
    crs: CRS,
    *,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write the source image of each cell: 1 for the first of `names`, 0 for none.

    Raises:
        ProductError: there are more images than fit.
    """
    if len(names) > _MOST_SOURCES:
        raise ProductError(
            f"{path.name}: {len(names)} images, but only {_MOST_SOURCES} can be distinguished"
        )
    classes = tuple(RasterClass(i, name, source_colour(i)) for i, name in enumerate(names, start=1))
    write_classes(path, grid, source, crs, name="source", classes=classes, tags=tags)


def source_colour(number: int) -> str:
    """A colour for an image, different from its neighbours in the panorama: `#rrggbb`.

    Hues go around by the golden ratio, so that the first few and any few in a row differ.
    """
    hue = int(number * 0.618034 * 180) % 180
    lightness_saturation = (90 + 60 * (number % 3), 160)
    hls = np.array([[[hue, *lightness_saturation]]], np.uint8)
    red, green, blue = cv2.cvtColor(hls, cv2.COLOR_HLS2RGB)[0, 0].tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"


def _step(stretch: Stretch) -> tuple[float, float]:
    """The brightness shown black, and that of one grey level: 1 is black, 255 is white."""
    low, high = stretch
    return low, (high - low) / 254.0


def _grey(brightness: Raster, stretch: Stretch) -> Classes:
    low, step = _step(stretch)
    scaled = (brightness - np.float32(low)) * np.float32(1 / step) + np.float32(1)
    seen = np.isfinite(scaled)
    grey = np.rint(np.clip(scaled, 1.0, 255.0, out=scaled), out=scaled)
    return np.where(seen, grey, np.float32(0)).astype(np.uint8)


def _stretch_of(brightness: Raster) -> Stretch:
    seen = brightness[np.isfinite(brightness)]
    if not seen.size:
        return 0.0, 254.0
    low, high = (float(value) for value in np.percentile(seen, _STRETCH_PERCENTILES))
    return (low, high) if high > low else (low - 1.0, low + 1.0)


_EXTENDED_PX = 4
"""Pixels by which the image is extended beyond its edge: the reach of filtering and two mipmaps."""
_BLANK = 128
"""Grey of ground without image."""
_TINY = 1e-6
"""Tolerance of decimal fractions, in cells."""


def read_textures(
    path: Path, places: Iterable[Bounds], max_px: int
) -> Iterator[tuple[EightBits, Bounds]]:
    """An orthophoto within each (west, south, east, north), and the outer bounds of its pixels.

    It is shrunk until its longest side is at most `max_px` pixels. Ground without image is grey,
    except for a few pixels along its edge that continue the image.
    """
    with open_raster(path) as dataset:
        grid = grid_of(dataset)
        for west, south, east, north in places:
            first_col = math.floor((west - grid.west) / grid.cell_m + _TINY)
            first_row = math.floor((grid.north - north) / grid.cell_m + _TINY)
            cols = max(1, math.ceil((east - grid.west) / grid.cell_m - _TINY) - first_col)
            rows = max(1, math.ceil((grid.north - south) / grid.cell_m - _TINY) - first_row)
            shrink = max(1.0, max(rows, cols) / max_px)
            stored = np.zeros(
                (max(1, round(rows / shrink)), max(1, round(cols / shrink))), np.uint8
            )
            down, top, height = _inside(first_row, rows, stored.shape[0], grid.rows)
            across, left, width = _inside(first_col, cols, stored.shape[1], grid.cols)
            if stored[down, across].size:
                stored[down, across] = dataset.read(
                    1,
                    window=Window(left, top, width, height),
                    out_shape=stored[down, across].shape,
                    resampling=Resampling.average,
                )
            yield _extend_edges(stored), grid.part(first_row, first_col, rows, cols).bounds


def _inside(first: int, count: int, pixels: int, size: int) -> tuple[slice, float, float]:
    """Pixels of a texture of some cells that are on the image, their first cell and their width."""
    cells = count / pixels
    low = max(0, math.ceil(-first / cells))
    high = max(low, min(pixels, math.floor((size - first) / cells)))
    return slice(low, high), first + low * cells, (high - low) * cells


def _extend_edges(grey: EightBits) -> EightBits:
    """The image with its pixels extended into unseen ones (0), and grey beyond."""
    extended = cv2.dilate(grey, np.ones((2 * _EXTENDED_PX + 1,) * 2, np.uint8))
    extended[extended == 0] = _BLANK
    return np.where(grey > 0, grey, extended)
