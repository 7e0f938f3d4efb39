"""Models of a stop's terrain in three dimensions: one glTF to hand on, and 3D Tiles to fly over."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solmap.photogrammetry.terrain.mesh.surface_mesh import (
    Bounds,
    DrawnTile,
    ModelParams,
    SurfaceMesh,
    TerrainDrawing,
    TexturedMesh,
    TilesetParams,
    drawn_tiles,
)
from solmap.products.crs import LandingPoint
from solmap.products.formats.mesh.gltf import Encoding, write_glb
from solmap.products.formats.mesh.models import notes_of
from solmap.products.formats.mesh.tiles3d import TEXELS, TilesetWriter
from solmap.products.formats.raster.orthophoto import read_texture
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.stage import stage


@stage(task_run_name="model-{dtm.scope}")
def model_terrain(
    dtm: ProductRef,
    orthophoto: ProductRef,
    params: ModelParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Model a stop's terrain, wearing its orthophoto, as one glTF binary."""
    recipe = Recipe(ProductKind.MODEL, dtm.scope, (dtm, orthophoto), (params, landing))

    def write(path: Path) -> None:
        drawing = TerrainDrawing.of(read_dtm(store.path(dtm)))
        texture, bounds = read_texture(
            store.path(orthophoto), drawing.bounds, params.max_texture_px
        )
        surface = drawing.surface(drawing.triangles.mesh(params.tolerance_m), bounds)
        mesh = TexturedMesh(str(dtm.scope), surface, texture)
        notes = {"tolerance_m": params.tolerance_m, **notes_of(recipe, landing)}
        origin = origin_near(surface, bounds)
        path.write_bytes(write_glb([mesh], origin, jpeg_quality=params.jpeg_quality, notes=notes))

    return store.make(recipe, write)


@stage(task_run_name="tileset-{dtm.scope}")
def tile_terrain(
    dtm: ProductRef,
    orthophoto: ProductRef,
    params: TilesetParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Cut a stop's terrain and orthophoto into 3D Tiles with levels of detail."""
    recipe = Recipe(ProductKind.TILESET, dtm.scope, (dtm, orthophoto), (params, landing))

    def write(path: Path) -> None:
        drawing = TerrainDrawing.of(read_dtm(store.path(dtm)))
        with TilesetWriter(path, notes_of(recipe, landing)) as writer:
            for tile in drawn_tiles(drawing, params):
                _add(writer, tile, store.path(orthophoto), params)

    return store.make(recipe, write)


def _add(writer: TilesetWriter, tile: DrawnTile, orthophoto: Path, params: TilesetParams) -> None:
    west, _, east, _ = tile.bounds
    texture, bounds = read_texture(orthophoto, tile.bounds, params.texture_px)
    surface = tile.surface(bounds)
    glb = write_glb(
        [TexturedMesh("terrain", surface, texture)],
        origin_near(surface, bounds),
        encoding=Encoding.DRACO if params.draco else Encoding.QUANTISED,
        jpeg_quality=params.jpeg_quality,
    )
    texel_m = (east - west) / params.texture_px
    writer.add(tile.place, glb, surface.points, max(tile.tolerance_m, TEXELS * texel_m))


def origin_near(surface: SurfaceMesh, bounds: Bounds) -> tuple[float, float, float]:
    """Whole metres near the middle of a surface."""
    west, south, east, north = bounds
    up = float(np.median(surface.points[:, 2])) if len(surface.points) else 0.0
    return float(round((west + east) / 2)), float(round((south + north) / 2)), float(round(up))
