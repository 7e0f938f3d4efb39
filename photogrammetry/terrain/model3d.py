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

from photogrammetry.arrays import Directions, Float32, Int32, ObjectPoints, Picture
from photogrammetry.errors import TerrainError
from photogrammetry.terrain.grid import MapGrid
from photogrammetry.terrain.records import Dtm
from photogrammetry.terrain.right_triangles import GridMesh, RightTriangles

Bounds = tuple[float, float, float, float]
"""(west, south, east, north), metres."""


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
    triangles: Int32[np.ndarray, "m 3"]
    """Corners of every triangle, counter-clockwise seen from outside the ground."""
    texture_at: Float32[np.ndarray, "n 2"]
    """Across and down from the texture's upper left corner, 0 to 1."""

    def __len__(self) -> int:
        return len(self.triangles)

    def normals(self) -> Directions:
        """Unit normal at every point: the mean of its triangles' normals, weighted by area."""
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        across = np.cross(b - a, c - a)
        total = np.zeros_like(self.points)
        for corner in range(3):
            for axis in range(3):
                total[:, axis] += np.bincount(
                    self.triangles[:, corner], across[:, axis], minlength=len(total)
                )
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.where(length > 0, total / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class TexturedMesh:
    """A mesh and the picture that it wears."""

    name: str
    mesh: SurfaceMesh
    texture: Picture


def prepare_terrain(dtm: Dtm) -> RightTriangles:
    """A terrain model, ready for being drawn with any tolerance.

    Raises:
        TerrainError: no four neighbouring cells have an elevation.
    """
    prepared = RightTriangles.of(dtm.elevation)
    if not prepared.whole.any():
        raise TerrainError(
            f"of {dtm.grid.rows} x {dtm.grid.cols} cells no four neighbours have an elevation, so "
            "there is no surface to draw"
        )
    return prepared


def terrain_mesh(dtm: Dtm, drawn: GridMesh, texture_bounds: Bounds) -> SurfaceMesh:
    """The triangles drawn on a terrain model's grid, in space, and their place in an orthophoto."""
    east, north = dtm.grid.centres()
    up = dtm.elevation[drawn.row, drawn.col].astype(np.float64)
    points = np.column_stack([east[drawn.col], north[drawn.row], up])
    west, south, right, top = texture_bounds
    across = (points[:, 0] - west) / (right - west)
    down = (top - points[:, 1]) / (top - south)
    return SurfaceMesh(points, drawn.triangles, np.column_stack([across, down]).astype(np.float32))


def bounds_of_surface(dtm: Dtm) -> Bounds:
    """The smallest box of cells around all that have an elevation."""
    seen = np.isfinite(dtm.elevation)
    rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    grid: MapGrid = dtm.grid
    return grid.part(
        int(rows[0]), int(cols[0]), int(rows[-1] - rows[0]) + 1, int(cols[-1] - cols[0]) + 1
    ).bounds
