"""How fast a stop's terrain becomes triangles, a glTF and 3D Tiles, and how few triangles it takes.

Next to ours simplify, on the same points to as many triangles, meshoptimizer and the quadric
decimation that trimesh calls; neither bounds the vertical error, which is measured here.
Both are looked for and skipped where absent: `pip install meshoptimizer fast-simplification`.
"""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.mesh.right_triangles import RightTriangles
from solmap.photogrammetry.terrain.mesh.surface_mesh import (
    ModelParams,
    TerrainMesher,
    TexturedMesh,
    TilesetParams,
    mesh_tiles,
)
from solmap.products.formats.mesh.gltf import Encoding, write_glb

CELL_M, SIDE = 0.04, 1500
"""60 x 60 m in cells of 0.04 m."""


@pytest.fixture(scope="module")
def stop() -> Dtm:
    """Rolling ground with rocks, noise that grows with distance, and the shadows of rocks open."""
    rng = np.random.default_rng(4)
    grid = MapGrid(-30.0, 30.0, CELL_M, SIDE, SIDE)
    east, north = np.meshgrid(*grid.centres())
    distance = np.hypot(east, north)
    up = sum(
        size * amplitude * cv2.GaussianBlur(rng.normal(size=grid.shape), (0, 0), size)
        for size, amplitude in ((120, 2.0), (30, 0.6), (8, 0.15))
    )
    rocks = cv2.GaussianBlur((rng.random(grid.shape) < 2e-4).astype(float), (0, 0), 3)
    up += np.minimum(12 * rocks, 0.3)
    smooth = cv2.GaussianBlur(rng.normal(size=grid.shape), (0, 0), 2)
    up += smooth / smooth.std() * 0.001 * distance
    open_ = (distance < 1.8) | (distance > 29)
    for row, col in np.argwhere(rocks > 0.012)[::25]:  # behind a rock, seen from the middle
        away = np.array([row, col]) - SIDE / 2
        far = np.array([row, col]) + away / max(np.linalg.norm(away), 1) * 30
        line = [(int(col), int(row)), (int(far[1]), int(far[0]))]
        cv2.line(open_ := open_.astype(np.uint8), *line, color=1, thickness=8)
    seen = open_ == 0
    elevation = np.where(seen, up, np.nan).astype(np.float32)
    ground = np.where(seen, GroundClass.MEASURED, GroundClass.UNSEEN).astype(np.uint8)
    ones = np.ones_like(elevation)
    return Dtm(grid, elevation, 0.01 * ones, ones, ground)


def full_mesh(dtm: Dtm) -> tuple[np.ndarray, np.ndarray]:
    """All cells, two triangles to four neighbours: what the peers simplify."""
    known = np.isfinite(dtm.elevation)
    index = np.where(known, np.cumsum(known).reshape(known.shape) - 1, -1)
    nw, ne, sw, se = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    whole = (np.stack([nw, ne, sw, se]) >= 0).all(axis=0)
    nw, ne, sw, se = (corner[whole] for corner in (nw, ne, sw, se))
    triangles = np.concatenate([np.column_stack([nw, sw, se]), np.column_stack([nw, se, ne])])
    east, north = np.meshgrid(*dtm.grid.centres())
    points = np.column_stack([east[known], north[known], dtm.elevation[known]])
    return points.astype(np.float32), triangles.astype(np.uint32)


