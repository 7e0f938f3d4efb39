"""Models of the ground in three dimensions: triangles between measured points, and what they wear.

Of a terrain model the vertices are the middles of seen cells and the triangles as few as a vertical
tolerance allows (`right_triangles`); its texture is the orthophoto. A terrain model has one height
a cell. What one stereo pair sees has overhangs and faces too steep for that: `view_model`.

Points are (east, north, up) in metres of the local map, in double precision; who writes them into
a file takes them relative to an origin near by, because there a coordinate has seven digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import (
    Directions,
    Float32,
    Float64,
    Int32,
    ObjectPoints,
    Picture,
    Raster,
)
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.planes import Gradients, gradients
from solmap.photogrammetry.terrain.right_triangles import GridMesh, RightTriangles

Bounds = tuple[float, float, float, float]
"""(west, south, east, north), metres."""
NORMAL_M = 0.2
"""Side of the window that gives a cell its normal: rocks count, noise does not."""
CORNER = 0.25
"""Share of that window that must have an elevation: a quarter has at a corner."""
HALF = 0.5
"""Share of a square that must have been seen at coarser levels."""


@dataclass(frozen=True, slots=True)
class ModelParams:
    """How to draw a stop's terrain model in three dimensions."""

    tolerance_m: float = 0.02
    """Largest vertical distance between the model and the terrain model's cells: the standard
    deviation of half of the cells. Triangles that follow noise more closely show no more ground."""
    max_texture_px: int = 4096
    """Longest side of the texture: what every graphics driver of the last decade takes."""
    jpeg_quality: int = 90
    """Of the texture. The edge of what was seen is drawn by the mesh and cannot smear."""

    def __post_init__(self) -> None:
        if not (self.tolerance_m > 0 and self.max_texture_px > 0 and 0 < self.jpeg_quality <= 100):  # noqa: PLR2004 - percent
            raise TerrainError(
                f"a model needs a tolerance, a texture and a quality in percent, not "
                f"{self.tolerance_m} m, {self.max_texture_px} px and {self.jpeg_quality}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """Triangles in space, and where their corners lie in a texture."""

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
    """A mesh and the picture that it wears."""

    name: str
    mesh: SurfaceMesh
    texture: Picture


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
class TerrainDrawing:
    """A grid of ground points, ready for being drawn with any tolerance, whole or in parts."""

    east: Float64[np.ndarray, " cols"]
    north: Float64[np.ndarray, " rows"]
    elevation: Raster
    gradient: Gradients
    """Of the terrain model, so that normals are the same on both sides of any border."""
    seen: Float32[np.ndarray, "squares_down squares_across"]
    """Share of every square between four points that the terrain model's cells have seen."""
    triangles: RightTriangles

    @classmethod
    def of(cls, dtm: Dtm) -> TerrainDrawing:
        """Prepare a terrain model: the middles of its cells are the points.

        Raises:
            TerrainError: no four neighbouring cells have an elevation.
        """
        cell_m = dtm.grid.cell_m
        known = np.isfinite(dtm.elevation)
        whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        if not whole.any():
            raise TerrainError(
                f"of {dtm.grid.rows} x {dtm.grid.cols} cells no four neighbours have an elevation, "
                "so there is no surface to draw"
            )
        gradient = gradients(dtm.elevation, cell_m, max(NORMAL_M, 3 * cell_m), CORNER)
        triangles = RightTriangles.of(dtm.elevation, whole)
        seen = whole.astype(np.float32)
        return cls(*dtm.grid.centres(), dtm.elevation, gradient, seen, triangles)

    def coarser(self) -> TerrainDrawing:
        """Every second point. A square is ground when at least half of it was seen."""
        down, across = (n // 2 * 2 for n in self.seen.shape)
        four = self.seen[:down, :across].reshape(down // 2, 2, across // 2, 2)
        seen = np.pad(four.mean(axis=(1, 3)), [(0, n % 2) for n in self.seen.shape])
        points = self.elevation[::2, ::2]
        seen = seen[: points.shape[0] - 1, : points.shape[1] - 1]
        return TerrainDrawing(
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

    def surface(self, drawn: GridMesh, texture_bounds: Bounds) -> SurfaceMesh:
        """Triangles drawn on the grid, in space, and where they lie in an orthophoto."""
        east, north = self.east[drawn.col], self.north[drawn.row]
        up = self.elevation[drawn.row, drawn.col].astype(np.float64)
        rise = np.nan_to_num(self.gradient[:, drawn.row, drawn.col].astype(np.float64))
        normals = np.column_stack([-rise[0], -rise[1], np.ones(len(up))])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        west, south, right, top = texture_bounds
        places = np.column_stack([(east - west) / (right - west), (top - north) / (top - south)])
        points = np.column_stack([east, north, up])
        return SurfaceMesh(points, normals, drawn.triangles, places.astype(np.float32))
