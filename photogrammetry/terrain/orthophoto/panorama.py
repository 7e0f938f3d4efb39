"""The panorama: a levelled mosaic of a stop's images in azimuth and elevation.

The images of a mast have different projection centres: the head moves a camera by some decimetres.
Every direction from the panorama's centre, the mean of the projection centres, is therefore
projected to the ground visible there (`ground_ranges`) and from it into the images by their camera
models and adjusted orientations; the sky is at infinity. Image coordinates are computed at nodes,
every `NODE` pixels of the panorama, and interpolated between them. Where several images show a
direction, each has the weight

    w = (fade d^2)^k,     d = finest pixel / own pixel,

by its distance to the border of the image (`view_sampling.border_fade`) and its resolution, so that
transitions are some ten pixels wide: no visible seams and no double images. Brightness is balanced
as for the orthophoto (`brightness.balance`). Every image is sampled at the level of its pyramid
that is as coarse as the panorama.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float64, GreyImage, Mask, ObjectPoints, Raster, Vector3
from solmap.photogrammetry.cameras.epipolar import border_points
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.ranges import PanoramaPixel, WholePixels
from solmap.photogrammetry.stretching import black_and_white
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.orthophoto.brightness import balance
from solmap.photogrammetry.terrain.orthophoto.mosaic import NO_SOURCE, SHARPNESS, Sources
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import (
    NODE,
    AngleGrid,
    GroundRanges,
    Span,
    StandingPlane,
    direction,
    ground_ranges,
    span_of_rays,
)
from solmap.photogrammetry.terrain.orthophoto.view_sampling import (
    LEVELS,
    Pyramid,
    border_fade,
    coarse_points,
    masked_pyramid,
    sample_image,
)

BEYOND = 1.02
"""Limit of the angle from a camera's axis, relative to the corner of its image: beyond it, models
may fold back."""
NOWHERE_PX = -1e6
MOST_PIXELS = 1 << 26
"""Most pixels, for which pixels are made wider: 64 million are twice a full circle from pole to
pole with Navcam's pixels."""
SAMPLES = 1 << 16
"""Most directions in which brightness is compared: of a full circle, every sixteenth pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class PanoramaImage:
    """An image with its camera in the LSL, prepared for sampling by direction."""

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
    gain: float = 1.0
    """Factor of its brightness,"""
    offset: float = 0.0
    """and what is added."""

    @classmethod
    def of(
        cls, image_id: str, camera_in_lsl: CameraModel, image: GreyImage, mask: Mask
    ) -> PanoramaImage:
        """Prepare an image; `camera_in_lsl` has the adjusted orientation."""
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
            pyramid=masked_pyramid(np.asarray(image, np.float32), mask),
            fade=border_fade(mask),
            axis=ahead,
            cos_reach=math.cos(min(reach, math.pi)),
            pixel_deg=math.degrees(math.acos(float(np.clip(ahead @ beside, -1.0, 1.0)))),
        )

    @property
    def span(self) -> tuple[Span, Span]:
        """Azimuths and elevations of its field, degrees."""
        rays = self.camera.rays(border_points(self.size))
        return span_of_rays(rays, self.axis)

    def project(self, ground: ObjectPoints) -> Float64[np.ndarray, "n 2"]:
        """Image points of points in the LSL; far off the image where not visible."""
        away = ground - self.camera.centre
        ahead = away @ self.axis > self.cos_reach * np.linalg.norm(away, axis=1)
        found = np.full((len(ground), 2), NOWHERE_PX)
        if ahead.any():
            found[ahead] = np.nan_to_num(self.camera.project(ground[ahead]), nan=NOWHERE_PX)
        return found

    def project_lattice(
        self, places: Float64[np.ndarray, "down across 3"]
    ) -> tuple[Raster, Raster]:
        """Sample and line of a lattice of points in the LSL."""
        points = self.project(places.reshape(-1, 3)).astype(np.float32)
        sample, line = points.T.reshape(2, *places.shape[:2])
        return sample, line

    def sample(self, sample: Raster, line: Raster, pixel_deg: float) -> tuple[Raster, Raster]:
        """Brightness and fade at image points, for an output with pixels of that width."""
        level = round(math.log2(max(1.0, pixel_deg / self.pixel_deg)))
        level = min(level, LEVELS - 1)
        scale = np.float32(0.5**level)
        grey = sample_image(self.pyramid[level], sample * scale, line * scale, cv2.INTER_LINEAR)
        grey = grey * np.float32(self.gain) + np.float32(self.offset)
        return grey, sample_image(self.fade, *coarse_points(sample, line), cv2.INTER_LINEAR)


def interpolate_nodes(
    image: PanoramaImage, places: np.ndarray, shape: tuple[int, int]
) -> tuple[Raster, Raster] | None:
    """Sample and line at every pixel of a block, from those at its nodes; None: not in the image.

    Args:
        image: The image to sample.
        places: (down, across, 3) of the ground at the nodes and one beyond each way, LSL.
        shape: Rows and columns of the block.
    """
    sample, line = image.project_lattice(places)
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


@dataclass(frozen=True, slots=True)
class PanoramaParams:
    """Parameters of panoramas."""

    eye: Eye = Eye.LEFT
    """Images that the panorama is made from."""
    pixel_deg: PanoramaPixel = 0.0
    """Width of a pixel; 0: that of the coarsest images, which usually cover the full circle."""
    block_px: WholePixels = 512
    """Side of the blocks that are drawn at a time."""

    def __post_init__(self) -> None:
        if self.block_px < NODE or self.block_px % NODE or self.pixel_deg < 0:
            raise TerrainError(
                f"a panorama needs blocks of multiples of {NODE} pixels and pixels of zero "
                f"degrees or more, not {self.block_px} and {self.pixel_deg}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class PanoramaBlock:
    """A piece of a panorama; its first pixel is at (row, col) of the whole."""

    row: int
    col: int
    brightness: Raster
    """Balanced; NaN where no image shows it."""
    sources: Sources
    """At each node, the image with the largest weight; `NO_SOURCE` where there is none."""
    ranges: GroundRanges
    """Range at each node."""


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """A panorama prepared for rendering."""

    grid: AngleGrid
    centre: Vector3
    """North, east, down: the mean of the projection centres, metres in the LSL."""
    images: tuple[PanoramaImage, ...]
    """Balanced."""
    plane: StandingPlane
    dtm: Dtm | None
    params: PanoramaParams
    stretch: tuple[float, float]
    gains: Float64[np.ndarray, "images 2"]

    def nodes(self, row: int, col: int, rows: int, cols: int) -> tuple[ObjectPoints, GroundRanges]:
        """Points of the ground, in the LSL, at the nodes of a window and one beyond each way."""
        azimuths, elevations = self.grid.node_angles(row, col, rows, cols)
        ranges = ground_ranges(
            MAP_FROM_LSL @ self.centre, azimuths, elevations, self.plane, self.dtm
        )
        away = direction(azimuths[None, :], elevations[:, None]) * ranges.range_m[..., None]
        return away.reshape(-1, 3) + self.centre, ranges

    def blocks(self) -> Iterator[PanoramaBlock]:
        """The blocks in which any image is visible, row by row."""
        side = self.params.block_px
        for col in range(0, self.grid.cols, side):
            cols = min(side, self.grid.cols - col)
            ground, ranges = self.nodes(0, col, self.grid.rows, cols)
            places = ground.reshape(*ranges.range_m.shape, 3)
            for row in range(0, self.grid.rows, side):
                rows = min(side, self.grid.rows - row)
                part = np.s_[row // NODE : (row + rows) // NODE + 1]
                block = self._block((rows, cols), places[part])
                if block is not None:
                    inner = np.s_[row // NODE : (row + rows) // NODE, : cols // NODE]
                    seen = GroundRanges(ranges.range_m[inner], ranges.is_measured[inner])
                    yield PanoramaBlock(row, col, *block, seen)

    def _block(self, shape: tuple[int, int], places: np.ndarray) -> tuple[Raster, Sources] | None:
        total, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        best = np.zeros(shape, np.float32)
        source = np.full(shape, NO_SOURCE, np.uint16)
        finest = min(image.pixel_deg for image in self.images)
        for number, image in enumerate(self.images):
            seen = interpolate_nodes(image, places, shape)
            if seen is None:
                continue
            grey, fade = image.sample(*seen, self.grid.cell_deg)
            worth = fade * np.float32((finest / image.pixel_deg) ** 2)
            source[worth > best] = number
            np.maximum(best, worth, out=best)
            share = worth ** np.float32(SHARPNESS)
            total += share * grey
            weight += share
        if not best.any():
            return None
        shown = weight > 0
        brightness = np.where(shown, total / np.where(shown, weight, 1), np.float32(np.nan))
        return brightness, source[::NODE, ::NODE]


def prepare_panorama(
    images: Sequence[PanoramaImage],
    plane: StandingPlane,
    params: PanoramaParams,
    dtm: Dtm | None = None,
) -> Panorama:
    """Prepare the panorama of some images of a stop, to be rendered block by block.

    Raises:
        TerrainError: there is no image.
    """
    if not images:
        raise TerrainError("a panorama of no image; ingest one of this eye, or choose the other")
    spans = [image.span for image in images]
    elevations = min(low for _, (low, _) in spans), max(high for _, (_, high) in spans)
    pixel_deg = params.pixel_deg or max(image.pixel_deg for image in images)
    grid = AngleGrid.covering([azimuths for azimuths, _ in spans], elevations, pixel_deg)
    if grid.rows * grid.cols > MOST_PIXELS:
        wider = pixel_deg * math.sqrt(grid.rows * grid.cols / MOST_PIXELS)
        grid = AngleGrid.covering([azimuths for azimuths, _ in spans], elevations, wider)
    centre = np.mean([image.camera.centre for image in images], axis=0)
    gains = np.tile([1.0, 0.0], (len(images), 1))
    draft = Panorama(grid, centre, tuple(images), plane, dtm, params, (0.0, 1.0), gains)
    brightness = _samples(draft)
    gains = balance(brightness)
    even = brightness * gains[:, :1] + gains[:, 1:]
    seen = even[np.isfinite(even)]
    return replace(
        draft,
        images=tuple(
            replace(image, gain=gain, offset=offset)
            for image, (gain, offset) in zip(images, gains.tolist(), strict=True)
        ),
        stretch=black_and_white(seen),
        gains=gains,
    )


def _samples(draft: Panorama) -> np.ndarray:
    """Brightness of every image at a lattice of directions; NaN where it does not show them."""
    every = max(1, math.isqrt(draft.grid.rows * draft.grid.cols // SAMPLES) // NODE)
    ground, ranges = draft.nodes(0, 0, draft.grid.rows, draft.grid.cols)
    places = ground.reshape(*ranges.range_m.shape, 3)[::every, ::every]
    found = []
    for image in draft.images:
        sample, line = image.project_lattice(places)
        grey, fade = image.sample(sample, line, every * NODE / 2 * draft.grid.cell_deg)
        found.append(np.where(fade > 0, grey, np.float32(np.nan)).ravel())
    return np.stack(found).astype(np.float32)
