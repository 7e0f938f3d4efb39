"""An image of a panorama: looked up by the direction of what it shows.

Its camera is carried into the LSL with its adjusted orientation. Image coordinates are found at
nodes, every `NODE` pixels of the panorama, and interpolated between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float64, GreyImage, Mask, ObjectPoints, Raster, Vector3
from solmap.photogrammetry.cameras.epipolar import border_points
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.terrain.angle_grid import NODE, Span, span_of_rays
from solmap.photogrammetry.terrain.looks import (
    LEVELS,
    Pyramid,
    coarser,
    fade_of,
    looked_up,
    pyramid_of,
)

BEYOND = 1.02
"""How far off its axis a camera is asked, over the corner of its image: models fold back beyond."""
NOWHERE_PX = -1e6


@dataclass(frozen=True, slots=True, eq=False)
class PanoramaImage:
    """An image with its camera in the LSL, prepared for being looked up by direction."""

    id: str
    camera: CameraModel
    size: tuple[int, int]
    """(samples, lines)."""
    pyramid: Pyramid
    fade: GreyImage
    axis: Vector3
    cos_reach: float
    """Cosine of the angle from the axis to the farthest corner, a little enlarged."""
    pixel_deg: float

    @classmethod
    def of(
        cls, image_id: str, camera_in_lsl: CameraModel, image: GreyImage, mask: Mask
    ) -> PanoramaImage:
        """Prepare an image; `camera_in_lsl` is oriented as adjusted."""
        lines, samples = image.shape
        middle = np.array([[(samples - 1) / 2, (lines - 1) / 2]])
        ahead = camera_in_lsl.rays(middle)[0]
        beside = camera_in_lsl.rays(middle + np.array([1.0, 0.0]))[0]
        corners = camera_in_lsl.rays(border_points((samples, lines))) @ ahead
        reach = BEYOND * math.acos(float(np.clip(corners.min(), -1.0, 1.0)))
        return cls(
            id=image_id,
            camera=camera_in_lsl,
            size=(samples, lines),
            pyramid=pyramid_of(image.astype(np.float32), mask),
            fade=fade_of(mask),
            axis=ahead,
            cos_reach=math.cos(min(reach, math.pi)),
            pixel_deg=math.degrees(math.acos(float(np.clip(ahead @ beside, -1.0, 1.0)))),
        )

    @property
    def span(self) -> tuple[Span, Span]:
        """Azimuths and elevations of what it shows, degrees."""
        rays = self.camera.rays(border_points(self.size))
        return span_of_rays(rays, self.axis)

    def balanced(self, gain: float, offset: float) -> PanoramaImage:
        """The image with another brightness."""
        levels = (level * np.float32(gain) + np.float32(offset) for level in self.pyramid)
        return replace(self, pyramid=tuple(levels))

    def points(self, ground: ObjectPoints) -> Float64[np.ndarray, "n 2"]:
        """Image points of places in the LSL; far off the image where it does not show them."""
        away = ground - self.camera.centre
        ahead = away @ self.axis > self.cos_reach * np.linalg.norm(away, axis=1)
        found = np.full((len(ground), 2), NOWHERE_PX)
        if ahead.any():
            found[ahead] = np.nan_to_num(self.camera.project(ground[ahead]), nan=NOWHERE_PX)
        return found

    def lattice(self, places: Float64[np.ndarray, "down across 3"]) -> tuple[Raster, Raster]:
        """Sample and line of a lattice of places in the LSL."""
        points = self.points(places.reshape(-1, 3)).astype(np.float32)
        sample, line = points.T.reshape(2, *places.shape[:2])
        return sample, line

    def drawn(self, sample: Raster, line: Raster, pixel_deg: float) -> tuple[Raster, Raster]:
        """Brightness and fade at image points, for a picture with pixels that wide."""
        level = round(math.log2(max(1.0, pixel_deg / self.pixel_deg)))
        level = min(level, LEVELS - 1)
        scale = np.float32(0.5**level)
        grey = looked_up(self.pyramid[level], sample * scale, line * scale, cv2.INTER_LINEAR)
        return grey, looked_up(self.fade, *coarser(sample, line), cv2.INTER_LINEAR)


def enlarged(
    image: PanoramaImage, places: np.ndarray, shape: tuple[int, int]
) -> tuple[Raster, Raster] | None:
    """Sample and line at every pixel of a block, from those at its nodes; None: not in the image.

    Args:
        image: The image to look at.
        places: (down, across, 3) of the ground at the nodes and one beyond each way, LSL.
        shape: Rows and columns of the block.
    """
    sample, line = image.lattice(places)
    samples, lines = image.size
    near = NODE * NODE
    within = (sample > -near) & (sample < samples + near) & (line > -near) & (line < lines + near)
    if not within.any():
        return None
    turn = np.array([[1 / NODE, 0, 0], [0, 1 / NODE, 0]], np.float32)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = shape[::-1]
    return cv2.warpAffine(sample, turn, size, flags=flags), cv2.warpAffine(
        line, turn, size, flags=flags
    )
