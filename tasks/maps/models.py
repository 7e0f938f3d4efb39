"""Three-dimensional models of a stop: terrain, views of its pairs, dense points; dips of rocks.

Terrain is one glTF binary and 3D Tiles, the views of pairs one glTF with the pairs' own images,
points one PLY and 3D Tiles.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.arrays import EightBits
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.photogrammetry.terrain.measure.facets import Facet, FacetParams, find_facets
from solmap.photogrammetry.terrain.mesh.point_cloud import (
    PointCloud,
    PointCloudParams,
    cloud_tiles,
    point_cloud,
)
from solmap.photogrammetry.terrain.mesh.surface_mesh import (
    MeshTile,
    ModelParams,
    SurfaceMesh,
    TerrainMesher,
    TexturedMesh,
    TilesetParams,
    mesh_tiles,
)
from solmap.photogrammetry.terrain.mesh.view_mesh import ViewModelParams, view_meshes
from solmap.products.crs import LandingPoint
from solmap.products.formats.mesh.gltf import Encoding, write_glb, write_points
from solmap.products.formats.mesh.models import notes_of
from solmap.products.formats.mesh.ply import write_ply
from solmap.products.formats.mesh.tiles3d import TEXELS, TilesetWriter
from solmap.products.formats.raster.orthophoto import read_textures
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.dtms import read_stop_dtm
from solmap.tasks.network.orientations import OrientedPair, inputs_of, read_views
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage

SPACINGS = 5.0
"""Geometric error of a tile, in point spacings: a viewer that allows 16 pixels of error shows
points three pixels apart."""


@stage(task_run_name="model-{dtm.scope}")
def model_terrain(
    dtm: ProductRef,
    orthophoto: ProductRef,
    params: ModelParams,
    tiling: TilesetParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Model a stop's terrain, textured with its orthophoto: one glTF binary, and 3D Tiles.

    The tiles have levels of detail.
    """
    model = Recipe(ProductKind.MODEL, dtm.scope, (dtm, orthophoto), (params, landing))
    tileset = Recipe(ProductKind.TILESET, dtm.scope, (dtm, orthophoto), (tiling, landing))

    @cache
    def mesher() -> TerrainMesher:
        return TerrainMesher.of(read_stop_dtm(dtm, store))

    def write_model(path: Path) -> None:
        places = [mesher().bounds]
        [(texture, bounds)] = read_textures(store.path(orthophoto), places, params.max_texture_px)
        surface = mesher().surface(mesher().triangles.mesh(params.tolerance_m), bounds)
        mesh = TexturedMesh(str(dtm.scope), surface, texture)
        notes = {"tolerance_m": params.tolerance_m, **notes_of(model, landing)}
        origin = origin_near(surface, bounds)
        path.write_bytes(write_glb([mesh], origin, jpeg_quality=params.jpeg_quality, notes=notes))

    def write_tileset(path: Path) -> None:
        tiles = list(mesh_tiles(mesher(), tiling))
        places = [tile.bounds for tile in tiles]
        textures = read_textures(store.path(orthophoto), places, tiling.texture_px)
        with TilesetWriter(path, notes_of(tileset, landing)) as writer:
            for tile, texture in zip(tiles, textures, strict=True):
                _add(writer, tile, *texture, tiling)

    return store.make(model, write_model), store.make(tileset, write_tileset)


def _add(
    writer: TilesetWriter,
    tile: MeshTile,
    texture: EightBits,
    bounds: Bounds,
    params: TilesetParams,
) -> None:
    west, _, east, _ = tile.bounds
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


@stage(task_run_name="view-model-{stop}")
def model_views(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    params: ViewModelParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Model the ground seen by the pairs of a stop, textured with their own images."""
    recipe = _recipe(ProductKind.VIEW_MODEL, stop, pairs, (params, landing))

    def write(path: Path) -> None:
        meshes = view_meshes(read_views(pairs, store, sigmas=False), params)
        middle = np.median(np.concatenate([one.mesh.points for one in meshes]), axis=0)
        east, north, up = (float(round(along)) for along in middle)
        notes = {"tolerance_px": params.tolerance_px, **notes_of(recipe, landing)}
        glb = write_glb(
            meshes,
            (east, north, up),
            encoding=Encoding.DRACO if params.draco else Encoding.QUANTISED,
            jpeg_quality=params.jpeg_quality,
            notes=notes,
        )
        path.write_bytes(glb)

    return store.make(recipe, write)


@stage(task_run_name="dips-{stop}")
def map_dips(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    params: FacetParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Map strike and dip of the planar facets seen by the pairs of a stop."""

    def write(path: Path) -> None:
        views = read_views(pairs, store, sigmas=True)
        facets = [facet for view in views for facet in find_facets(view, params)]
        write_features(path, [facet_feature(facet) for facet in facets], landing)

    return store.make(_recipe(ProductKind.DIPS, stop, pairs, (params, landing)), write)


def _recipe(
    kind: ProductKind, stop: StopId, pairs: tuple[OrientedPair, ...], params: tuple[object, ...]
) -> Recipe:
    orientations = tuple(pair.orientation for pair in pairs)
    return Recipe(kind, stop_scope(stop), inputs_of(pairs), (*params, orientations))


def facet_feature(facet: Facet) -> Feature:
    """A facet as a point on the map, with the attributes recorded by geologists."""
    found, plane = facet.attitude, facet.plane
    return Feature(
        "Point",
        plane.centre[None, :],
        {
            "strike_deg": _degrees(found.strike),
            "dip_deg": _degrees(found.dip),
            "dip_direction_deg": _degrees(found.dip_direction),
            "sigma_strike_deg": _degrees(found.sigma_strike),
            "sigma_dip_deg": _degrees(found.sigma_dip),
            "length_m": round(facet.length_m, 3),
            "width_m": round(facet.width_m, 3),
            "distance_m": round(facet.distance_m, 2),
            "rms_m": round(plane.rms_m, 4),
            "sigma0": round(plane.sigma0, 2),
            "points": plane.points,
            "pair": facet.pair_id,
        },
    )


def _degrees(radians: float) -> float:
    return round(float(np.degrees(radians)), 2)


@stage(task_run_name="points-{stop}")
def make_points(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    params: PointCloudParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Store the dense points of the pairs of a stop, in one file and as tiles."""
    orientations = tuple(pair.orientation for pair in pairs)
    file, tiles = (
        Recipe(kind, stop_scope(stop), inputs_of(pairs), (params, landing, orientations))
        for kind in (ProductKind.POINTS, ProductKind.POINT_TILES)
    )

    @cache
    def build_cloud() -> PointCloud:
        return point_cloud(read_views(pairs, store, sigmas=True), params)

    def write_file(path: Path) -> None:
        cloud = build_cloud()
        notes = {"unit": "metre", "axes": "east, north, up", "spacing_m": cloud.spacing_m}
        sigma = "standard deviation along the line of sight, by matching alone, metres"
        write_ply(path, cloud, {**notes, "sigma": sigma, **notes_of(file, landing)})

    def write_tiles(path: Path) -> None:
        with TilesetWriter(path, notes_of(tiles, landing), refine="ADD") as writer:
            for tile in cloud_tiles(build_cloud()):
                glb = write_points(tile.cloud)
                writer.add(tile.place, glb, tile.cloud.points, SPACINGS * tile.spacing_m)

    return store.make(file, write_file), store.make(tiles, write_tiles)
