"""Maps of insolation, the solar energy received by the ground in a sol, and winter havens.

    H = integral over the sol of  lit(t) G_b(t) max(0, n.s(t))  +  V G_d(t)

n is the normal of the ground over the baseline, s the direction to the sun, and lit whether the sun
is above the cell's horizon (`horizon`). V is the visible fraction of the sky, weighted by
incidence, for a sky of uniform brightness: with h the horizon's elevation, S the slope and A the
aspect (Dozier and Frew 1990, IEEE Trans. Geosci. Remote Sensing 28),

    V = 1/2pi integral over azimuth p of  cos S cos^2 h + sin S cos(p - A) (pi/2 - h - sin h cos h)

where h is at least the rise of the ground's own plane. On level ground with a free horizon V = 1.
Light reflected by other ground is neglected: it adds about one percent (Appelbaum, Flood and
Norambuena 1994).

With the sun at local noon in the north at the elevation SA, n.s = u cos SA - w sin SA, which is
what VICAR's `marsslope` calls solar energy. Noon alone overrates steep ground: a slope to the north
loses the morning and the evening.

Winter havens are ground with enough winter sun for a rover with solar panels: it has to park on
ground tilted to the sun, which was found on maps of north-facing slopes (Di et al. 2008, section
6). Here a cell qualifies by its insolation in the season, including shadows of the horizon, as a
multiple of that of level ground; a least tilt can also be required. Of the qualifying ground, only
parts that can hold a disc as wide as the rover are kept, and of those, areas large enough to park
on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import contourpy
import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, Float64, PerPoint, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import Gradients, window_gradients
from solmap.photogrammetry.ranges import (
    CellSize,
    FactorOrZero,
    MapCells,
    OpticalDepth,
    Share,
    ShortMetres,
    Slope,
    SolarLongitude,
    SquareMetres,
    Tilt,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import (
    Terrain,
    coarse_elevation,
    manageable_cell_m,
)
from solmap.photogrammetry.terrain.dtm.resampling import seen_window
from solmap.photogrammetry.terrain.insolation.horizon import Horizons, horizons
from solmap.photogrammetry.terrain.insolation.sun import (
    SOL_HOURS,
    Season,
    beam_share,
    diffuse_share,
    half_day,
    local_winter,
    sun_directions,
)
from solmap.photogrammetry.terrain.relief.slope import (
    Normals,
    normals_of,
    northerly_tilt_of,
    slope_of,
)

STEP_HOURS = 0.25
"""Longest step between suns, Mars hours: the sun moves by less than four degrees."""
Ring = Float64[np.ndarray, "_ 2"]
"""(east, north), metres; the first and last are equal."""


@dataclass(frozen=True, slots=True)
class InsolationParams:
    """For which seasons and sky to map insolation, and how finely."""

    ls_deg: tuple[SolarLongitude, ...] = ()
    """Areocentric solar longitudes of the seasons; the local winter solstice when empty."""
    optical_depth: OpticalDepth = 0.5
    """Optical depth of dust: measured by the Viking landers outside storms (Appelbaum and Flood
    1990, figure 3)."""
    cell_m: CellSize = 0.16
    """Side of a cell: a fourteenth of a rover's length, and sixteen cells of a stop's model."""
    most_cells: MapCells = 2_000_000
    """Most cells, 400 MB: for larger areas the cells are doubled. A stop has 0.2 million."""
    baseline_m: ShortMetres = 1.1
    """Baseline of the ground's tilt: about a wheel base, as for slope."""
    min_share: Share = 0.5
    """Least fraction of that window with an elevation."""

    def seasons(self, latitude: float) -> tuple[Season, ...]:
        """The seasons to map at a latitude, the first of which chooses winter havens."""
        return tuple(map(Season, self.ls_deg)) or (local_winter(latitude),)


@dataclass(frozen=True, slots=True, eq=False)
class Insolation:
    """Energy per sol on every cell of a map, by season."""

    grid: MapGrid
    seasons: tuple[Season, ...]
    received: tuple[Raster, ...]
    """Wh/m^2 per sol, one raster per season."""
    level: tuple[float, ...]
    """Insolation of level ground with a free horizon."""
    sky: Raster
    """Visible fraction of the sky, V."""
    normal: Normals


def insolation(terrain: Terrain, latitude: float, params: InsolationParams) -> Insolation:
    """Insolation of a terrain model at a planetographic latitude (radians)."""
    cell_m = max(terrain.grid.cell_m, params.cell_m)
    cell_m = manageable_cell_m(terrain, cell_m, params.most_cells)
    coarse, coarse_grid = coarse_elevation(terrain, cell_m)
    window = seen_window(coarse)
    seen = np.ascontiguousarray(coarse[window])
    gradient = window_gradients(seen, coarse_grid.cell_m, params.baseline_m, params.min_share)
    normal = normals_of(gradient)
    rise = horizons(seen, coarse_grid.cell_m)
    sky = sky_view(rise, gradient)
    seasons = params.seasons(latitude)
    days = [_Day.of(season, latitude, params.optical_depth) for season in seasons]
    received = [day.on(normal, rise, sky) for day in days]
    return Insolation(
        coarse_grid,
        seasons,
        tuple(_place_window(one, window, coarse.shape) for one in received),
        tuple(day.level for day in days),
        _place_window(sky, window, coarse.shape),
        np.stack([_place_window(part, window, coarse.shape) for part in normal]),
    )


