"""Models of a store's first stop, whose pose is exact, held against the truth of its world.

    python -m tests.support.terrain.model_truth STORE DOWNLINK

Places on the triangles, drawn by their area on the map, and the cells of the terrain model are
compared with the true elevation, in bands of distance from the rover.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from solmap.photogrammetry.terrain.mesh.surface_mesh import (
    ModelParams,
    SurfaceMesh,
    TerrainMesher,
)
from solmap.photogrammetry.terrain.mesh.view_mesh import ViewModelParams, view_meshes
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import ProductKind
from tests.support.terrain.terrain_truth import BANDS_M, Truth, stops_of

PLACES = 200_000


def places_on(meshes: list[SurfaceMesh], rng: np.random.Generator) -> np.ndarray:
    """(east, north, up) of places on meshes, drawn by area on the map."""
    corners = np.concatenate([mesh.points[mesh.triangles] for mesh in meshes])
    a, b, c = np.moveaxis(corners, 1, 0)
    area = np.abs(np.cross(b - a, c - a)[:, 2])
    one = rng.choice(len(area), PLACES, p=area / area.sum())
    s, t = rng.random((2, PLACES, 1))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    return a[one] + s * (b - a)[one] + t * (c - a)[one]


def figures(places: np.ndarray, truth: Truth, rover: np.ndarray) -> str:
    """Median and 90th percentile of the vertical error by distance, centimetres."""
    off = np.abs(places[:, 2] - truth.at(places[:, 0], places[:, 1])) * 100
    away = np.hypot(*(places[:, :2] - rover).T)
    message = []
    for near, far in BANDS_M:
        here = off[(away >= near) & (away < far) & np.isfinite(off)]
        many = len(here) > PLACES // 1000
        message.append("{:.2f} {:.2f}".format(*np.percentile(here, [50, 90])) if many else "-")
    return " | ".join(message)


def main(store: Path, downlink: Path) -> None:
    truth, workspace = Truth.of(downlink), Workspace.open(store)
    rng = np.random.default_rng(1)
    stop = next(iter(stops_of(store, truth)))
    layer = workspace.catalogue.layer(stop.stop, ProductKind.DTM)
    dtm = read_dtm(workspace.store.path(layer.ref))
    row, col = np.nonzero(np.isfinite(dtm.elevation))
    east, north = dtm.grid.centres()
    cells = np.column_stack([east[col], north[row], dtm.elevation[row, col]])
    mesher = TerrainMesher.of(dtm)
    bands = " | ".join(f"{near}-{far} m" for near, far in BANDS_M)
    sys.stdout.write(f"{stop.stop}, cm, 50 and 90 %: {bands}\n")
    sys.stdout.write(f"cells: {figures(cells, truth, stop.place)}\n")
    for tolerance_m in (0.005, ModelParams().tolerance_m, 0.05):
        surface = mesher.surface(mesher.triangles.mesh(tolerance_m), mesher.bounds)
        message = figures(places_on([surface], rng), truth, stop.place)
        sys.stdout.write(f"model, {tolerance_m} m, {len(surface)} triangles: {message}\n")
    seen = [one.mesh for one in view_meshes(stop.views, ViewModelParams())]
    message = figures(places_on(seen, rng), truth, stop.place)
    sys.stdout.write(f"views, {sum(map(len, seen))} triangles: {message}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
