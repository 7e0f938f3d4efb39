"""The rover itself: boxes that are visible to its cameras and cast a shadow on the ground.

The boxes are given in the rover frame (x forward, y right, z down) and have the size of a Mars
Exploration Rover, 1.6 m long and 2.3 m wide over its solar panels, which are 0.6 m above the
ground. A ray x = c + t d enters a box where it enters the last of its three slabs,

    t_in = max over axes of min((low - c) / d, (high - c) / d),

if that is before it leaves the first one, and not behind c. The first box entered is visible; a
point is in the rover's shadow if its ray to the sun enters any box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Vector3

CELL_M = (0.04, 0.07)
"""Solar cells, along and across the rover, with a bright line between."""
LINE_M = 0.004
ANTENNA_ALBEDO, CELL_ALBEDO, LINE_ALBEDO = 0.9, 0.35, 0.8
"""Albedo relative to the soil's: panels are dark and dusty."""
PANEL_TOP_M = -0.306

Vectors = Float32[np.ndarray, "n 3"]
PerRay = Float32[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class Box:
    """A part of the rover, by its least and largest x, y, z in the rover frame."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


BODY = (
    Box((-0.60, -0.45, PANEL_TOP_M), (0.55, 0.45, -0.05)),  # deck and body
    Box((-0.90, -0.35, PANEL_TOP_M), (-0.60, 0.35, PANEL_TOP_M + 0.03)),  # panel at the back
    Box((-0.60, -1.15, PANEL_TOP_M), (0.25, -0.45, PANEL_TOP_M + 0.03)),  # panels at the sides
    Box((-0.60, 0.45, PANEL_TOP_M), (0.25, 1.15, PANEL_TOP_M + 0.03)),
    Box((-0.28, 0.28, -0.80), (-0.24, 0.32, PANEL_TOP_M)),  # low-gain antenna
    Box((-0.42, -0.38, -0.78), (-0.38, -0.10, -0.50)),  # high-gain antenna and its mast
    Box((-0.41, -0.26, -0.50), (-0.37, -0.22, PANEL_TOP_M)),
)
"""Parts visible to the cameras."""
MAST = (
    Box((0.42, -0.01, -1.10), (0.50, 0.07, PANEL_TOP_M)),
    Box((0.38, -0.15, -1.32), (0.54, 0.21, -1.20)),  # bar of the stereo cameras
)
"""Parts that carry the cameras and only cast shadows."""


def entered(
    origin: Vector3 | Vectors, rays: Vectors, boxes: tuple[Box, ...] = BODY
) -> tuple[PerRay, Vectors]:
    """(distance, normal): first intersections of unit rays with boxes, and the sides entered.

    The distance of a ray that misses all boxes is infinite.
    """
    nearest = np.full(len(rays), np.inf, np.float32)
    normals = np.zeros((len(rays), 3), np.float32)
    start = np.asarray(origin, np.float32)
    inverse = 1 / np.where(np.abs(rays) < 1e-9, np.float32(1e-9), rays)  # noqa: PLR2004
    for box in boxes:
        one = (np.array(box.low, np.float32) - start) * inverse
        other = (np.array(box.high, np.float32) - start) * inverse
        enters, leaves = np.minimum(one, other), np.maximum(one, other)
        first = enters.max(axis=1)
        hit = (first < leaves.min(axis=1)) & (first > 0) & (first < nearest)
        nearest[hit] = first[hit]
        axis = enters[hit].argmax(axis=1)
        normals[hit] = 0
        normals[hit, axis] = -np.sign(rays[hit, axis])
    return nearest, normals


def body_radiance(points: Vectors, normals: Vectors, sun: Vector3, sky_light: float) -> PerRay:
    """Radiance of points on the rover, lit as the ground is; `sun` is a direction in its frame."""
    towards = np.tile(sun.astype(np.float32), (len(points), 1))
    lit = np.isinf(entered(points + 1e-3 * normals, towards, BODY + MAST)[0])
    light = np.maximum(normals @ sun.astype(np.float32), 0) * lit
    light += sky_light * (1 - normals[:, 2]) / 2
    on_line = (np.mod(points[:, :2], CELL_M) < LINE_M).any(axis=1)
    cell = np.floor(points[:, :2] / CELL_M)
    uneven = 1 + 0.1 * np.sin(12.9898 * cell[:, 0] + 78.233 * cell[:, 1])
    albedo = np.where(on_line, LINE_ALBEDO, CELL_ALBEDO * uneven)
    is_panel = np.abs(points[:, 2] - PANEL_TOP_M) < 1e-3  # noqa: PLR2004 - a millimetre
    return (np.where(is_panel, albedo, ANTENNA_ALBEDO) * light).astype(np.float32)
