"""Three-dimensional meshes of stereo pairs: their dense points, textured with their own images.

A terrain model has one height per cell; the points of a pair also show overhangs and vertical faces
of rocks and outcrops. Neighbouring pixels are joined where they are one surface (`dtm.ground`), so
unseen parts stay open, and triangles are as few as a tolerance allows. The tolerance is in pixels
of parallax, in which every plane is linear,

    n.P = d,   P = f B / p (x, y, 1)      =>      p = f B n.(x, y, 1) / d

and a triangle between three points is a plane: with a parallax within t of the matched one, a point
moves along its ray by at most Z t / p, the same number of its standard deviations at any range. Its
image does not move at all.

Where pairs overlap, ground is taken from the pair that shows it best: with the most pixels on it,
and not at the border of its image. This is decided for blocks of pixels, and a block is left to
another pair only if that one is clearly better, so that no gap opens between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, EightBits, Float32, GreyImage, Mask, ParallaxMap
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.ranges import (
    FactorFromOne,
    JpegQuality,
    Pixels,
    ShareAboveZero,
    WholePixels,
)
from solmap.photogrammetry.stretching import black_and_white
from solmap.photogrammetry.terrain.dtm.ground import (
    SightParams,
    camera_on_map,
    continuous_ground,
    ground_points,
    trusted_parallax,
)
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.mesh.right_triangles import RightTriangles
from solmap.photogrammetry.terrain.mesh.surface_mesh import (
    SurfaceMesh,
    TexturedMesh,
    mean_normals,
)
from solmap.photogrammetry.terrain.orthophoto.view_sampling import NEAREST_M, ViewSampler

GAP_PX = 4
"""Widest gap of unmatched pixels that is filled, where the surface around is smooth: gaps narrower
than half a matching window are not occlusions."""
SAMPLED = 37
"""Step in pixels at which the brightness is sampled."""


@dataclass(frozen=True, slots=True)
class ViewModelParams(SightParams):
    """Parameters of view meshes."""

    max_relative_sigma: ShareAboveZero = 0.01
    """Largest standard deviation along the view over the distance: beyond it (10 m with Navcam, 43
    m with Pancam) noise along the rays is larger than the relief of interest."""
    tolerance_px: Pixels = 0.5
    """Largest deviation of a triangle's parallax: two standard deviations of a dense parallax,
    which noise exceeds in few of them."""
    block_px: WholePixels = 8
    """Side of the blocks for which one pair is chosen."""
    yield_to: FactorFromOne = 1.25
    """Ratio by which another pair must be better for this one to leave a block out."""
    jpeg_quality: JpegQuality = 90
    """JPEG quality of the textures, percent."""
    draco: bool = True
    """Whether to compress triangles with Draco: to a fifth of the size; viewers need its
    decoder."""


@dataclass(frozen=True, slots=True, eq=False)
class _PreparedView:
    """A view with its ground marked."""

    view: TerrainView
    parallax: ParallaxMap
    blocks: Float32[np.ndarray, "3 blocks_down blocks_across"]
    """The points in the middle of the blocks, from the camera."""
    whole: Bool[np.ndarray, "squares_down squares_across"]


def view_meshes(views: Sequence[TerrainView], params: ViewModelParams) -> list[TexturedMesh]:
    """The ground that every view shows best, as a mesh with its image; may omit views.

    Raises:
        TerrainError: no view has continuous ground near enough.
    """
    prepared = [_prepare(view, params) for view in views]
    prepared = [one for one in prepared if one.whole.any()]
    if not prepared:
        raise TerrainError(
            f"none of the {len(views)} views has continuous ground accurate to "
            f"{params.max_relative_sigma:.1%} of its distance: check the matching, or allow a "
            "larger max_relative_sigma"
        )
    samplers = [ViewSampler.of(one.view, bands=()) for one in prepared]
    black, white = _stretch(prepared)
    meshes = []
    for number, one in enumerate(prepared):
        whole = one.whole & ~_shown_better(number, one, samplers, params)
        if whole.any():
            meshes.append(_mesh(one, whole, (black, white), params))
    return meshes


def _prepare(view: TerrainView, params: ViewModelParams) -> _PreparedView:
    parallax = _fill_specks(trusted_parallax(view, params), params)
    planes = ground_points(view, parallax, params)
    squares = continuous_ground(planes, parallax, view, params)
    middles = slice(params.block_px // 2, None, params.block_px)
    return _PreparedView(view, parallax, planes[:, middles, middles].copy(), squares[:-1, :-1])


def _fill_specks(parallax: ParallaxMap, params: ViewModelParams) -> ParallaxMap:
    """The parallax with narrow gaps filled by the mean around them, on smooth surfaces."""
    side = GAP_PX // 2 * 2 + 1
    around = np.ones((side, side), np.uint8)
    known = np.isfinite(parallax)
    closed = cv2.morphologyEx(known.astype(np.uint8), cv2.MORPH_CLOSE, around) > 0
    far, near = np.float32(0), np.float32(np.finfo(np.float32).max)
    highest = cv2.dilate(np.where(known, parallax, far), around)
    lowest = cv2.erode(np.where(known, parallax, near), around)
    count = cv2.boxFilter(known.astype(np.float32), -1, (side, side), normalize=False)
    total = cv2.boxFilter(np.where(known, parallax, far), -1, (side, side), normalize=False)
    speck = closed & ~known & (highest - lowest <= 2 * params.max_spike_px)
    return np.where(speck, total / np.maximum(count, 1), parallax).astype(np.float32)


def _shown_better(
    number: int, one: _PreparedView, samplers: Sequence[ViewSampler], params: ViewModelParams
) -> Bool[np.ndarray, "squares_down squares_across"]:
    """Squares whose block another view shows clearly better."""
    from_here = np.nan_to_num(one.blocks, nan=1.0)
    distance = np.linalg.norm(from_here, axis=0)
    toward = (-from_here / np.maximum(distance, NEAREST_M)).astype(np.float32)
    worth = []
    for sampler in samplers:
        shift = (samplers[number].camera - sampler.camera).astype(np.float32)
        ground = from_here + shift[:, None, None]
        worth.append(sampler.project(ground, toward, 0.0).worth)
    own = worth.pop(number)
    better = np.max(worth, axis=0, initial=0.0) > params.yield_to * own
    rows, cols = one.whole.shape
    blocks = np.pad(better, 1, mode="edge")[1:, 1:]  # a last block may be less than half a block
    return np.kron(blocks, np.ones((params.block_px,) * 2, np.bool_))[:rows, :cols]


def _stretch(prepared: Sequence[_PreparedView]) -> tuple[float, float]:
    """Brightness shown as black and as white in all textures."""
    sample = np.concatenate([one.view.image[one.view.mask][::SAMPLED] for one in prepared])
    return black_and_white(sample)


def _mesh(
    one: _PreparedView,
    whole: Bool[np.ndarray, "squares_down squares_across"],
    stretch: tuple[float, float],
    params: ViewModelParams,
) -> TexturedMesh:
    """The view's squares as triangles, textured with the part of the image that shows them."""
    grid_mesh = RightTriangles.of(one.parallax, whole).mesh(params.tolerance_px)
    rows, cols = (slice(int(at.min()), int(at.max()) + 1) for at in (grid_mesh.row, grid_mesh.col))
    size = np.array([cols.stop - cols.start, rows.stop - rows.start])
    pixels = np.column_stack([grid_mesh.col - cols.start, grid_mesh.row - rows.start])
    planes = ground_points(one.view, one.parallax, params)
    points = planes[:, grid_mesh.row, grid_mesh.col].T + camera_on_map(one.view.lsl_from_pair)
    mesh = SurfaceMesh(
        points=points,
        normals=mean_normals(points, grid_mesh.triangles),
        triangles=grid_mesh.triangles,
        texture_at=((pixels + 0.5) / size).astype(np.float32),
    )
    view = one.view
    texture = _grey(view.image[rows, cols], view.mask[rows, cols], stretch)
    return TexturedMesh(view.pair_id, mesh, texture)


def _grey(image: GreyImage, mask: Mask, stretch: tuple[float, float]) -> EightBits:
    """The image in eight bits; unusable pixels are middle grey."""
    black, white = stretch
    grey = np.clip((image - black) * (255 / (white - black)), 0, 255)
    return np.where(mask, np.rint(grey), 128).astype(np.uint8)
