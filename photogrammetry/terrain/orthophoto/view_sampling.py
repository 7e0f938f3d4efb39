"""Sampling of a view by map cells: position, quality and occlusion of each cell.

A cell of ground at P (east, north, up from the camera) with the unit normal n fills

    q = f^2 (-n.P) / |P|^3

pixels per square metre: nearness, incidence and focal length in one number. Towards the border of
the usable image q decreases to zero, so that the view with the cell nearer its middle is preferred
and no view ends abruptly.

A cell at depth Z should appear with the parallax p = f B / Z. Where the matched parallax is larger,
nearer ground hides the cell from this view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    Float32,
    Float64,
    GreyImage,
    Mask,
    ParallaxMap,
    Raster,
    Vector3,
)
from solmap.photogrammetry.terrain.dtm.ground import camera_on_map, map_from_pair_rotation
from solmap.photogrammetry.terrain.dtm.records import TerrainView

NEAREST_M = 0.05
"""Points with smaller depths are behind or inside the camera."""
LEVELS = 4
"""Levels of the image pyramid: for ground cells up to eight pixels wide."""
FADE_FROM_PX = 4.0
"""Distance from unusable pixels at which fading starts: the reach of the second pyramid level."""

HIDDEN_PX = 1.0
"""Excess of a matched parallax over the expected one from which the ground counts as hidden: four
standard deviations of a dense parallax."""
COARSER = 4
"""Step, in pixels, of the distance to unusable pixels."""
GRAZING = np.float32(0.02)
"""Least sine of the angle at which ground counts as visible: ground that faces away by a degree or
two may do so by the noise of its elevation. Hidden ground is detected by the parallax."""

Pyramid = tuple[np.ndarray, ...]
"""A band of an image at full size, half the size, and so on."""


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedCells:
    """The cells of a piece of map in a view."""

    sample: Raster
    line: Raster
    density: Raster
    """Pixels per square metre of ground; 0 where not visible."""
    worth: Raster
    """The density, reduced towards the border of the image; 0 where hidden or not visible."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewSampler:
    """A view prepared for sampling by map cells."""

    camera: Vector3
    pair_from_map: Float32[np.ndarray, "3 3"]
    focal_px: float
    base_m: float
    centre_px: tuple[float, float]
    sides: Float64[np.ndarray, "5 3"]
    """Outward normals (east, north, up) of the planes around the field of view."""
    bands: tuple[Pyramid, ...]
    """The images to sample: the view's own, those through several filters, or none."""
    fade: Float32[np.ndarray, "coarse_lines coarse_samples"]
    parallax: ParallaxMap
    """Matched parallax; NaN where there is none."""
    gains: Float32[np.ndarray, "bands 2"]
    """Factor and offset of the brightness of every band."""

    @classmethod
    def of(cls, view: TerrainView, bands: Sequence[GreyImage]) -> ViewSampler:
        """Prepare a view, with its own image, or others in the same geometry, or none."""
        rotation = map_from_pair_rotation(view.lsl_from_pair)
        return cls(
            camera=camera_on_map(view.lsl_from_pair),
            pair_from_map=rotation.T.astype(np.float32),
            focal_px=view.geometry.focal_px,
            base_m=view.geometry.base_m,
            centre_px=view.geometry.centre_px,
            sides=_sides(view) @ rotation.T,
            bands=tuple(masked_pyramid(band, view.mask) for band in bands),
            fade=border_fade(view.mask),
            parallax=view.parallax,
            gains=np.tile(np.array([1, 0], np.float32), (len(bands), 1)),
        )

    def with_gains(self, gains: Float64[np.ndarray, "bands 2"]) -> ViewSampler:
        """The view with another brightness: factor and offset of each of its bands."""
        return replace(self, gains=gains.astype(np.float32))

    def may_show(self, middle: Vector3, radius_m: float) -> bool:
        """Whether the field of view may reach into a sphere (east, north, up)."""
        beyond = self.sides @ (middle - self.camera)
        return bool(beyond.max() <= radius_m)

    def project(
        self,
        ground: Float32[np.ndarray, "3 rows cols"],
        normal: Float32[np.ndarray, "3 rows cols"],
        cell_m: float,
    ) -> ProjectedCells:
        """The cells at `ground` (east, north, up from this camera) in this view.

        A cell counts as hidden if the parallax exceeds the expected one by more than `HIDDEN_PX`
        and the effect of the cell's own depth, p cell / Z.
        """
        turned = self.pair_from_map @ ground.reshape(3, -1)
        X, Y, Z = turned.reshape(ground.shape)
        nearness = 1 / np.maximum(Z, np.float32(NEAREST_M))
        enlarged = np.float32(self.focal_px) * nearness
        sample = X * enlarged + np.float32(self.centre_px[0])
        line = Y * enlarged + np.float32(self.centre_px[1])
        parallax = enlarged * np.float32(self.base_m)
        farthest = parallax * (1 + np.float32(cell_m) * nearness) + np.float32(HIDDEN_PX)
        hidden = sample_image(self.parallax, sample, line, cv2.INTER_NEAREST) > farthest
        square = ground[0] ** 2 + ground[1] ** 2 + ground[2] ** 2
        facing = -(ground[0] * normal[0] + ground[1] * normal[1] + ground[2] * normal[2])
        fade = sample_image(self.fade, *coarse_points(sample, line), cv2.INTER_LINEAR)
        shown = (np.float32(NEAREST_M) < Z) & (fade > 0)
        facing = np.maximum(facing, GRAZING * np.sqrt(square))
        density = np.float32(self.focal_px**2) * facing / (square * np.sqrt(square))
        density = np.where(shown, density, np.float32(0))
        return ProjectedCells(
            sample, line, density, np.where(hidden, np.float32(0), density * fade)
        )

    def brightness(
        self, sample: Raster, line: Raster, level: Raster | None, band: int = 0
    ) -> Raster:
        """Grey values at image points, averaged over 2^level pixels, or over none."""
        pyramid, (gain, offset) = self.bands[band], self.gains[band]
        if level is None:
            return sample_image(pyramid[0], sample, line, cv2.INTER_LINEAR) * gain + offset
        level = np.clip(level, 0, LEVELS - 1)
        grey = np.zeros_like(sample)
        for number in range(int(level.min()), int(np.ceil(level.max())) + 1):
            share = np.maximum(0, 1 - np.abs(level - np.float32(number)))
            scale = np.float32(0.5**number)
            values = sample_image(pyramid[number], sample * scale, line * scale, cv2.INTER_LINEAR)
            cv2.accumulateProduct(values, share, grey)
        return grey * gain + offset


