"""Figures of the analyses of a simulated ground, for the documentation.

python -m tests.support.terrain.surface_figures crater 3 docs/figures
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from solmap.gis_server.rendering.styles import (
    indices_of,
    palette_of,
)
from solmap.photogrammetry.arrays import Classes, EightBits, Raster
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.resampling import coarsen
from solmap.photogrammetry.terrain.insolation.maps import (
    Haven,
    HavenParams,
    InsolationParams,
    insolation,
    winter_havens,
)
from solmap.photogrammetry.terrain.relief.slope import (
    HillshadeParams,
    SlopeParams,
    hillshade,
    northerly_tilt_of,
    slope_of,
)
from solmap.photogrammetry.terrain.traversability.hazard import HazardParams, hazards
from solmap.photogrammetry.terrain.visibility.viewshed import (
    ViewshedParams,
    viewshed,
)
from solmap.products.formats.raster.cog import RasterClass
from solmap.products.formats.raster.styles import (
    STYLES,
)
from solmap.products.model import ProductKind
from tests.support.terrain.whole_relief import whole_relief

GRID = MapGrid(-40.96, 40.96, 0.04, 2048, 2048)
LATITUDE = math.radians(-14.735)
SIDE = 480
"""Pixels along the side of one figure."""
OPACITY = 0.65


def _eye_on_mast(
    elevation: np.ndarray, grid: MapGrid, place: tuple[float, float], mast_m: float
) -> np.ndarray:
    """An eye (east, north, up) at a height above the ground at (east, north)."""
    cell = grid.cell_at(*place)
    assert cell is not None
    return np.array([*place, float(elevation[cell]) + mast_m])


def world_model(terrain: str, seed: int) -> Dtm:
    """The true ground of a simulated world as a terrain model."""
    return Dtm(
        grid=GRID,
        elevation=make_world(WorldParams(terrain=terrain), seed).true_elevation(GRID),
        sigma_m=np.full(GRID.shape, 0.02, np.float32),
        observations=np.ones(GRID.shape, np.float32),
        ground=np.full(GRID.shape, GroundClass.MEASURED, np.uint8),
    )


def images(dtm: Dtm) -> dict[str, EightBits]:
    """One figure of each kind, over the hillshade."""
    light = _shown(hillshade(dtm.elevation, dtm.grid.cell_m, HillshadeParams()), dtm.grid)
    relief, relief_grid = whole_relief(dtm, SlopeParams())
    lit = insolation(dtm, LATITUDE, InsolationParams())
    havens = winter_havens(lit, LATITUDE, HavenParams())
    coarse, coarse_grid = coarsen(dtm.elevation, dtm.grid, 0.16)
    eye = _eye_on_mast(coarse, coarse_grid, (0.0, 0.0), 1.5)
    seen = viewshed(coarse, coarse_grid, eye, ViewshedParams())
    danger, danger_grid = hazards(dtm, HazardParams())
    ramps = {
        "slope": (ProductKind.SLOPE, slope_of(relief.normal), relief_grid),
        "northerly-tilt": (
            ProductKind.NORTHERLY_TILT,
            northerly_tilt_of(relief.normal),
            relief_grid,
        ),
        "insolation": (ProductKind.INSOLATION, lit.received[0], lit.grid),
    }
    made = {name: _ramp(light, kind, _shown(v, g)) for name, (kind, v, g) in ramps.items()}
    made["havens"] = _outlined(made["insolation"].copy(), havens)
    classes = {
        "viewshed": (ProductKind.VIEWSHED, seen, coarse_grid),
        "hazard": (ProductKind.HAZARD, danger, danger_grid),
    }
    for name, (kind, codes, grid) in classes.items():
        made[name] = _classes(light, STYLES[kind].classes, _shown(codes, grid))
    return made


def _shown(values: Raster | Classes, grid: MapGrid) -> np.ndarray:
    """The part of a raster that the model covers, in the pixels of a figure."""
    top, left = (
        round((grid.north - GRID.north) / grid.cell_m),
        round((GRID.west - grid.west) / grid.cell_m),
    )
    side = round(GRID.rows * GRID.cell_m / grid.cell_m)
    part = np.ascontiguousarray(values[top : top + side, left : left + side])
    return cv2.resize(part, (SIDE, SIDE), interpolation=cv2.INTER_NEAREST)


def _over(light: np.ndarray, colour: np.ndarray, known: np.ndarray) -> EightBits:
    grey = np.repeat((255 * np.nan_to_num(light))[..., None], 3, axis=2)
    mixed = OPACITY * colour * (0.5 + 0.7 * np.nan_to_num(light))[..., None] + (1 - OPACITY) * grey
    return np.clip(np.where(known[..., None], mixed, grey), 0, 255).astype(np.uint8)


def _ramp(light: np.ndarray, kind: ProductKind, values: np.ndarray) -> EightBits:
    style = STYLES[kind]
    low, high = style.range or np.nanpercentile(values, (1, 99))
    colour = palette_of(style.colours)[indices_of(values, float(low), float(high))]
    return _over(light, colour, np.isfinite(values))


def _classes(light: np.ndarray, classes: Sequence[RasterClass], codes: np.ndarray) -> EightBits:
    table = np.zeros((256, 3), np.uint8)
    for one in classes:
        table[one.value] = one.rgb
    return _over(light, table[codes], codes > 0)


def _outlined(image: EightBits, havens: Sequence[Haven]) -> EightBits:
    scale = SIDE / (GRID.rows * GRID.cell_m)
    for haven in havens:
        for ring in (haven.outline, *haven.holes):
            pixels = np.column_stack([ring[:, 0] - GRID.west, GRID.north - ring[:, 1]]) * scale
            cv2.polylines(image, [np.rint(pixels).astype(np.int32)], True, (0, 255, 255), 1)  # noqa: FBT003
    return image


if __name__ == "__main__":
    terrain, seed, folder = sys.argv[1:4]
    for name, image in images(world_model(terrain, int(seed))).items():
        path = Path(folder) / f"ground-{name}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