def vertical_errors(points: np.ndarray, triangles: np.ndarray, dtm: Dtm) -> dict[str, float]:
    """How far places of a mesh are above or below the cells around, metres, and over holes.

    Places are drawn by the triangles' area on the map. Between cells the terrain is interpolated,
    which leaves some millimetres of noise to a mesh that meets every cell.
    """
    rng = np.random.default_rng(1)
    a, b, c = (points[triangles[:, i]].astype(np.float64) for i in range(3))
    area = np.abs(np.cross(b - a, c - a)[:, 2])
    one = rng.choice(len(area), 200_000, p=area / area.sum())
    s, t = rng.random((2, len(one), 1))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    east, north, up = (a[one] + s * (b - a)[one] + t * (c - a)[one]).T
    at = [(dtm.grid.north - north) / CELL_M - 0.5, (east - dtm.grid.west) / CELL_M - 0.5]
    off = np.abs(up - map_coordinates(dtm.elevation, at, order=1, cval=np.nan))
    median, most, nearly_all = np.nanpercentile(off, (50, 99, 99.9)).round(4).tolist()
    over_holes = float(np.isnan(off).mean().round(5))
    return {"50 %": median, "99 %": most, "99.9 %": nearly_all, "over holes": over_holes}


def test_triangles_of_a_stop(benchmark, stop):
    tolerance_m = ModelParams().tolerance_m
    mesh = benchmark(lambda: RightTriangles.of(stop.elevation).mesh(tolerance_m))
    east, north = stop.grid.centres()
    up = stop.elevation[mesh.row, mesh.col]
    points = np.column_stack([east[mesh.col], north[mesh.row], up])
    benchmark.extra_info |= {"triangles": len(mesh), "of": len(full_mesh(stop)[1])}
    benchmark.extra_info |= vertical_errors(points, mesh.triangles, stop)
    assert len(mesh) < benchmark.extra_info["of"] / 5


def test_triangles_of_a_stop_by_meshoptimizer(benchmark, stop):
    peer = pytest.importorskip("meshoptimizer")
    points, triangles = full_mesh(stop)
    count = len(RightTriangles.of(stop.elevation).mesh(ModelParams().tolerance_m))
    made = np.zeros(triangles.size, np.uint32)

    def simplify() -> int:
        return peer.simplify(
            made, triangles.ravel(), points, target_index_count=3 * count, target_error=1.0
        )

    kept = benchmark.pedantic(simplify, rounds=1)
    benchmark.extra_info |= {"triangles": kept // 3}
    benchmark.extra_info |= vertical_errors(points, made[:kept].reshape(-1, 3), stop)


def test_triangles_of_a_stop_by_quadric_decimation(benchmark, stop):
    peer = pytest.importorskip("fast_simplification")
    points, triangles = full_mesh(stop)
    count = len(RightTriangles.of(stop.elevation).mesh(ModelParams().tolerance_m))

    def simplify() -> tuple[np.ndarray, np.ndarray]:
        return peer.simplify(points, triangles.astype(np.int32), target_count=count)

    kept, faces = benchmark.pedantic(simplify, rounds=1)
    benchmark.extra_info |= {"triangles": len(faces)} | vertical_errors(kept, faces, stop)


@pytest.mark.parametrize("encoding", Encoding)
def test_writing_a_stop_as_gltf(benchmark, stop, encoding):
    drawing = TerrainMesher.of(stop)
    surface = drawing.surface(drawing.triangles.mesh(ModelParams().tolerance_m), drawing.bounds)
    texture = np.random.default_rng(2).integers(0, 255, (64, 64), np.uint8)
    mesh = TexturedMesh("stop", surface, cv2.resize(texture, (4096, 4096)))
    if encoding is Encoding.DRACO:
        pytest.importorskip("DracoPy")
    glb = benchmark(lambda: write_glb([mesh], (0.0, 0.0, 0.0), encoding=encoding))
    benchmark.extra_info |= {"triangles": len(surface), "megabytes": round(len(glb) / 1e6, 1)}


def test_cutting_a_stop_into_tiles(benchmark, stop):
    params = TilesetParams()

    def cut() -> list[int]:
        tiles = mesh_tiles(TerrainMesher.of(stop), params)
        return [len(tile.surface(tile.bounds)) for tile in tiles]

    counts = benchmark.pedantic(cut, rounds=3)
    benchmark.extra_info |= {"tiles": len(counts), "triangles": sum(counts)}
    assert len(counts) > 40