def _sides(view: TerrainView) -> Float64[np.ndarray, "5 3"]:
    """Outward unit normals of the field of view: behind, left, right, above, below."""
    lines, samples = view.mask.shape
    f = view.geometry.focal_px
    left, top = (-0.5 - c for c in view.geometry.centre_px)
    right, bottom = left + samples, top + lines
    normals = np.array([[0, 0, -f], [-f, 0, left], [f, 0, -right], [0, -f, top], [0, f, -bottom]])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def border_fade(mask: Mask) -> Float32[np.ndarray, "coarse_lines coarse_samples"]:
    """Distance from unusable pixels over half the image, in pixels `COARSER` times as wide."""
    lines, samples = (size // COARSER for size in mask.shape)
    whole = mask[: lines * COARSER, : samples * COARSER]
    usable = whole.reshape(lines, COARSER, samples, COARSER).all(axis=(1, 3))
    padded = np.pad(usable.astype(np.uint8), 1)
    inside = cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1] * COARSER - COARSER / 2
    half = min(mask.shape) / 2
    return (np.clip(inside - FADE_FROM_PX, 0, half) / half).astype(np.float32)


def coarse_points(sample: Raster, line: Raster) -> tuple[Raster, Raster]:
    """Image points in an image with pixels `COARSER` times as wide."""
    scale, shift = np.float32(1 / COARSER), np.float32(0.5 / COARSER - 0.5)
    return sample * scale + shift, line * scale + shift


def masked_pyramid(image: GreyImage, mask: Mask) -> Pyramid:
    """The image at every level; unusable pixels have its mean, because they are never shown."""
    level = cv2.mean(image, mask.astype(np.uint8))[0]
    pyramid = [image if mask.all() else np.where(mask, image, np.float32(level))]
    while len(pyramid) < LEVELS:
        pyramid.append(cv2.pyrDown(pyramid[-1]))
    return tuple(pyramid)


def sample_image(
    image: Float32[np.ndarray, "lines samples"], sample: Raster, line: Raster, how: int
) -> Raster:
    """The image at these points; 0 outside."""
    return cv2.remap(image, sample, line, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