def sky_view(rise: Horizons, gradient: Gradients) -> Raster:
    """Visible fraction V of the sky for every cell; NaN where there is no gradient."""
    g_east, g_north = gradient
    cos_slope = 1 / np.sqrt(1 + g_east**2 + g_north**2)
    total = np.zeros_like(g_east)
    for tangent, azimuth in zip(rise, _azimuths(len(rise)), strict=True):
        own = g_east * np.float32(math.sin(azimuth)) + g_north * np.float32(math.cos(azimuth))
        h = np.arctan(np.maximum(tangent, own))
        # sin S cos(p - A) = -cos S times the rise of the plane towards p
        total += cos_slope * (np.cos(h) ** 2 - own * (np.pi / 2 - h - np.sin(h) * np.cos(h)))
    return np.clip(total / len(rise), 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class _Day:
    """The suns of one sol: their directions, and the energy of each."""

    directions: Float64[np.ndarray, "n 3"]
    beam: PerPoint
    """Wh/m^2 normal to the beam in the step of each sun."""
    diffuse: float
    """Wh/m^2 per sol from the sky on level ground."""

    @classmethod
    def of(cls, season: Season, latitude: float, optical_depth: float) -> _Day:
        half = half_day(latitude, season.declination)
        count = max(2, math.ceil(2 * half / (2 * math.pi) * 24 / STEP_HOURS))
        hour_angle = half * (2 * (np.arange(count) + 0.5) / count - 1)
        directions = sun_directions(latitude, season.declination, hour_angle)
        energy = season.irradiance * SOL_HOURS * half / math.pi / count
        up = np.maximum(directions[:, 2], 0)
        beam = energy * beam_share(up, optical_depth)
        return cls(directions, beam, energy * float(diffuse_share(up, optical_depth).sum()))

    @property
    def level(self) -> float:
        """Wh/m^2 per sol on level ground with a free horizon."""
        return float(self.beam @ np.maximum(self.directions[:, 2], 0)) + self.diffuse

    def on(self, normal: Normals, rise: Horizons, sky: Raster) -> Raster:
        """Wh/m^2 per sol on ground with these normals, horizons and views of the sky."""
        u, v, w = normal
        direct = np.zeros_like(u)
        for (north, east, up), beam in zip(self.directions.tolist(), self.beam, strict=True):
            incidence = np.maximum(u * north + v * east - w * up, 0)
            lit = horizon_towards(rise, math.atan2(east, north)) < up / math.hypot(north, east)
            direct += np.float32(beam) * incidence * lit
        return direct + np.float32(self.diffuse) * sky


def horizon_towards(rise: Horizons, azimuth: float) -> Raster:
    """Tangent of the horizon towards an azimuth (radians), between its neighbours."""
    place = azimuth / (2 * math.pi) * len(rise) % len(rise)
    before, share = int(place) % len(rise), np.float32(place - int(place))
    after = rise[(before + 1) % len(rise)]
    return rise[before] * (1 - share) + after * share


def _azimuths(count: int) -> Sequence[float]:
    return (2 * math.pi * np.arange(count) / count).tolist()


def _place_window(
    part: Float32[np.ndarray, "part_rows part_cols"],
    window: tuple[slice, slice],
    shape: tuple[int, ...],
) -> Raster:
    """A window's values in the whole raster; NaN around it."""
    whole = np.full(shape, np.nan, np.float32)
    whole[window] = part
    return whole


@dataclass(frozen=True, slots=True)
class HavenParams:
    """Criteria of winter havens."""

    least_gain: FactorOrZero = 1.06
    """Least insolation over that of level ground. At Gusev in the middle of winter, with an optical
    depth of 0.5, a tilt to the north of 5, 8, 10 and 15 degrees gives 1.04, 1.06, 1.08 and 1.11."""
    least_tilt_to_sun_deg: Tilt = 0.0
    """Least tilt towards the equator: to north in the south. Spirit's second haven had 11."""
    steepest_deg: Slope = 25.0
    """Steepest ground to drive onto: Spirit's winters were spent at up to 30 degrees."""
    width_m: ShortMetres = 1.6
    """Least width everywhere: MER with its wheels."""
    least_area_m2: SquareMetres = 4.0
    """Least area: MER is 1.6 by 2.3 m."""

    def __post_init__(self) -> None:
        if not self.width_m > 0 or not self.least_area_m2 > 0:
            raise TerrainError(
                f"a haven needs a width and an area above zero, not {self.width_m} m and "
                f"{self.least_area_m2} m2"
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
    """Mean insolation, Wh/m^2 per sol."""
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
    good = _open_with_disc(good, params.width_m / light.grid.cell_m)
    found = []
    for cells, outline, holes in _areas(good, light.grid):
        area_m2 = float(cells.sum()) * light.grid.cell_m**2
        if area_m2 >= params.least_area_m2:
            means = (float(part[cells].mean()) for part in (gain, light.received[0], tilt, slope))
            found.append(Haven(outline, holes, area_m2, *means))
    return tuple(sorted(found, key=lambda haven: -haven.area_m2))


def _open_with_disc(
    good: Bool[np.ndarray, "rows cols"], width: float
) -> Bool[np.ndarray, "rows cols"]:
    """Cells that a disc of this width in cells can cover within the good ones."""
    side = 2 * math.floor(width / 2) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    opened = cv2.morphologyEx(
        good.astype(np.uint8), cv2.MORPH_OPEN, disc, borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return opened.astype(bool)


def _areas(
    good: Bool[np.ndarray, "rows cols"], grid: MapGrid
) -> Iterator[tuple[Bool[np.ndarray, "rows cols"], Ring, tuple[Ring, ...]]]:
    """Cells connected by their sides, with their outline and holes."""
    count, labels = cv2.connectedComponents(good.astype(np.uint8), connectivity=4)
    for number in range(1, count):
        cells = labels == number
        for outline, holes in _outlines(cells, grid):
            yield cells, outline, holes


def _outlines(
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
