"""The dense stereo points of a stop, with brightness and standard deviation.

Every trusted parallax p of a pair gives a point P on its ray, with the standard deviation along the
ray

    sigma = |P| sigma_p / p

(see `dtm.ground`; the common error by the pair's pose is not included). Pairs overlap and near
ground has far more pixels than necessary, so only the most accurate point of every cube of
`spacing_m` is kept. Levels of detail are made in the same way: level l keeps one point per cube of
2^l spacings, and each point is stored at the coarsest level that keeps it, so that all levels
together are the whole cloud without duplicates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, UInt8
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.ranges import MapCells, Metres, ShareAboveZero
from solmap.photogrammetry.stretching import black_and_white
from solmap.photogrammetry.terrain.dtm.ground import (
    SightParams,
    camera_on_map,
    ground_points,
    trusted_parallax,
)
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.kernels import best_in_cubes
from solmap.photogrammetry.terrain.mesh.surface_mesh import TilePlace

SAMPLED = 37
"""Step in pixels at which the brightness is sampled."""
TILE_SPACINGS = 256
"""Side of a tile in spacings of its level: about ten thousand points on even ground."""


@dataclass(frozen=True, slots=True)
class PointCloudParams(SightParams):
    """Selection of points."""

    spacing_m: Metres = 0.02
    """Side of the cubes with one point each: half a cell of the terrain model."""
    max_relative_sigma: ShareAboveZero = 0.01
    """Largest standard deviation along the view over the distance, as for models of views: 10 m
    with Navcam, 43 m with Pancam."""
    most_points: MapCells = 4_000_000
    """Most points, for which cubes are doubled: 110 MB as PLY."""


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of the ground, one row per point."""

    points: Float64[np.ndarray, "n 3"]
    """East, north and up, metres of the local map."""
    grey: UInt8[np.ndarray, " n"]
    sigma_m: Float32[np.ndarray, " n"]
    """Standard deviation along the line of sight, by matching only."""
    spacing_m: float

    def __len__(self) -> int:
        return len(self.points)

    def part(self, chosen: np.ndarray) -> PointCloud:
        """A selection of the points: by a mask, or by their indices in this order."""
        return PointCloud(
            self.points[chosen], self.grey[chosen], self.sigma_m[chosen], self.spacing_m
        )


@dataclass(frozen=True, slots=True, eq=False)
class CloudTile:
    """The points of one tile of one level."""

    place: TilePlace
    cloud: PointCloud
    spacing_m: float
    """Spacing of the points of its level."""


def point_cloud(views: Sequence[TerrainView], params: PointCloudParams) -> PointCloud:
    """The points of all pairs of a stop, thinned to one per cube.

    Raises:
        TerrainError: no pair has a point near enough.
    """
    sample = np.concatenate([view.image[view.mask][::SAMPLED] for view in views])
    stretch = black_and_white(sample)
    spacing_m = params.spacing_m
    parts: list[PointCloud] = []
    for view in views:
        parts.append(_view_points(view, params, stretch, spacing_m))
        while sum(map(len, parts)) > params.most_points:
            if len(parts) == 1:
                spacing_m *= 2
            parts = [thin(_concatenate(parts), spacing_m)]
    cloud = thin(_concatenate(parts), spacing_m)
    if not len(cloud):
        raise TerrainError(
            f"none of the {len(views)} pairs has a point accurate to "
            f"{params.max_relative_sigma:.1%} of its distance: check the matching, or allow a "
            "larger max_relative_sigma"
        )
    return cloud


def thin(cloud: PointCloud, spacing_m: float) -> PointCloud:
    """The most accurate point of every cube of that side."""
    kept = cloud.part(best_in_cubes(cloud.points, cloud.sigma_m, spacing_m))
    return PointCloud(kept.points, kept.grey, kept.sigma_m, spacing_m)


def cloud_tiles(cloud: PointCloud) -> Iterator[CloudTile]:
    """The cloud as a quadtree of tiles, coarsest first; together they are the whole of it."""
    side_m = TILE_SPACINGS * cloud.spacing_m
    low, high = np.array([(along.min(), along.max()) for along in cloud.points.T[:2]]).T
    south_west = np.floor(low / side_m) * side_m
    levels = int(np.ceil(np.log2(max(1.0, float((high - south_west).max()) / side_m * 1.0001))))
    rest = cloud
    for level in range(levels, -1, -1):
        spacing_m = cloud.spacing_m * 2**level
        left = np.ones(len(rest), np.bool_)
        every = np.arange(len(rest))
        taken = best_in_cubes(rest.points, rest.sigma_m, spacing_m) if level else every
        left[taken] = False
        here, rest = rest.part(taken), rest.part(np.flatnonzero(left))
        col, row = (
            np.floor((here.points[:, axis] - south_west[axis]) / (side_m * 2**level)).astype(int)
            for axis in (0, 1)
        )
        code = col * (int(row.max(initial=0)) + 1) + row
        order = np.argsort(code, kind="stable")
        starts = np.flatnonzero(np.diff(code[order], prepend=-1))
        for inside in np.split(order, starts[1:]) if len(order) else ():
            place = TilePlace(level, int(row[inside[0]]), int(col[inside[0]]))
            yield CloudTile(place, here.part(inside), spacing_m)
        if not len(rest):
            return


def _view_points(
    view: TerrainView, params: PointCloudParams, stretch: tuple[float, float], spacing_m: float
) -> PointCloud:
    """The trusted points of one pair, thinned."""
    parallax = trusted_parallax(view, params)
    planes = ground_points(view, parallax, params)
    at = np.flatnonzero(np.isfinite(planes[0]))
    away = planes.reshape(3, -1).take(at, axis=1)
    given = params.sigma_parallax_px if view.sigma_px is None else view.sigma_px.ravel()[at]
    sigma_px = np.where(np.isfinite(given), given, params.sigma_parallax_px)
    sigma_m = (np.linalg.norm(away, axis=0) * sigma_px / parallax.ravel()[at]).astype(np.float32)
    points = np.ascontiguousarray(away.T, np.float64) + camera_on_map(view.lsl_from_pair)
    best = best_in_cubes(points, sigma_m, spacing_m)
    black, white = stretch
    grey = np.clip((view.image.ravel()[at[best]] - black) * (255 / (white - black)), 0, 255)
    return PointCloud(points[best], np.rint(grey).astype(np.uint8), sigma_m[best], spacing_m)


def _concatenate(clouds: Sequence[PointCloud]) -> PointCloud:
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.grey for cloud in clouds]),
        np.concatenate([cloud.sigma_m for cloud in clouds]),
        clouds[0].spacing_m,
    )
