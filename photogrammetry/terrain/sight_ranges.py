"""How far the ground is in every direction from one place: what a panorama is drawn on.

Along each azimuth the terrain is read at distances r that grow by a hundredth. The ground that is
seen at elevation angle e is the first that reaches it,

    r(e) = min { r : max over r' <= r of atan((z(r') - z_0) / r') >= e }.

Where the terrain model has gaps, its height over the plane that the rover stands on is carried
across them; before its first and beyond its last known cell it goes on as it is there, level from
`LEVEL_M` on. What nothing reaches is the sky, as far away as makes no parallax.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Bool, Float64, Vector3
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import bilinear

NEAREST_M, FARTHEST_M = 0.3, 300.0
GROWTH = 1.01
LEVEL_M = 20.0
"""Beyond that from the rover its own tilt says nothing of the ground."""
SKY_M = 10_000.0


@dataclass(frozen=True, slots=True, eq=False)
class StandingPlane:
    """The plane that a rover stands on, in the local map (east, north, up), metres."""

    point: Vector3
    normal: Vector3

    def under(
        self, east: Float64[np.ndarray, "n m"], north: Float64[np.ndarray, "n m"]
    ) -> Float64[np.ndarray, "n m"]:
        """Its elevation at places; level beyond `LEVEL_M` from its point."""
        across, along = east - self.point[0], north - self.point[1]
        shrink = np.minimum(1.0, LEVEL_M / np.maximum(np.hypot(across, along), 1e-9))
        a, b, c = self.normal
        return self.point[2] - shrink * (a * across + b * along) / c


@dataclass(frozen=True, slots=True, eq=False)
class SightRanges:
    """Distances to the ground by direction."""

    range_m: Float64[np.ndarray, "down across"]
    is_measured: Bool[np.ndarray, "down across"]
    """Whether the terrain model knows the ground there."""


def sight_ranges(
    centre: Vector3,
    azimuths_deg: Float64[np.ndarray, " across"],
    elevations_deg: Float64[np.ndarray, " down"],
    plane: StandingPlane,
    dtm: Dtm | None = None,
) -> SightRanges:
    """How far the ground is from `centre` (east, north, up); elevations fall from row to row."""
    count = int(np.log(FARTHEST_M / NEAREST_M) / np.log(GROWTH)) + 1
    r = NEAREST_M * GROWTH ** np.arange(count)
    turn = np.radians(azimuths_deg)[:, None]
    east, north = centre[0] + r * np.sin(turn), centre[1] + r * np.cos(turn)
    ground = plane.under(east, north)
    known = np.zeros(ground.shape, dtype=np.bool_)
    if dtm is not None:
        places = np.column_stack([east.ravel(), north.ravel()])
        height = bilinear(dtm.elevation, dtm.grid, places).reshape(ground.shape) - ground
        known = np.isfinite(height)
        ground = ground + _carried(height, r)
    angle = np.arctan2(ground - centre[2], r)
    wanted = np.radians(elevations_deg)
    ranges = np.empty((len(wanted), len(turn)))
    measured = np.zeros(ranges.shape, dtype=np.bool_)
    for column, profile in enumerate(angle):
        ranges[:, column], at = _first_hits(profile, r, wanted)
        measured[:, column] = known[column][np.clip(at, 0, count - 1)] & (at > 0) & (at < count)
    return SightRanges(ranges, measured)


def _carried(height: Float64[np.ndarray, "n m"], r: Float64[np.ndarray, " m"]) -> np.ndarray:
    """Heights over the plane with gaps bridged along each row; 0 in rows that know nothing."""
    filled = np.zeros(height.shape)
    for row, values in enumerate(height):
        known = np.isfinite(values)
        if known.any():
            filled[row] = np.interp(r, r[known], values[known])
    return filled


def _first_hits(
    profile: Float64[np.ndarray, " m"],
    r: Float64[np.ndarray, " m"],
    wanted: Float64[np.ndarray, " down"],
) -> tuple[Float64[np.ndarray, " down"], np.ndarray]:
    """Distances at which a profile first reaches elevation angles, and at which step."""
    reached = np.maximum.accumulate(profile)
    at = np.searchsorted(reached, wanted, side="left")
    after = np.clip(at, 1, len(r) - 1)
    low, high = reached[after - 1], profile[after]
    share = np.clip((wanted - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    found = r[after - 1] + share * (r[after] - r[after - 1])
    found = found / np.maximum(np.cos(wanted), 1e-9)
    below = r[0] * np.tan(profile[0]) / np.minimum(np.sin(wanted), -1e-9)  # nearer than the first
    found = np.where(at == 0, np.abs(below), found)
    return np.where(at == len(r), SKY_M, found), at
