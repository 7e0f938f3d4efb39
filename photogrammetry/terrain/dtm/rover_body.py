"""Pixels that show the rover itself, by the camera positions in its labels.

The body is a box in the rover frame (forward, right, down). A pixel shows the rover if its matched
point is in the box, and, for a camera on a mast above it, also if its ray enters the box. Cameras
below or at the deck are inside the box, so for them only points in it (wheels, an arm) count as
hardware.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Mask, Vector3
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.kernels import pixels_in_box

MAST_M = 0.4
"""Cameras at least this far above the deck are on the mast; those of Spirit are 0.9 m above it."""
STEP_PX = 8
"""Step in pixels between cast rays: the box is no more accurate than that."""


@dataclass(frozen=True, slots=True)
class RoverBody:
    """A box around deck, wheels and stowed arm, in the rover frame, metres."""

    back_m: float
    front_m: float
    half_width_m: float
    deck_m: float
    """Height of the deck above the ground; the mast with the cameras is above it."""
    ground_m: float = 0.0
    """Height at which the wheels touch level ground, below the origin of the frame."""
    least_height_m: float = 0.1
    """Tolerance above that ground, which may be soft or rough."""

    @property
    def corners(self) -> tuple[Vector3, Vector3]:
        """Least and largest (forward, right, down)."""
        return (
            np.array([-self.back_m, -self.half_width_m, self.ground_m - self.deck_m]),
            np.array([self.front_m, self.half_width_m, self.ground_m - self.least_height_m]),
        )


BODIES = {
    "MER1": RoverBody(0.9, 0.8, 1.15, 0.6, ground_m=0.294),
    "MER2": RoverBody(0.9, 0.8, 1.15, 0.6, ground_m=0.294),
    "MSL": RoverBody(1.6, 1.4, 1.4, 1.1),
    "M20": RoverBody(1.6, 1.4, 1.35, 1.1),
}
"""Dimensions of rovers from the fact sheets: Spirit and Opportunity 1.6 m long and 2.3 m wide over
their panels; Curiosity and Perseverance 3 m long and 2.7 to 2.8 m wide. The origin of the first two
lies between the axles of the middle wheels, 0.294 m above level ground (VICAR)."""


def mask_rover(view: TerrainView, mission: str) -> TerrainView:
    """The view with the pixels of its own rover masked; unchanged for an unknown rover."""
    body = BODIES.get(mission)
    if body is None:
        return view
    shown = _points_inside(view, body) | _rays_through(view, body)
    return replace(view, mask=view.mask & ~shown) if shown.any() else view


def _points_inside(view: TerrainView, body: RoverBody) -> Mask:
    """Pixels whose matched points are in the box."""
    geometry = view.geometry
    lines, samples = view.parallax.shape
    across = (np.arange(samples) - geometry.centre_px[0]) / geometry.focal_px
    down = (np.arange(lines) - geometry.centre_px[1]) / geometry.focal_px
    pose = geometry.rover_from_pair
    return pixels_in_box(
        view.parallax,
        np.column_stack([pose.rotation, pose.translation_m]),
        np.stack(body.corners),
        across,
        down,
        np.float32(geometry.focal_px * geometry.base_m),
    )


def _rays_through(view: TerrainView, body: RoverBody) -> Mask:
    """Pixels of a mast camera whose rays enter the box."""
    geometry, shape = view.geometry, view.parallax.shape
    pose, (low, high) = geometry.rover_from_pair, body.corners
    if pose.translation_m[2] > low[2] - MAST_M:
        return np.zeros(shape, dtype=np.bool_)
    line, sample = np.mgrid[: shape[0] : STEP_PX, : shape[1] : STEP_PX]
    x = (sample - geometry.centre_px[0]) / geometry.focal_px
    y = (line - geometry.centre_px[1]) / geometry.focal_px
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ pose.rotation.T
    with np.errstate(divide="ignore"):
        sides = np.stack([low, high])[:, None, None] - pose.translation_m
        meets = sides / np.where(rays == 0, 1e-12, rays)
    enters, leaves = meets.min(axis=0).max(axis=-1), meets.max(axis=0).min(axis=-1)
    through = ((enters < leaves) & (enters > 0)).astype(np.uint8)
    return cv2.resize(through, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.bool_)
