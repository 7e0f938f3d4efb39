"""Winter havens: ground on which a rover receives enough of the winter sun.

In winter a rover with solar panels has to stand on ground that leans to the sun; maps of slopes
that face north were made from terrain models to find it (Di et al. 2008, section 6). Here a cell
qualifies by the light it receives in the season, shadows of the horizon included, as a multiple of
what level ground would; a tilt may be asked for as well. Of the qualifying ground only what a disc
as wide as the rover can lie on is kept, and of that, areas large enough to stand on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import contourpy
import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Float64
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.insolation import Insolation
from solmap.photogrammetry.terrain.slope import northerly_tilt_of, slope_of

Ring = Float64[np.ndarray, "_ 2"]
"""(east, north), metres; the first and last are equal."""


@dataclass(frozen=True, slots=True)
class HavenParams:
    """What makes ground a winter haven."""

    least_gain: float = 1.06
    """Least insolation over that of level ground. At Gusev in the middle of winter, with an optical
    depth of 0.5, a tilt to the north of 5, 8, 10 and 15 degrees gives 1.04, 1.06, 1.08 and 1.11."""
    least_tilt_to_sun_deg: float = 0.0
    """Least tilt towards the equator: to north in the south. Spirit's second haven had 11."""
    steepest_deg: float = 25.0
    """Steepest ground to drive onto: Spirit's winters were spent at up to 30 degrees."""
    width_m: float = 1.6
    """Least width everywhere: MER with its wheels."""
    least_area_m2: float = 4.0
    """Least area: MER is 1.6 by 2.3 m."""

    def __post_init__(self) -> None:
        if not self.width_m > 0 or not self.least_area_m2 > 0:
            raise TerrainError(
                f"a haven {self.width_m} m wide of {self.least_area_m2} m2: give both above zero"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Haven:
    """An area to spend the winter on."""

    outline: Ring
    holes: tuple[Ring, ...]
    area_m2: float
    gain: float
    """Mean insolation over that of level ground."""
    insolation: float
    """Mean insolation, Wh/m^2 a sol."""
    tilt_to_sun_deg: float
    """Mean tilt towards the equator."""
    slope_deg: float
    """Mean slope."""


def winter_havens(light: Insolation, latitude: float, params: HavenParams) -> tuple[Haven, ...]:
    """Havens in the first season of a map of insolation, the largest first; none in polar night."""
    if not light.level[0] > 0:
        return ()
    gain = light.received[0] / np.float32(light.level[0])
    tilt = northerly_tilt_of(light.normal) * np.float32(1 if latitude < 0 else -1)
    slope = slope_of(light.normal)
    good = (gain >= params.least_gain) & (slope <= params.steepest_deg)
    good &= tilt >= params.least_tilt_to_sun_deg
    good = _as_wide_as(good, params.width_m / light.grid.cell_m)
    found = []
    for cells, outline, holes in _areas(good, light.grid):
        area_m2 = float(cells.sum()) * light.grid.cell_m**2
        if area_m2 >= params.least_area_m2:
            means = (float(part[cells].mean()) for part in (gain, light.received[0], tilt, slope))
            found.append(Haven(outline, holes, area_m2, *means))
    return tuple(sorted(found, key=lambda haven: -haven.area_m2))


def _as_wide_as(good: Bool[np.ndarray, "rows cols"], width: float) -> Bool[np.ndarray, "rows cols"]:
    """Cells that a disc of this width in cells can cover without leaving the good ones."""
    side = 2 * math.floor(width / 2) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    opened = cv2.morphologyEx(
        good.astype(np.uint8), cv2.MORPH_OPEN, disc, borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return opened.astype(bool)


def _areas(
    good: Bool[np.ndarray, "rows cols"], grid: MapGrid
) -> Iterator[tuple[Bool[np.ndarray, "rows cols"], Ring, tuple[Ring, ...]]]:
    """Cells that hang together by their sides, with their outline and holes."""
    count, labels = cv2.connectedComponents(good.astype(np.uint8), connectivity=4)
    for number in range(1, count):
        cells = labels == number
        for outline, holes in _outlined(cells, grid):
            yield cells, outline, holes


def _outlined(
    cells: Bool[np.ndarray, "rows cols"], grid: MapGrid
) -> Iterator[tuple[Ring, tuple[Ring, ...]]]:
    """The outline of one area, half a cell around the centres of its outer cells."""
    rows, cols = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    part = np.pad(cells[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1], 1).astype(np.float64)
    east, north = grid.centres()
    tracer = contourpy.contour_generator(
        x=east[cols[0]] + grid.cell_m * (np.arange(part.shape[1]) - 1.0),
        y=north[rows[0]] - grid.cell_m * (np.arange(part.shape[0]) - 1.0),
        z=part,
        fill_type=contourpy.FillType.OuterOffset,
    )
    filled: Any = tracer.filled(0.5, 2.0)
    for points, offsets in zip(*filled, strict=True):
        rings = [np.round(points[a:b], 3) for a, b in itertools.pairwise(offsets)]
        yield rings[0], tuple(rings[1:])
