"""Textured triangle meshes of a terrain model, whole and as a quadtree of tiles.

The vertices are the centres of a terrain model's known cells and the triangles as few as a vertical
tolerance allows (`right_triangles`); the texture is the orthophoto. A terrain model has one height
per cell; points of single stereo pairs also show overhangs and steep faces (`view_mesh`).

Points are (east, north, up) in metres of the local map, in double precision. Mesh files store them
relative to a nearby origin, because their coordinates have seven digits.

Every level of the quadtree is half as fine as the next finer one. A tile of level L is one root
square of the triangulation of every 2^L-th point, with 2^L times the tolerance, so that all tiles
have about as many triangles. At coarser levels the edge of known ground moves by up to half a
square, where a square is only a few pixels wide; at the finest, holes are exact. Neighbours of one
level meet exactly. Where a viewer shows two levels side by side, their borders differ by about the
coarser tolerance; a vertical skirt of that depth along every tile's border closes the gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import (
    Bool,
    Directions,
    EightBits,
    Float32,
    Float64,
    Int32,
    ObjectPoints,
    Raster,
)
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import Gradients, window_gradients
from solmap.photogrammetry.ranges import JpegQuality, Metres, WholePixels
from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.mesh.right_triangles import GridMesh, RightTriangles

NORMAL_M = 0.2
"""Side of the window for a cell's normal: includes rocks, averages noise."""
CORNER = 0.25
"""Least fraction of that window with an elevation: a corner has a quarter."""
HALF = 0.5
"""Least fraction of a square with elevations at coarser levels."""


