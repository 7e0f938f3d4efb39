"""Occluded ground: hidden from every pair, by lines of sight over the terrain model.

Around each camera the model is sampled along profiles, one per azimuth. With the elevation h above
the camera at the distance r and the tangent T = h / r, known ground up to r hides ground below

    M(r) = max T(r')      over r' <= r

In gaps of the model, ground is assumed to be as low as the lower of the two known cells beside the
gap on the profile. It is hidden if its tangent is a line of the image or more below M.

Between the distance r_1 at which M was reached and the distance r_2 of the next higher tangent T_2,
visible ground would be on planes that pass

    H = (T_2 - M) / (1/r_1 - 1/r_2)

below the camera. Continuous ground passes at least `min_height_m` below (see `ground`); where H is
less, the image jumps from r_1 to r_2, and the ground between is hidden at any elevation. Beyond the
last known ground, r_2 is the distance at which the image shows ground too far to be used.

Stereo needs both images, so ground hidden from one camera is enough. A cell without elevation is
OCCLUDED when it is in the field and within the reach of some pair, and is hidden from every such
pair. Where one pair could have seen it, it stays UNSEEN: matching failed there (shadow, ground
without texture, blunders), and another image of the same ground might help.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Classes, Float32, Raster, Vector3
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.ground import (
    SightParams,
    camera_on_map,
    map_from_pair_rotation,
    reach_m,
)
from solmap.photogrammetry.terrain.dtm.records import GroundClass, TerrainView
from solmap.photogrammetry.terrain.kernels import hidden_along, places_in_fan
from solmap.photogrammetry.threads import in_threads

LINES = 1.0
"""Fewest lines of the image by which something counts as above another."""
LEAST_FAR_PX = 3
"""Side of the smallest patch of far parallax that is used."""
BORDER_STEP_PX = 16
"""Step in pixels along the border of an image for its azimuths."""
MARGIN = float(np.radians(8.0))
"""Margin of the right camera's profiles beyond the field of the left one."""
NEAREST_M = 0.1

Profiles = Float32[np.ndarray, "ranges azimuths"]
Marks = Bool[np.ndarray, "ranges azimuths"]
Distances = Float32[np.ndarray, "ranges 1"]
Cells = Bool[np.ndarray, "rows cols"]
Azimuths = Float32[np.ndarray, " azimuths"]


def mark_occluded(
    ground: Classes,
    elevation: Raster,
    grid: MapGrid,
    views: Sequence[TerrainView],
    params: SightParams,
) -> Classes:
    """The classes of a terrain model with its hidden cells marked."""
    without = ground == GroundClass.UNSEEN
    free, hidden = (np.zeros(grid.shape, dtype=np.bool_) for _ in range(2))
    found = (free, hidden)  # in which two views may set the same cells at the same time
    in_threads(lambda view: _mark_view(view, elevation, grid, without, params, found), views)
    marked = ground.copy()
    marked[without & hidden & ~free] = GroundClass.OCCLUDED
    return marked


def _mark_view(
    view: TerrainView,
    elevation: Raster,
    grid: MapGrid,
    without: Cells,
    params: SightParams,
    found: tuple[Cells, Cells],
) -> None:
    """Mark cells without elevation that a view could see, and those it could not."""
    left = camera_on_map(view.lsl_from_pair)
    base = map_from_pair_rotation(view.lsl_from_pair)[:, 0] * view.geometry.base_m
    fan = _Fan.of(view, left, grid.cell_m, params)
    window = fan.window(grid)
    rows, cols = fan.cells(grid, without, window)
    if not len(rows):
        return
    beyond = _far_ground(view, fan, params)
    states = []
    for eye in (left, left + base):
        seen = _Profiles.of(fan.around(eye), elevation, grid, beyond, (view, params))
        in_field = _in_field(view, seen, params) if eye is left else None
        states.append(seen.fan.at(grid, rows, cols, seen.hidden, in_field))
    inside = states[0][1]
    is_hidden = states[0][0] | states[1][0]
    free, hidden = found
    free[rows[inside & ~is_hidden], cols[inside & ~is_hidden]] = True
    hidden[rows[inside & is_hidden], cols[inside & is_hidden]] = True


