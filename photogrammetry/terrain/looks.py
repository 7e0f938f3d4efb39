"""One view looked at from the map: where it shows a cell, how well, and whether something hides it.

A cell of ground at P (east, north, up from the camera) with the unit normal n fills

    q = f^2 (-n.P) / |P|^3

pixels a square metre: nearness, incidence and focal length in one number. Towards the border of the
usable image q is faded to nothing, so that of two views the one that shows the cell nearer its
middle is preferred and no view ends abruptly.

A cell at depth Z should appear with the parallax p = f B / Z. Where the matched parallax is larger,
something nearer stands in front and the cell is hidden from this view.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from photogrammetry.arrays import Float32, GreyImage, Raster, Vector3
from photogrammetry.terrain.ground import camera_on_map, map_from_pair_rotation
from photogrammetry.terrain.records import TerrainView

NEAREST_M = 0.05
"""Depths below this are behind or inside the camera."""
LEVELS = 4
"""Levels of the image pyramid: ground that is up to eight pixels a cell wide."""
FADE_FROM_PX = 4.0
"""Distance from unusable pixels at which fading starts: the reach of the second pyramid level."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """How a view shows the cells of a piece of map."""

    sample: Raster
    line: Raster
    density: Raster
    """Pixels a square metre of ground; 0 where not shown."""
    worth: Raster
    """The density, faded towards the border of the image; 0 where hidden or not shown."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A view prepared for being looked at from the map."""

    camera: Vector3
    pair_from_map: Float32[np.ndarray, "3 3"]
    focal_px: float
    base_m: float
    centre_px: tuple[float, float]
    pyramid: tuple[np.ndarray, ...]
    """The image, and the image at half the size, again and again."""
    fade: GreyImage
    nearest: GreyImage
    """Matched parallax, 0 where there is none."""

    @classmethod
    def of(cls, view: TerrainView) -> Look:
        """Prepare a view."""
        usable = np.pad(view.mask.astype(np.uint8), 1)
        inside = cv2.distanceTransform(usable, cv2.DIST_L2, 3)[1:-1, 1:-1]
        level = float(np.median(view.image[view.mask])) if view.mask.any() else 0.0
        pyramid = [np.where(view.mask, view.image, np.float32(level))]
        while len(pyramid) < LEVELS:
            pyramid.append(cv2.pyrDown(pyramid[-1]))
        half = min(view.mask.shape) / 2
        return cls(
            camera=camera_on_map(view.lsl_from_pair),
            pair_from_map=map_from_pair_rotation(view.lsl_from_pair).T.astype(np.float32),
            focal_px=view.geometry.focal_px,
            base_m=view.geometry.base_m,
            centre_px=view.geometry.centre_px,
            pyramid=tuple(pyramid),
            fade=(np.clip(inside - FADE_FROM_PX, 0, half) / half).astype(np.float32),
            nearest=np.where(np.isfinite(view.parallax), view.parallax, 0).astype(np.float32),
        )

    def sight(
        self,
        ground: Float32[np.ndarray, "3 rows cols"],
        normal: Float32[np.ndarray, "3 rows cols"],
        tolerance_px: float,
        cell_m: float,
    ) -> Sight:
        """How this view shows cells at `ground` (east, north, up from this camera).

        The parallax may exceed the expected one by the tolerance and by what a cell's own depth
        makes, p cell / Z, before the cell counts as hidden.
        """
        X, Y, Z = np.einsum("ij,jrc->irc", self.pair_from_map, ground)
        ahead = NEAREST_M < Z
        Z = np.maximum(Z, np.float32(NEAREST_M))
        sample = np.float32(self.centre_px[0]) + np.float32(self.focal_px) * X / Z
        line = np.float32(self.centre_px[1]) + np.float32(self.focal_px) * Y / Z
        parallax = np.float32(self.focal_px * self.base_m) / Z
        matched = _sampled(self.nearest, sample, line, cv2.INTER_NEAREST)
        hidden = matched > parallax * (1 + np.float32(cell_m) / Z) + np.float32(tolerance_px)
        distance = np.sqrt(np.einsum("irc,irc->rc", ground, ground))
        facing = np.maximum(-np.einsum("irc,irc->rc", ground, normal), 0)
        density = np.float32(self.focal_px**2) * facing / distance**3
        fade = _sampled(self.fade, sample, line, cv2.INTER_LINEAR)
        shown = ahead & (fade > 0)
        density = np.where(shown, density, np.float32(0))
        return Sight(sample, line, density, np.where(hidden, np.float32(0), density * fade))

    def brightness(self, sample: Raster, line: Raster, level: Raster) -> Raster:
        """Grey values at image points, averaged over 2^level pixels."""
        level = np.clip(level, 0, LEVELS - 1)
        coarsest = int(np.ceil(level.max(initial=0)))
        grey = np.zeros_like(sample)
        for number in range(coarsest + 1):
            share = np.maximum(0, 1 - np.abs(level - np.float32(number)))
            if share.any():
                scale = np.float32(0.5**number)
                image = self.pyramid[number]
                grey += share * _sampled(image, sample * scale, line * scale, cv2.INTER_LINEAR)
        return grey


def _sampled(image: GreyImage, sample: Raster, line: Raster, how: int) -> Raster:
    """The image at these points; 0 outside."""
    return cv2.remap(image, sample, line, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
