"""Panoramas' pixels: azimuth clockwise from north across, elevation above the horizon down.

Both are linear in pixels (the "cylindrical" projection of rover panoramas), so a pixel is as many
degrees wide as high, and levelled: the horizontal plane is that of the LSL. The direction at
azimuth a and elevation e is

    (north, east, down) = (cos e cos a, cos e sin a, -sin e).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Directions, Float64, ObjectPoints, Vector3
from solmap.photogrammetry.errors import TerrainError

CIRCLE = 360.0
NODE = 4
"""Pixels from node to node: directions are carried into images at nodes and interpolated between,
which is off by (node / 2)^2 / 2 f = 0.002 px at most."""
LEAST_GAP_DEG = 5.0
"""Where the circle is cut: in the widest gap between images if it is that wide, else north."""

Span = tuple[float, float]
"""From and to, degrees."""


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
    def covering(
        cls, azimuths: Iterable[Span], elevations: Span, pixel_deg: float, most_rows: int = 1 << 14
    ) -> AngleGrid:
        """The smallest grid over these spans, with pixels no finer than wanted that fill a circle.

        Spans of azimuth may run past 360 degrees.
        """
        west, east = _span_of(list(azimuths))
        around = NODE * max(1, math.floor(CIRCLE / pixel_deg / NODE))
        cell = CIRCLE / around
        step = NODE * cell
        cols = NODE * min(around // NODE, math.ceil((east - west) / step - 1e-9))
        low, high = max(-90.0, elevations[0]), min(90.0, elevations[1])
        rows = NODE * min(most_rows // NODE, max(1, math.ceil((high - low) / step - 1e-9)))
        return cls(west, high, cell, rows, cols)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    @property
    def is_circle(self) -> bool:
        """Whether its right edge meets its left one."""
        return self.cols * self.cell_deg > CIRCLE - self.cell_deg / 2

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

    A bundle that holds the nadir or zenith looks all the way around.
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
