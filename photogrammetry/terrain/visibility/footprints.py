"""Footprints of images on the map, and their pointing.

Rays through the border of the image intersect the ground at

    P = C + t d,    t = (h - C_up) / d_up,    d_up < 0

with h the ground's elevation. A ray that intersects it too far away, or points above the horizon,
is cut off at the largest range in its own azimuth, so that a frame with sky in it extends to the
largest range. Over a terrain model the ray is followed until it first passes below the terrain;
where the model is unknown, a plane is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Directions, Flags, Float64, ImagePoints, PerPoint, Vector3
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.frames import FrameKind, Pose
from solmap.photogrammetry.ranges import Metres
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.records import Dtm

Outline = Float64[np.ndarray, "corners 2"]
"""(east, north) in metres; a closed ring repeats its first point."""
SIDE_POINTS = 16
"""Rays along a side of the image: lens distortion and the horizon bend it."""
LEAST_SIDE_M = 1e-3
"""Points of an outline closer than this are merged."""
STEPS = 1000
"""Steps along a ray over terrain: some centimetres each, and straight in between."""


@dataclass(frozen=True, slots=True)
class FootprintParams:
    """Range of footprints and pointing lines."""

    max_range_m: Metres = 40.0
    """Navcam stereo is worse than a metre in range beyond; lines to the horizon are cut here."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The ground for footprints: a plane, and a terrain model where available."""

    elevation_m: float
    dtm: Dtm | None = None

    def elevations(
        self, plan: Float64[np.ndarray, "rays steps 2"]
    ) -> Float64[np.ndarray, "rays steps"]:
        """Elevation at (east, north); that of the plane where the model is unknown."""
        plane = np.full(plan.shape[:2], self.elevation_m)
        if self.dtm is None:
            return plane
        grid = self.dtm.grid
        col = ((plan[..., 0] - grid.west) / grid.cell_m - 0.5).astype(np.float32)
        row = ((grid.north - plan[..., 1]) / grid.cell_m - 0.5).astype(np.float32)
        known = cv2.remap(self.dtm.elevation, col, row, cv2.INTER_LINEAR, borderValue=float("nan"))
        return np.where(np.isfinite(known), known, plane)


def footprint(
    camera: CameraModel,
    size: tuple[int, int],
    lsl_from_rover: Pose,
    ground: Ground,
    max_range_m: float,
) -> Outline:
    """Outline on the map of the ground in an image of (samples, lines).

    Empty where the image shows only sky.
    """
    return _outline(_rays(camera, _border(size), lsl_from_rover), ground, max_range_m)


def pointing_line(
    camera: CameraModel,
    size: tuple[int, int],
    lsl_from_rover: Pose,
    ground: Ground,
    max_range_m: float,
) -> Outline:
    """Line from the camera to the ground in the middle of the image, two points on the map.

    The line has its largest length where the middle shows sky or ground beyond it.
    """
    samples, lines = size
    middle = np.array([[(samples - 1) / 2, (lines - 1) / 2]])
    centre, rays = _rays(camera, middle, lsl_from_rover)
    reached, _ = _on_ground(centre, rays, ground, max_range_m)
    return np.vstack([centre[None, :2], reached])


def _outline(rays: tuple[Vector3, Directions], ground: Ground, max_range_m: float) -> Outline:
    reached, met = _on_ground(*rays, ground, max_range_m)
    if not met.any():
        return np.empty((0, 2))
    first = int(np.argmax(met))
    ring = _sweep(np.roll(reached, -first, axis=0), np.roll(met, -first), rays[0][:2])
    apart = np.hypot(*(ring - np.roll(ring, 1, axis=0)).T) > LEAST_SIDE_M
    return np.vstack([ring[apart], ring[apart][:1]])


def _sweep(ring: Outline, met: Flags, centre: Float64[np.ndarray, " 2"]) -> Outline:
    """The outline with each stretch at the largest range ordered by azimuth.

    The sides of an image continue above the horizon with other azimuths than where they cross it,
    so the order of cut-off points may reverse; the first point of the ring is not cut off.
    """
    ring = ring.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], met, [True]]).astype(np.int8)))
    for start, end in edges.reshape(-1, 2):
        east, north = (ring[start:end] - centre).T
        middle = np.arctan2(east.sum(), north.sum())
        azimuth = (np.arctan2(east, north) - middle + np.pi) % (2 * np.pi)
        order = np.argsort(azimuth)
        ring[start:end] = ring[start:end][order if azimuth[-1] >= azimuth[0] else order[::-1]]
    return ring


def _border(size: tuple[int, int]) -> ImagePoints:
    """Points around the outer edge of an image, clockwise."""
    samples, lines = size
    left, top, right, bottom = -0.5, -0.5, samples - 0.5, lines - 0.5
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    steps = np.arange(SIDE_POINTS)[:, None] / SIDE_POINTS
    sides = [a + steps * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    return np.vstack(sides)


def _rays(
    camera: CameraModel, image_points: ImagePoints, lsl_from_rover: Pose
) -> tuple[Vector3, Directions]:
    """Centre and rays of a camera, as (east, north, up)."""
    if lsl_from_rover.target.kind is not FrameKind.LSL:
        raise TerrainError(f"a footprint is on the map of the LSL, not of {lsl_from_rover.target}")
    centre = lsl_from_rover.apply(camera.centre[None])[0]
    rays = lsl_from_rover.turn(camera.rays(image_points))
    return MAP_FROM_LSL @ centre, rays @ MAP_FROM_LSL.T


def _on_ground(
    centre: Vector3, rays: Directions, ground: Ground, max_range_m: float
) -> tuple[Outline, Flags]:
    """Where rays meet the ground, cut off at the largest range; and which met it before."""
    plan_length = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-12)
    azimuth = rays[:, :2] / plan_length[:, None]
    dip = -rays[:, 2] / plan_length
    if ground.dtm is None:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            distance = (centre[2] - ground.elevation_m) / dip
        met = (dip > 0) & (distance >= 0) & (distance <= max_range_m)
    else:
        distance, met = _walk_rays(centre, azimuth, dip, ground, max_range_m)
    return centre[:2] + azimuth * np.where(met, distance, max_range_m)[:, None], met


def _walk_rays(
    centre: Vector3,
    azimuth: Float64[np.ndarray, "n 2"],
    dip: PerPoint,
    ground: Ground,
    max_range_m: float,
) -> tuple[PerPoint, Flags]:
    """Distance at which rays first pass below the ground, and which do."""
    steps = np.linspace(0.0, max_range_m, STEPS)
    plan = centre[:2] + azimuth[:, None, :] * steps[:, None]
    height = centre[2] - dip[:, None] * steps - ground.elevations(plan)
    below = height <= 0
    after = np.maximum(1, np.argmax(below, axis=1))
    ray = np.arange(len(dip))
    over, under = height[ray, after - 1], height[ray, after]
    share = np.clip(over / np.where(over > under, over - under, 1.0), 0, 1)
    return steps[after - 1] + share * steps[1], below.any(axis=1)