@dataclass(frozen=True, slots=True)
class ModelParams:
    """Parameters of a stop's three-dimensional terrain model."""

    tolerance_m: Metres = 0.02
    """Largest vertical distance between the model and the terrain model's cells: the standard
    deviation of half of the cells. A smaller value would only follow noise."""
    max_texture_px: WholePixels = 4096
    """Longest side of the texture, supported by every graphics driver of the last decade."""
    jpeg_quality: JpegQuality = 90
    """JPEG quality of the texture. The mesh defines the edge of known ground, so compression does
    not blur it."""

    def __post_init__(self) -> None:
        if not (self.tolerance_m > 0 and self.max_texture_px > 0 and 0 < self.jpeg_quality <= 100):  # noqa: PLR2004 - percent
            raise TerrainError(
                f"a model needs a tolerance, a texture and a quality in percent, not "
                f"{self.tolerance_m} m, {self.max_texture_px} px and {self.jpeg_quality}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """Triangles in space, with texture coordinates."""

    points: ObjectPoints
    """(east, north, up), metres of the local map."""
    normals: Directions
    triangles: Int32[np.ndarray, "m 3"]
    """Corners of every triangle, counter-clockwise seen from outside the ground."""
    texture_at: Float32[np.ndarray, "n 2"]
    """Across and down from the texture's upper left corner, 0 to 1."""

    def __len__(self) -> int:
        return len(self.triangles)


@dataclass(frozen=True, slots=True, eq=False)
class TexturedMesh:
    """A mesh with its texture."""

    name: str
    mesh: SurfaceMesh
    texture: EightBits


def mean_normals(points: ObjectPoints, triangles: Int32[np.ndarray, "m 3"]) -> Directions:
    """Unit normal at every point: the mean of its triangles' normals, weighted by area."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    areas = np.cross(b - a, c - a)
    total = np.zeros_like(points)
    for corner in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(triangles[:, corner], areas[:, axis], len(points))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class TerrainMesher:
    """A grid of ground points, prepared for triangulation with any tolerance, whole or in parts."""

    east: Float64[np.ndarray, " cols"]
    north: Float64[np.ndarray, " rows"]
    elevation: Raster
    gradient: Gradients
    """Gradient from the terrain model, so that normals are the same on both sides of any border."""
    seen: Float32[np.ndarray, "squares_down squares_across"]
    """Fraction of every square between four points with known cells of the terrain model."""
    triangles: RightTriangles

    @classmethod
    def of(cls, dtm: Dtm) -> TerrainMesher:
        """Prepare a terrain model: the centres of its cells are the points.

        Raises:
            TerrainError: no four neighbouring cells have an elevation.
        """
        cell_m = dtm.grid.cell_m
        known = np.isfinite(dtm.elevation)
        whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        if not whole.any():
            raise TerrainError(
                f"of {dtm.grid.rows} x {dtm.grid.cols} cells no four neighbours have an "
                "elevation, so there is no surface"
            )
        gradient = window_gradients(dtm.elevation, cell_m, max(NORMAL_M, 3 * cell_m), CORNER)
        triangles = RightTriangles.of(dtm.elevation, whole)
        seen = whole.astype(np.float32)
        return cls(*dtm.grid.centres(), dtm.elevation, gradient, seen, triangles)

    def coarser(self) -> TerrainMesher:
        """Every second point. A square is ground when at least half of it is known."""
        down, across = (n // 2 * 2 for n in self.seen.shape)
        four = self.seen[:down, :across].reshape(down // 2, 2, across // 2, 2)
        seen = np.pad(four.mean(axis=(1, 3)), [(0, n % 2) for n in self.seen.shape])
        points = self.elevation[::2, ::2]
        seen = seen[: points.shape[0] - 1, : points.shape[1] - 1]
        return TerrainMesher(
            east=self.east[::2],
            north=self.north[::2],
            elevation=points,
            gradient=self.gradient[:, ::2, ::2],
            seen=seen,
            triangles=RightTriangles.of(points, seen >= HALF),
        )

    @property
    def bounds(self) -> Bounds:
        """The smallest box around all points with an elevation."""
        known = np.isfinite(self.elevation)
        north = self.north[known.any(axis=1)]
        east = self.east[known.any(axis=0)]
        return float(east[0]), float(north[-1]), float(east[-1]), float(north[0])

    def surface(self, grid_mesh: GridMesh, texture_bounds: Bounds) -> SurfaceMesh:
        """Triangles on the grid, in space, with their positions in an orthophoto."""
        east, north = self.east[grid_mesh.col], self.north[grid_mesh.row]
        up = self.elevation[grid_mesh.row, grid_mesh.col].astype(np.float64)
        rise = np.nan_to_num(self.gradient[:, grid_mesh.row, grid_mesh.col].astype(np.float64))
        normals = np.column_stack([-rise[0], -rise[1], np.ones(len(up))])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        west, south, right, top = texture_bounds
        places = np.column_stack([(east - west) / (right - west), (top - north) / (top - south)])
        points = np.column_stack([east, north, up])
        return SurfaceMesh(points, normals, grid_mesh.triangles, places.astype(np.float32))


@dataclass(frozen=True, slots=True)
class TilesetParams:
    """Parameters of dividing a terrain model into three-dimensional tiles."""

    tolerance_m: Metres = 0.02
    """Largest vertical distance from the terrain model at the finest level; doubled at each coarser
    one."""
    texture_px: WholePixels = 1024
    """Side of a tile's texture: that of the orthophoto itself at the finest level."""
    jpeg_quality: JpegQuality = 85
    """JPEG quality of the textures, percent."""
    draco: bool = False
    """Whether to compress triangles with Draco: to a third of the size; viewers need its
    decoder."""

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
        """The tile of the next coarser level that contains this one."""
        return TilePlace(self.level + 1, self.row // 2, self.col // 2)


@dataclass(frozen=True, slots=True, eq=False)
class MeshTile:
    """One tile's triangles on the grid of its level."""

    place: TilePlace
    tolerance_m: float
    mesher: TerrainMesher
    """The points of its level."""
    grid_mesh: GridMesh

    @property
    def bounds(self) -> Bounds:
        """(west, south, east, north) of its square, metres of the local map."""
        points = 1 << self.mesher.triangles.levels
        east, north = self.mesher.east, self.mesher.north
        step_m = float(east[1] - east[0])
        west = float(east[0]) + self.place.col * points * step_m
        top = float(north[0]) - self.place.row * points * step_m
        return west, top - points * step_m, west + points * step_m, top

    def surface(self, texture_bounds: Bounds) -> SurfaceMesh:
        """The tile's surface in space, with skirts."""
        surface = self.mesher.surface(self.grid_mesh, texture_bounds)
        return add_skirts(surface, self._on_sides, self.tolerance_m)

    @property
    def _on_sides(self) -> Bool[np.ndarray, "4 n"]:
        points = 1 << self.mesher.triangles.levels
        row = self.grid_mesh.row - self.place.row * points
        col = self.grid_mesh.col - self.place.col * points
        return np.stack([row == 0, row == points, col == 0, col == points])


def mesh_tiles(mesher: TerrainMesher, params: TilesetParams) -> Iterator[MeshTile]:
    """All tiles with ground, finest level first; the last one is the root."""
    down, across = mesher.triangles.roots
    coarsest = math.ceil(math.log2(max(down, across)))
    for level in range(coarsest + 1):
        for row, col in np.ndindex(mesher.triangles.roots):
            place = TilePlace(level, row, col)
            grid_mesh = mesher.triangles.mesh(
                params.tolerance_m * (1 << level), (slice(row, row + 1), slice(col, col + 1))
            )
            if len(grid_mesh):
                yield MeshTile(place, params.tolerance_m * (1 << level), mesher, grid_mesh)
        if level < coarsest:
            mesher = mesher.coarser()


def add_skirts(
    surface: SurfaceMesh, on_sides: Bool[np.ndarray, "4 n"], depth_m: float
) -> SurfaceMesh:
    """The surface with a vertical strip of this depth below its edges along the four sides."""
    count = len(surface.points)
    a = surface.triangles.ravel().astype(np.int64)
    b = np.roll(surface.triangles, -1, axis=1).ravel().astype(np.int64)
    border = (on_sides[:, a] & on_sides[:, b]).any(axis=0)
    a, b = a[border], b[border]
    single = ~np.isin(a * count + b, b * count + a)
    a, b = a[single], b[single]
    border_points, low = np.unique(np.concatenate([a, b]), return_inverse=True)
    low_a, low_b = np.split(low + count, 2)
    strips = [np.column_stack([b, a, low_a]), np.column_stack([b, low_a, low_b])]
    lowered = surface.points[border_points] - (0.0, 0.0, depth_m)
    return SurfaceMesh(
        points=np.concatenate([surface.points, lowered]),
        normals=np.concatenate([surface.normals, surface.normals[border_points]]),
        triangles=np.concatenate([surface.triangles, *strips]).astype(np.int32),
        texture_at=np.concatenate([surface.texture_at, surface.texture_at[border_points]]),
    )
