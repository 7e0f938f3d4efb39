"""TIN: gaps between measured cells filled by triangles, as in the paper (section 5).

The measured cells of a terrain model, each the weighted mean of its points, are triangulated on
the map (Delaunay). A cell without points takes the plane of its triangle if none of the triangle's
sides is longer than the widest gap that may be bridged and if nothing hides it (`occlusion`). With
the barycentric coordinates l of the cell the variance is

    sigma^2 = sum(l sigma_i^2) + (r L q)^2,      q = (1 - sum l^2) / 2

where L is the triangle's longest side and r the roughness of ground: in the middle of a side L q is
L/4, as in the mesh between two lines of an image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import Delaunay

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.terrain.records import Dtm, GroundClass

LEAST_NODES = 4
"""A triangulation of fewer points is none."""

Weights3 = Float64[np.ndarray, "n 3"]


def fill_by_triangles(dtm: Dtm, gap_m: float, roughness: float) -> Dtm:
    """A model of measured and occluded cells with its gaps of up to `gap_m` filled."""
    measured = dtm.ground == GroundClass.MEASURED
    near = cv2.distanceTransform((~measured).astype(np.uint8), cv2.DIST_L2, 5) * dtm.grid.cell_m
    # no place in a triangle is farther from a corner than its longest side over the root of three
    open_ = (dtm.ground == GroundClass.UNSEEN) & (near <= gap_m / np.sqrt(3))
    border = cv2.dilate(open_.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    nodes = np.argwhere(measured & (border | ~_surrounded(measured)))
    cells = np.argwhere(open_)
    if len(nodes) < LEAST_NODES or not len(cells):
        return dtm
    found = _Triangles.around(nodes, cells, gap_m / dtm.grid.cell_m)
    return found.filled(dtm, roughness)


def _surrounded(measured: np.ndarray) -> np.ndarray:
    """Measured cells whose eight neighbours are measured: no triangle of theirs holds a gap."""
    return cv2.erode(measured.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


@dataclass(frozen=True, slots=True, eq=False)
class _Triangles:
    """Cells that lie in a triangle of measured ones."""

    cells: np.ndarray
    """(n, 2): row and column."""
    corners: np.ndarray
    """(n, 3, 2): rows and columns of the measured cells around."""
    weights: Weights3
    side: np.ndarray
    """Longest side, cells."""

    @classmethod
    def around(cls, nodes: np.ndarray, cells: np.ndarray, gap: float) -> _Triangles:
        """The triangles around some cells whose sides are no longer than `gap` cells."""
        mesh = Delaunay(nodes.astype(np.float64))
        sides = np.diff(nodes[mesh.simplices[:, [0, 1, 2, 0]]], axis=1)
        longest = np.sqrt((sides.astype(np.float64) ** 2).sum(axis=2)).max(axis=1)
        triangle = mesh.find_simplex(cells.astype(np.float64))
        inside = (triangle >= 0) & (longest[triangle] <= gap)
        cells, triangle = cells[inside], triangle[inside]
        frame = mesh.transform[triangle]
        first = np.einsum("nij,nj->ni", frame[:, :2], cells - frame[:, 2])
        weights = np.column_stack([first, 1 - first.sum(axis=1)])
        return cls(cells, nodes[mesh.simplices[triangle]], weights, longest[triangle])

    def mean(self, layer: np.ndarray) -> np.ndarray:
        """A layer's values on the planes of the triangles."""
        at_corners = layer[self.corners[..., 0], self.corners[..., 1]]
        return np.einsum("ni,ni->n", self.weights, at_corners)

    def filled(self, dtm: Dtm, roughness: float) -> Dtm:
        """The model with these cells interpolated."""
        row, col = self.cells.T
        spread = (1 - np.square(self.weights).sum(axis=1)) / 2
        stray = roughness * self.side * dtm.grid.cell_m * spread
        variance = np.maximum(self.mean(np.square(dtm.sigma_m.astype(np.float64))), 0)
        elevation, sigma_m, ground = dtm.elevation.copy(), dtm.sigma_m.copy(), dtm.ground.copy()
        elevation[row, col] = self.mean(elevation.astype(np.float64))
        sigma_m[row, col] = np.sqrt(variance + np.square(stray))
        ground[row, col] = GroundClass.INTERPOLATED
        pose = None if dtm.pose_sigma_m is None else dtm.pose_sigma_m.copy()
        if pose is not None:
            pose[row, col] = self.mean(pose)
        return replace(dtm, elevation=elevation, sigma_m=sigma_m, ground=ground, pose_sigma_m=pose)
