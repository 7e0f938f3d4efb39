"""Parallax in `rendered_husband` by its truth grid, and the uncertainty of the grid.

The grid has a node every 0.1 m, rocks included; the ground between nodes is not in it.
So a ray is cast three times: on the bilinear surface, and on the steps made of the lowest and of
the highest of the four nodes around. What the last two leave open is the width of the truth.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import rasterio

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import RoverImage
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.tasks.images.pairs import pair_geometry
from tests.support.stereo_pairs import resample_pair

NEAREST_M, FURTHEST_M = 1.0, 90.0
STEP = 1.001
"""Ratio of one range along a ray to the next: at 20 m, 2 cm."""
HALVINGS = 14

Surface = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Elevation from the (4, n) corners of a cell and the place in it, down and across, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedPair:
    """A pair whose true pose is known, and the surface it was rendered from."""

    name: str
    images: EpipolarImages
    lsl_from_pair: Pose
    nodes: np.ndarray
    """(4, rows, columns): elevation at the corners of each cell of the grid, and where it lies."""
    cell_from_east_north: np.ndarray

    def true_parallax(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(parallax, width of it), both in pixels, of image points on the left epipolar image."""
        ahead = (points - np.array(self.images.geometry.centre_px)) / self.images.geometry.focal_px
        rays = np.column_stack([ahead, np.ones(len(points))]) @ self.lsl_from_pair.rotation.T
        surfaces = (
            _bilinear,
            lambda corners, *_: corners.min(0),
            lambda corners, *_: corners.max(0),
        )
        scale = self.images.geometry.focal_px * self.images.geometry.base_m
        parallax, least, most = (scale / self._depth(rays, surface) for surface in surfaces)
        return parallax, most - least

    def _depth(self, rays: np.ndarray, surface: Surface) -> np.ndarray:
        """First crossing of rays, whose component along the axis is 1, by steps and halving."""
        below, above = np.full(len(rays), np.nan), np.full(len(rays), np.nan)
        searched, before, depth = np.arange(len(rays)), NEAREST_M, NEAREST_M
        while depth < FURTHEST_M and len(searched):
            height = self._height(rays[searched], np.full(len(searched), depth), surface)
            hit = height < 0
            above[searched[hit]], below[searched[hit]] = before, depth
            searched = searched[~hit & np.isfinite(height)]
            before, depth = depth, depth * STEP
        known = np.isfinite(below)
        for _ in range(HALVINGS):
            middle = (above[known] + below[known]) / 2
            under = self._height(rays[known], middle, surface) < 0
            below[known] = np.where(under, middle, below[known])
            above[known] = np.where(under, above[known], middle)
        return (above + below) / 2

    def _height(self, rays: np.ndarray, depth: np.ndarray, surface: Surface) -> np.ndarray:
        """How far points along rays are above the surface; NaN outside the grid."""
        points = self.lsl_from_pair.translation_m + rays * depth[:, None]
        east_north = np.column_stack([points[:, 1], points[:, 0], np.ones(len(points))])
        column, row = self.cell_from_east_north @ east_north.T
        i, j = np.floor(row).astype(int), np.floor(column).astype(int)
        _, rows, columns = self.nodes.shape
        inside = (i >= 0) & (j >= 0) & (i < rows) & (j < columns)
        corners = self.nodes[:, i.clip(0, rows - 1), j.clip(0, columns - 1)]
        return np.where(inside, -points[:, 2] - surface(corners, row - i, column - j), np.nan)


def _bilinear(corners: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
    upper = corners[0] * (1 - across) + corners[1] * across
    lower = corners[2] * (1 - across) + corners[3] * across
    return upper * (1 - down) + lower * down


def evaluated_pairs(folder: Path, sol: int, instrument: str) -> Iterator[EvaluatedPair]:
    """The pairs of one instrument ("NAVCAM", "PANCAM") at the stop of a sol."""
    files = sorted((folder / f"sol{sol:04d}" / "edr").glob(f"?{instrument[0].lower()}*.img"))
    reads = {r.image.id: r for r in (read_image(f.read_bytes(), f.name) for f in files)}
    for pair in find_stereo_pairs([r.image for r in reads.values()]).pairs:
        left, right = reads[pair.left.id], reads[pair.right.id]
        images = resample_pair(left, right, pair_geometry(left.image, right.image))
        pose = true_pose(folder, left.image) @ images.geometry.rover_from_pair
        yield EvaluatedPair(pair.id, images, pose, *_grid(folder / "truth" / "dtm.tif"))


@cache
def _grid(path: Path) -> tuple[np.ndarray, np.ndarray]:
    with rasterio.open(path) as file:
        nodes, inverse = file.read(1).astype(np.float64), ~file.transform
    corners = np.stack([nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]])
    to_cell = np.array([[*inverse[:3]], [*inverse[3:6]]])
    to_cell[:, 2] -= 0.5  # nodes are the centres of the raster's cells
    return corners, to_cell


def true_pose(folder: Path, image: RoverImage) -> Pose:
    """Rover to LSL with the mast-pointing error of the label in it, by the camera's true axes."""
    rows = json.loads((folder / "truth" / "truth.json").read_text())["images"]
    true = next(row for row in rows if row["product_id"].upper() == image.id.upper())
    u, _, v = np.linalg.svd(np.array(true["R_cam_to_lsl"]))  # rounded in the file
    reported = image.camera
    assert isinstance(reported, Cahvor)
    ahead = reported.a / np.linalg.norm(reported.a)
    right = reported.h - (ahead @ reported.h) * ahead
    right /= np.linalg.norm(right)
    turn = u @ v @ np.column_stack([ahead, right, np.cross(ahead, right)]).T
    return Pose(LSL, image.stop.frame, turn, np.array(true["C_lsl"]) - turn @ reported.centre)