@dataclass(frozen=True, slots=True, eq=False)
class _Fan:
    """Profiles around a camera: distances and azimuths (clockwise from north) to sample."""

    eye: Vector3
    first: float
    step: float
    azimuths: int
    cell_m: float
    ranges: int

    @classmethod
    def of(cls, view: TerrainView, eye: Vector3, cell_m: float, params: SightParams) -> _Fan:
        """The profiles of a view's field, as far as it is used."""
        reach = reach_m(view, params)
        low, high = _field(view)
        step = 2 * cell_m / reach
        azimuths = int(np.ceil((high - low) / step)) + 1
        return cls(eye, low, step, azimuths, cell_m, int(np.ceil(reach / cell_m)))

    def around(self, eye: Vector3) -> _Fan:
        """The same around the other camera of the pair."""
        return _Fan(eye, self.first, self.step, self.azimuths, self.cell_m, self.ranges)

    @property
    def distance_m(self) -> Distances:
        """Distances from the camera on the map."""
        return ((np.arange(self.ranges, dtype=np.float32) + 0.5) * np.float32(self.cell_m))[:, None]

    def window(self, grid: MapGrid) -> tuple[slice, slice]:
        """Rows and columns of the grid that cover the fan."""
        azimuth = self.first + np.arange(self.azimuths) * self.step
        reach = self.ranges * self.cell_m
        east = self.eye[0] + np.r_[0.0, reach * np.sin(azimuth)]
        north = self.eye[1] + np.r_[0.0, reach * np.cos(azimuth)]
        rows = np.clip(
            (grid.north - np.array([north.max(), north.min()])) / grid.cell_m, 0, grid.rows
        )
        cols = np.clip((np.array([east.min(), east.max()]) - grid.west) / grid.cell_m, 0, grid.cols)
        return slice(int(rows[0]), int(rows[1]) + 1), slice(int(cols[0]), int(cols[1]) + 1)

    def cells(
        self, grid: MapGrid, cells: Cells, window: tuple[slice, slice]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the requested cells in the fan, to about a cell."""
        east, north = (axis.astype(np.float32) for axis in grid.centres())
        east = east[window[1]][None, :] - np.float32(self.eye[0])
        north = north[window[0]][:, None] - np.float32(self.eye[1])
        near = cells[window] & (east**2 + north**2 < np.float32((self.ranges * self.cell_m) ** 2))
        width = (self.azimuths - 1) * self.step
        if width < np.pi:
            first, last = self.first - self.step, self.first + width + self.step
            near &= east * np.float32(np.cos(first)) >= north * np.float32(np.sin(first))
            near &= east * np.float32(np.cos(last)) <= north * np.float32(np.sin(last))
        rows, cols = np.nonzero(near)
        return rows + window[0].start, cols + window[1].start

    def read(self, elevation: Raster, grid: MapGrid) -> Profiles:
        """The model along the profiles; NaN in gaps."""
        azimuth = (self.first + np.arange(self.azimuths) * self.step).astype(np.float32)
        row0 = np.float32((grid.north - self.eye[1]) / grid.cell_m - 0.5)
        col0 = np.float32((self.eye[0] - grid.west) / grid.cell_m - 0.5)
        cells = self.distance_m / np.float32(grid.cell_m)
        return cv2.remap(
            elevation,
            col0 + cells * np.sin(azimuth),
            row0 - cells * np.cos(azimuth),
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=np.nan,
        )

    def at(
        self, grid: MapGrid, rows: np.ndarray, cols: np.ndarray, *marks: Marks | None
    ) -> list[np.ndarray]:
        """Marks of the profiles at cells of the grid; False beyond the fan."""
        corner = grid.west - self.eye[0], grid.north - self.eye[1]
        fan = np.array([*corner, self.cell_m, self.first, self.step])
        place = places_in_fan(rows, cols, fan, (self.ranges, self.azimuths))
        inside = place >= 0
        return [inside & mark.ravel()[place] for mark in marks if mark is not None]


def _field(view: TerrainView) -> tuple[float, float]:
    """First and last azimuth of a view, with a margin; a full circle if it includes the nadir."""
    geometry = view.geometry
    sample = np.linspace(0, geometry.samples - 1, geometry.samples // BORDER_STEP_PX + 2)
    line = np.linspace(0, geometry.lines - 1, geometry.lines // BORDER_STEP_PX + 2)
    border = np.concatenate(
        [
            *(np.column_stack([sample, np.full_like(sample, edge)]) for edge in (0, line[-1])),
            *(np.column_stack([np.full_like(line, edge), line]) for edge in (0, sample[-1])),
        ]
    )
    ahead = np.c_[(border - np.array(geometry.centre_px)) / geometry.focal_px, np.ones(len(border))]
    rays = map_from_pair_rotation(view.lsl_from_pair) @ ahead.T
    middle = map_from_pair_rotation(view.lsl_from_pair)[:, 2]
    towards = np.arctan2(middle[0], middle[1])
    off = np.mod(np.arctan2(rays[0], rays[1]) - towards + np.pi, 2 * np.pi) - np.pi
    if off.max() - off.min() > np.pi:
        return -np.pi, np.pi
    return towards + off.min() - MARGIN, towards + off.max() + MARGIN


@dataclass(frozen=True, slots=True, eq=False)
class _Profiles:
    """Known, assumed and hidden ground along the profiles of a camera."""

    fan: _Fan
    supposed: Profiles
    """Elevation above the camera: the model's, or the assumed one in gaps."""
    hidden: Marks

    @classmethod
    def of(
        cls,
        fan: _Fan,
        elevation: Raster,
        grid: MapGrid,
        beyond: _Beyond,
        of_view: tuple[TerrainView, SightParams],
    ) -> _Profiles:
        """Sample the profiles of a camera and find what it cannot see."""
        view, params = of_view
        height = fan.read(elevation, grid) - np.float32(fan.eye[2])
        supposed, hidden = hidden_along(
            height,
            fan.distance_m[:, 0],
            beyond.tangent,
            beyond.nearness,
            np.float32(LINES / view.geometry.focal_px),
            np.float32(params.min_height_m),
        )
        return cls(fan, supposed, hidden)


@dataclass(frozen=True, slots=True, eq=False)
class _Beyond:
    """The lowest ground of every azimuth that a view shows beyond its used range."""

    tangent: Azimuths
    """Infinite where there is none."""
    nearness: Azimuths
    """One over the distance."""


def _far_ground(view: TerrainView, fan: _Fan, params: SightParams) -> _Beyond:
    """Ground that a view shows beyond its reach."""
    geometry = view.geometry
    with np.errstate(invalid="ignore"):
        far = view.mask & (view.parallax < params.sigma_parallax_px / params.max_relative_sigma)
    patch = np.ones((LEAST_FAR_PX, LEAST_FAR_PX), dtype=np.uint8)
    line, sample = np.nonzero(cv2.morphologyEx(far.astype(np.uint8), cv2.MORPH_OPEN, patch))
    x = (sample - geometry.centre_px[0]) / geometry.focal_px
    y = (line - geometry.centre_px[1]) / geometry.focal_px
    rotation = map_from_pair_rotation(view.lsl_from_pair)
    east, north, up = (right * x + down * y + ahead for right, down, ahead in rotation)
    plan = np.hypot(east, north)
    turn = np.mod(np.arctan2(east, north) - fan.first, 2 * np.pi)
    column = np.minimum(np.rint(turn / fan.step).astype(np.int64), fan.azimuths - 1)
    lowest = np.full(fan.azimuths, np.inf)
    np.minimum.at(lowest, column, up / plan)
    parallax = view.parallax[line, sample]
    nearness = np.zeros(fan.azimuths)
    np.maximum.at(nearness, column, parallax / (geometry.focal_px * geometry.base_m * plan))
    return _Beyond(lowest.astype(np.float32), nearness.astype(np.float32))


def _in_field(view: TerrainView, seen: _Profiles, params: SightParams) -> Marks:
    """Whether assumed ground is in the images of both cameras, near enough to be used."""
    geometry, fan = view.geometry, seen.fan
    azimuth = (fan.first + np.arange(fan.azimuths) * fan.step).astype(np.float32)
    P = np.stack(
        [fan.distance_m * np.sin(azimuth), fan.distance_m * np.cos(azimuth), seen.supposed]
    )
    pair_from_map = map_from_pair_rotation(view.lsl_from_pair).T.astype(np.float32)
    X, Y, Z = np.einsum("ij,jrc->irc", pair_from_map, P)
    with np.errstate(invalid="ignore"):
        ahead = Z > NEAREST_M
    Z = np.where(ahead, Z, np.float32(1.0))
    sample = np.float32(geometry.centre_px[0]) + np.float32(geometry.focal_px) * X / Z
    line = np.float32(geometry.centre_px[1]) + np.float32(geometry.focal_px) * Y / Z
    parallax = np.float32(geometry.focal_px * geometry.base_m) / Z
    usable = cv2.remap(view.mask.astype(np.uint8), sample, line, cv2.INTER_NEAREST) > 0
    return (
        ahead
        & usable
        & (parallax >= params.sigma_parallax_px / params.max_relative_sigma)
        & (sample >= parallax)
    )
