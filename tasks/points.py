"""The dense points of a stop: one PLY file to hand on, and 3D Tiles of points to look at."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.mesh.point_cloud import (
    PointCloud,
    PointCloudParams,
    cloud_tiles,
    point_cloud,
)
from solmap.products.crs import LandingPoint
from solmap.products.formats.mesh.gltf import write_points
from solmap.products.formats.mesh.models import notes_of
from solmap.products.formats.mesh.ply import write_ply
from solmap.products.formats.mesh.tiles3d import TilesetWriter
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage
from solmap.tasks.views import OrientedPair, inputs_of, read_views

SPACINGS = 5.0
"""Spacings that a tile's geometric error is worth: a viewer that allows 16 pixels of error shows
points three pixels apart."""


@stage(task_run_name="points-{stop}")
def make_points(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    params: PointCloudParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Keep what the pairs of a stop saw as points, in one file and as tiles."""
    orientations = tuple(pair.orientation for pair in pairs)
    file, tiles = (
        Recipe(kind, stop_scope(stop), inputs_of(pairs), (params, landing, orientations))
        for kind in (ProductKind.POINTS, ProductKind.POINT_TILES)
    )

    @cache
    def seen() -> PointCloud:
        return point_cloud(read_views(pairs, store), params)

    def write_file(path: Path) -> None:
        cloud = seen()
        notes = {"unit": "metre", "axes": "east, north, up", "spacing_m": cloud.spacing_m}
        sigma = "standard deviation along the line of sight, by matching alone, metres"
        write_ply(path, cloud, {**notes, "sigma": sigma, **notes_of(file, landing)})

    def write_tiles(path: Path) -> None:
        with TilesetWriter(path, notes_of(tiles, landing), refine="ADD") as writer:
            for tile in cloud_tiles(seen()):
                glb = write_points(tile.cloud)
                writer.add(tile.place, glb, tile.cloud.points, SPACINGS * tile.spacing_m)

    return store.make(file, write_file), store.make(tiles, write_tiles)
