"""Levels of detail of a terrain model: exact where finest, nested, and without gaps."""

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.mesh.surface_mesh import (
    MeshTile,
    SurfaceMesh,
    TerrainMesher,
    TilePlace,
    TilesetParams,
    mesh_tiles,
)

SIDE = 600


def ripples(east, north):
    return 0.3 * np.sin(east / 2) * np.cos(north / 3) + 0.02 * east


@pytest.fixture(scope="module")
def terrain(scenes) -> Dtm:
    dtm = scenes.dtm_of(ripples, side=SIDE)
    dtm.elevation[100:300, 250:260] = np.nan
    return dtm


@pytest.fixture(scope="module")
def tiles(terrain) -> list[MeshTile]:
    return list(mesh_tiles(TerrainMesher.of(terrain), TilesetParams(tolerance_m=0.02)))


def test_every_tile_has_a_parent_up_to_one_root(tiles):
    places = {tile.place for tile in tiles}
    root = max(places)
    assert root == TilePlace(2, 0, 0)
    assert all(place.parent in places for place in places - {root})


def test_a_tile_lies_inside_its_bounds_and_on_the_terrain(tiles):
    for tile in tiles:
        surface = tile.mesher.surface(tile.grid_mesh, tile.bounds)
        west, south, east, north = tile.bounds
        x, y, up = surface.points.T
        outside = np.maximum.reduce([west - x, x - east, south - y, y - north])
        assert outside.max() < 1e-9
        np.testing.assert_allclose(up, ripples(x, y), atol=1e-6)
        assert (np.abs(surface.texture_at - 0.5) <= 0.5 + 1e-6).all()


def test_normals_are_those_of_the_ground(tiles):
    surface = tiles[0].mesher.surface(tiles[0].grid_mesh, tiles[0].bounds)
    x, y, _ = surface.points.T
    rise_east = 0.15 * np.cos(x / 2) * np.cos(y / 3) + 0.02
    rise_north = -0.1 * np.sin(x / 2) * np.sin(y / 3)
    across = surface.normals[:, :2] / surface.normals[:, 2:]
    np.testing.assert_allclose(across, -np.column_stack([rise_east, rise_north]), atol=0.01)


def test_only_at_the_finest_level_do_holes_keep_their_exact_edge(terrain, tiles):
    whole = np.isfinite(terrain.elevation)
    whole = whole[:-1, :-1] & whole[1:, :-1] & whole[:-1, 1:] & whole[1:, 1:]
    for level in range(3):
        mesher = next(tile.mesher for tile in tiles if tile.place.level == level)
        area = mesher.triangles.whole.sum() * 4**level
        tolerance = 0 if level == 0 else 0.02  # half a square along every edge
        assert area == pytest.approx(whole.sum(), rel=tolerance)


def test_skirts_are_added_at_borders_where_the_ground_continues(tiles):
    tile = next(tile for tile in tiles if tile.place == TilePlace(0, 0, 1))
    plain = tile.mesher.surface(tile.grid_mesh, tile.bounds)
    hung = tile.surface(tile.bounds)
    added = hung.points[len(plain.points) :]
    west, south, east, north = tile.bounds
    on_border = np.isclose(added[:, 0], west) | np.isclose(added[:, 0], east)
    on_border |= np.isclose(added[:, 1], south) | np.isclose(added[:, 1], north)
    assert on_border.all()
    drop = ripples(added[:, 0], added[:, 1]) - added[:, 2]
    np.testing.assert_allclose(drop, tile.tolerance_m, atol=1e-6)
    assert edge_length(hung, tile.bounds[1]) == pytest.approx((256 - 4) * 0.04)  # 4 in the hole


def edge_length(surface: SurfaceMesh, south: float) -> float:
    """Length of a tile's southern border that has a skirt: its area over its depth."""
    a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
    on_border = np.isclose(np.stack([a, b, c])[..., 1], south).all(axis=0)
    area = np.linalg.norm(np.cross(b - a, c - a)[on_border], axis=1).sum() / 2
    return float(area / 0.02)


def test_a_terrain_model_without_surface_is_refused(terrain):
    bare = np.full((20, 20), np.nan, np.float32)
    bare[::2, ::2] = 1.0
    grid = terrain.grid.part(0, 0, 20, 20)
    empty = Dtm(grid, bare, bare, bare, np.zeros((20, 20), np.uint8))
    with pytest.raises(TerrainError, match="20 x 20 cells no four neighbours"):
        TerrainMesher.of(empty)


def test_impossible_parameters_are_refused():
    with pytest.raises(TerrainError, match=r"0\.0 m, 1024 px and 85"):
        TilesetParams(tolerance_m=0.0)
