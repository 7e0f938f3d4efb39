"""A terrain model as a quadtree of tiles, every level half as fine as the one below.

A tile of level L is one root square of the triangulation of every 2^L-th point, drawn with 2^L
times the tolerance, so that all tiles have about as many triangles. At coarser levels the edge of
what was seen moves by up to half a square, as is fair where a square is seen as a few pixels; at
the finest, holes are exactly holes. Neighbours of one level meet exactly. Where a viewer shows two
levels side by side, their borders part by about the coarser tolerance: a skirt as deep as that
hangs from every tile's border, below the ground and only where ground reaches it, and closes the
gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Bool
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.model3d import Bounds, SurfaceMesh, TerrainDrawing
from solmap.photogrammetry.terrain.right_triangles import GridMesh


@dataclass(frozen=True, slots=True)
class TilesetParams:
    """How to cut a terrain model into tiles in three dimensions."""

    tolerance_m: float = 0.02
    """Largest vertical distance from the terrain model at the finest level; doubles with each."""
    texture_px: int = 1024
    """Side of a tile's texture: that of the orthophoto itself at the finest level."""
    jpeg_quality: int = 85
    """Of the textures, percent."""
    draco: bool = False
    """Whether to compress triangles with Draco: a third of the size; viewers need its decoder."""

    def __post_init__(self) -> None:
        if not (self.tolerance_m > 0 and self.texture_px > 0 and 0 < self.jpeg_quality <= 100):  # noqa: PLR2004 - percent
            raise TerrainError(
                f"tiles need a tolerance, a texture and a quality in percent, not "
                f"{self.tolerance_m} m, {self.texture_px} px and {self.jpeg_quality}"
            )


@dataclass(frozen=True, slots=True, order=True)
class TilePlace:
    """A tile's level, 0 the finest, and its row and column among the tiles of that level."""

    level: int
    row: int
    col: int

    @property
    def parent(self) -> TilePlace:
        """The tile that shows this ground half as fine."""
        return TilePlace(self.level + 1, self.row // 2, self.col // 2)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnTile:
    """One tile's triangles on the grid of its level."""

    place: TilePlace
    tolerance_m: float
    drawing: TerrainDrawing
    """The points of its level."""
    drawn: GridMesh

    @property
    def bounds(self) -> Bounds:
        """(west, south, east, north) of its square, metres of the local map."""
        points = 1 << self.drawing.triangles.levels
        east, north = self.drawing.east, self.drawing.north
        step_m = float(east[1] - east[0])
        west = float(east[0]) + self.place.col * points * step_m
        top = float(north[0]) - self.place.row * points * step_m
        return west, top - points * step_m, west + points * step_m, top

    def surface(self, texture_bounds: Bounds) -> SurfaceMesh:
        """The tile's surface in space, with skirts."""
        surface = self.drawing.surface(self.drawn, texture_bounds)
        return with_skirts(surface, self._on_sides, self.tolerance_m)

    @property
    def _on_sides(self) -> Bool[np.ndarray, "4 n"]:
        points = 1 << self.drawing.triangles.levels
        row = self.drawn.row - self.place.row * points
        col = self.drawn.col - self.place.col * points
        return np.stack([row == 0, row == points, col == 0, col == points])


def drawn_tiles(drawing: TerrainDrawing, params: TilesetParams) -> Iterator[DrawnTile]:
    """All tiles that show ground, finest level first; the last one is the root."""
    down, across = drawing.triangles.roots
    coarsest = math.ceil(math.log2(max(down, across)))
    for level in range(coarsest + 1):
        for row, col in np.ndindex(drawing.triangles.roots):
            place = TilePlace(level, row, col)
            drawn = drawing.triangles.mesh(
                params.tolerance_m * (1 << level), (slice(row, row + 1), slice(col, col + 1))
            )
            if len(drawn):
                yield DrawnTile(place, params.tolerance_m * (1 << level), drawing, drawn)
        if level < coarsest:
            drawing = drawing.coarser()


def with_skirts(
    surface: SurfaceMesh, on_sides: Bool[np.ndarray, "4 n"], depth_m: float
) -> SurfaceMesh:
    """The surface, and a strip of this depth hanging from its edges along the four sides."""
    count = len(surface.points)
    a = surface.triangles.ravel().astype(np.int64)
    b = np.roll(surface.triangles, -1, axis=1).ravel().astype(np.int64)
    border = (on_sides[:, a] & on_sides[:, b]).any(axis=0)
    a, b = a[border], b[border]
    single = ~np.isin(a * count + b, b * count + a)
    a, b = a[single], b[single]
    hung, low = np.unique(np.concatenate([a, b]), return_inverse=True)
    low_a, low_b = np.split(low + count, 2)
    strips = [np.column_stack([b, a, low_a]), np.column_stack([b, low_a, low_b])]
    lowered = surface.points[hung] - (0.0, 0.0, depth_m)
    return SurfaceMesh(
        points=np.concatenate([surface.points, lowered]),
        normals=np.concatenate([surface.normals, surface.normals[hung]]),
        triangles=np.concatenate([surface.triangles, *strips]).astype(np.int32),
        texture_at=np.concatenate([surface.texture_at, surface.texture_at[hung]]),
    )
