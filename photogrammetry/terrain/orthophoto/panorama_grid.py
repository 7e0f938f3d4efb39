"""Pixels of panoramas, and the range of the ground in the direction of each.

Azimuth, clockwise from north, runs across, and elevation above the horizon runs down. Both are
linear in pixels (the "cylindrical" projection of rover panoramas), so a pixel has the same width
and height in degrees, and levelled: the horizontal plane is that of the LSL. The direction at
azimuth a and elevation e is

    (north, east, down) = (cos e cos a, cos e sin a, -sin e).

Along each azimuth the terrain is sampled at distances r that grow by a hundredth. The visible
ground at elevation angle e is the first that reaches it,

    r(e) = min { r : max over r' <= r of atan((z(r') - z_0) / r') >= e }.

Across gaps of the terrain model its height over the plane that the rover stands on is interpolated;
before its first and beyond its last known cell that height stays constant, over a plane that is
level from `LEVEL_M` on. Directions that no ground reaches are sky, too far away for any parallax.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Bool, Directions, Float64, ObjectPoints, Vector3
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import sample_bilinear
from solmap.photogrammetry.terrain.kernels import first_hits, without_gaps

CIRCLE = 360.0
NODE = 4
"""Distance of nodes in pixels: image coordinates are computed at nodes and interpolated, with an
error of (node / 2)^2 / 2 f = 0.002 px at most."""
MOST_ROWS = 1 << 14
LEAST_GAP_DEG = 5.0
"""Gap in degrees: the circle is cut in the widest gap between images if it is that wide, else at
north."""

Span = tuple[float, float]
"""First and last angle, degrees."""
NEAREST_M, FARTHEST_M = 0.3, 300.0
GROWTH = 1.01
LEVEL_M = 20.0
"""Distance from the rover beyond which its tilt does not describe the ground."""


@dataclass(frozen=True, slots=True)
class AngleGrid:
    """Rows and columns of a panorama; its outer upper left corner at (west, top), degrees."""

    west_deg: float
    top_deg: float
    cell_deg: float
    rows: int
    cols: int

    def __post_init__(self) -> None:
        whole = self.rows % NODE == 0 and self.cols % NODE == 0
        if self.rows < NODE or self.cols < NODE or not self.cell_deg > 0 or not whole:
            raise TerrainError(
                f"a panorama of {self.rows} x {self.cols} pixels of {self.cell_deg} degrees: give "
                f"whole multiples of {NODE} pixels"
            )

    @classmethod
    def covering(cls, azimuths: Iterable[Span], elevations: Span, pixel_deg: float) -> AngleGrid:
        """The smallest grid over these spans; its pixels are no finer than requested.

        Spans of azimuth may run past 360 degrees.
        """
        west, east = _span_of(list(azimuths))
        around = NODE * max(1, math.floor(CIRCLE / pixel_deg / NODE))
        cell = CIRCLE / around
        step = NODE * cell
        cols = NODE * min(around // NODE, math.ceil((east - west) / step - 1e-9))
        low, high = max(-90.0, elevations[0]), min(90.0, elevations[1])
        rows = NODE * min(MOST_ROWS // NODE, max(1, math.ceil((high - low) / step - 1e-9)))
        return cls(west, high, cell, rows, cols)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    def node_angles(
        self, row: int, col: int, rows: int, cols: int
    ) -> tuple[Float64[np.ndarray, " across"], Float64[np.ndarray, " down"]]:
        """Azimuths and elevations, degrees, of the nodes of a window, and one beyond each way."""
        across = col + NODE * np.arange(cols // NODE + 1)
        down = row + NODE * np.arange(rows // NODE + 1)
        return (
            self.west_deg + (across + 0.5) * self.cell_deg,
            self.top_deg - (down + 0.5) * self.cell_deg,
        )

    def pixels_of(
        self, directions: ObjectPoints
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """Fractional (row, col) of vectors (north, east, down); whole numbers are pixel centres."""
        north, east, down = directions.T
        azimuth = np.degrees(np.arctan2(east, north))
        elevation = np.degrees(np.arctan2(-down, np.hypot(north, east)))
        across = (azimuth - self.west_deg) % CIRCLE
        return (self.top_deg - elevation) / self.cell_deg - 0.5, across / self.cell_deg - 0.5


def direction(azimuth_deg: np.ndarray, elevation_deg: np.ndarray) -> np.ndarray:
    """Unit vectors (north, east, down), with a last axis of three."""
    azimuth, elevation = np.broadcast_arrays(np.radians(azimuth_deg), np.radians(elevation_deg))
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)], axis=-1)


def span_of_rays(rays: Directions, ahead: Vector3) -> tuple[Span, Span]:
    """Azimuths and elevations, degrees, between which rays (north, east, down) around one lie.

    A bundle that contains the nadir or zenith covers the full circle.
    """
    elevation = np.degrees(np.arcsin(np.clip(-rays[:, 2], -1.0, 1.0)))
    middle = math.degrees(math.atan2(ahead[1], ahead[0]))
    azimuth = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
    apart = (azimuth - middle + CIRCLE / 2) % CIRCLE - CIRCLE / 2
    low, high = float(elevation.min()), float(elevation.max())
    if float(np.diff(np.sort(apart)).max(initial=0.0)) < CIRCLE / 8 and np.ptp(apart) > CIRCLE / 2:
        down = ahead[2] > 0
        return (0.0, CIRCLE), (-90.0 if down else low, high if down else 90.0)
    return (middle + float(apart.min()), middle + float(apart.max())), (low, high)


def _span_of(spans: list[Span]) -> Span:
    """The span around all: from the end of the widest gap between them to its beginning."""
    if not spans:
        raise TerrainError("a panorama of no image")
    turned = sorted((west % CIRCLE, west % CIRCLE + (east - west)) for west, east in spans)
    reach, gaps = turned[0][1], []
    for west, east in turned[1:]:
        gaps.append((west - reach, west))
        reach = max(reach, east)
    gaps.append((turned[0][0] + CIRCLE - reach, turned[0][0]))
    widest, start = max(gaps)
    if widest < LEAST_GAP_DEG:
        return 0.0, CIRCLE
    return (start - CIRCLE if start > CIRCLE / 2 else start), (
        start - CIRCLE if start > CIRCLE / 2 else start
    ) + CIRCLE - widest


@dataclass(frozen=True, slots=True, eq=False)
class StandingPlane:
    """The plane on which a rover stands, in the local map (east, north, up), metres."""

    point: Vector3
    normal: Vector3

    def under(
        self, east: Float64[np.ndarray, "n m"], north: Float64[np.ndarray, "n m"]
    ) -> Float64[np.ndarray, "n m"]:
        """Its elevation at points; level beyond `LEVEL_M` from its own point."""
        across, along = east - self.point[0], north - self.point[1]
        shrink = np.minimum(1.0, LEVEL_M / np.maximum(np.hypot(across, along), 1e-9))
        a, b, c = self.normal
        return self.point[2] - shrink * (a * across + b * along) / c


@dataclass(frozen=True, slots=True, eq=False)
class GroundRanges:
    """Distances to the ground by direction."""

    range_m: Float64[np.ndarray, "down across"]
    is_measured: Bool[np.ndarray, "down across"]
    """Whether the terrain model is known there."""


def ground_ranges(
    centre: Vector3,
    azimuths_deg: Float64[np.ndarray, " across"],
    elevations_deg: Float64[np.ndarray, " down"],
    plane: StandingPlane,
    dtm: Dtm | None = None,
) -> GroundRanges:
    """Range of the ground from `centre` (east, north, up); elevations decrease from row to row."""
    count = int(np.log(FARTHEST_M / NEAREST_M) / np.log(GROWTH)) + 1
    r = NEAREST_M * GROWTH ** np.arange(count)
    turn = np.radians(azimuths_deg)[:, None]
    east, north = centre[0] + r * np.sin(turn), centre[1] + r * np.cos(turn)
    ground = plane.under(east, north)
    known = np.zeros(ground.shape, dtype=np.bool_)
    if dtm is not None:
        places = np.column_stack([east.ravel(), north.ravel()])
        height = sample_bilinear(dtm.elevation, dtm.grid, places).reshape(ground.shape) - ground
        known = np.isfinite(height)
        ground = ground + without_gaps(height, r)
    angle = np.arctan2(ground - centre[2], r)
    ranges, at = first_hits(angle, r, np.radians(elevations_deg))
    column = np.arange(len(turn))
    measured = known[column, np.clip(at, 0, count - 1)] & (at > 0) & (at < count)
    return GroundRanges(ranges, measured)
