"""Figures of orthophotos for the documentation.

Run as `python -m tests.support.terrain.orthophoto_figures STORE SCOPE FOLDER`.

The orthophoto of a stop, the same with the images it came from in colours, and a detail at full
resolution, beside each other.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.windows import Window

from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind

SIDE = 640
QUALITY = 68


def grey(path: Path, centre: tuple[float, float], half_m: float) -> np.ndarray:
    """A square of an orthophoto around (east, north), as an image of `SIDE` pixels."""
    with rasterio.open(path) as dataset:
        return dataset.read(1, window=_window(dataset, centre, half_m), **_as(Resampling.average))


def colours(path: Path, centre: tuple[float, float], half_m: float) -> np.ndarray:
    """The same square of a layer of sources, red, green and blue."""
    with rasterio.open(path) as dataset:
        table = np.array([dataset.colormap(1)[i][:3] for i in range(256)], np.uint8)
        window = _window(dataset, centre, half_m)
        return table[dataset.read(1, window=window, **_as(Resampling.nearest))]


def _as(how: Resampling) -> dict:
    return {"out_shape": (SIDE, SIDE), "resampling": how, "boundless": True, "fill_value": 0}


def _window(dataset, centre: tuple[float, float], half_m: float) -> Window:
    cell_m = dataset.transform.a
    col = (centre[0] - half_m - dataset.bounds.left) / cell_m
    row = (dataset.bounds.top - centre[1] - half_m) / cell_m
    return Window(col, row, 2 * half_m / cell_m, 2 * half_m / cell_m)


def main() -> None:
    """Read the arguments and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("scope")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--centre", type=float, nargs=2, default=(0.0, 0.0))
    arguments = parser.parse_args()
    workspace = Workspace.open(arguments.store)
    image, sources = (
        workspace.store.path(workspace.catalogue.layer(arguments.scope, kind).ref)
        for kind in (ProductKind.ORTHOPHOTO, ProductKind.SOURCES)
    )
    east, north = arguments.centre
    whole = np.dstack([grey(image, (east, north), 30.0)] * 3)
    tinted = (0.55 * whole + 0.45 * colours(sources, (east, north), 30.0)).astype(np.uint8)
    tinted[~whole.any(axis=2)] = 0
    detail = np.dstack([grey(image, (east + 3.5, north + 3.5), 3.2)] * 3)
    sheet = np.hstack([whole, tinted, detail])[:, :, ::-1]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    path = arguments.folder / "orthophoto.jpg"
    cv2.imwrite(str(path), sheet, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


if __name__ == "__main__":
    main()
