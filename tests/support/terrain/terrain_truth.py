"""The terrain models of a store held against the truth of its world.

    python -m tests.support.terrain.terrain_truth STORE DOWNLINK [--true-poses] [--method tin]

Every stop is mapped again from the store's matches, with the poses of its newest network or with
the true ones, and evaluated at every cell against the truth: elevation, and whether some pair saw
it with both eyes. The latter is found by casting a ray from the true ground to every camera.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import rasterio

from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.ground import SightParams
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass, TerrainView
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, Gridding, build_dtm
from solmap.products.catalogue.images import read_product_image
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.images.pairs import PairProducts, pairs_of
from solmap.tasks.network.orientations import Orientation, OrientedPair, read_views
from solmap.tasks.scopes import pair_scope
from tests.support.husband_truth import true_pose

BANDS_M = ((0, 5), (5, 10), (10, 20), (20, 40))
SAMPLE = 4
"""Every how many cells a ray is cast."""
MARCH_M = 0.04
FREE_M = 0.02
"""Ground that rises above a ray by no more does not hide: truth is interpolated."""
OUTSIDE, VISIBLE, HIDDEN = range(3)
TRUTHS = ("outside", "visible", "hidden")


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where cameras and ground truly are."""

    folder: Path
    grid: MapGrid
    elevation: np.ndarray

    @classmethod
    def of(cls, folder: Path) -> Truth:
        """That of a downlink: computed where the world was simulated, else the grid beside it."""
        reported = json.loads((folder / "truth" / "truth.json").read_text())
        with rasterio.open(folder / "truth" / "dtm.tif") as file:
            a = file.transform
            grid = MapGrid(a.c, a.f, a.a, file.height, file.width)
            elevation = file.read(1)
        if "terrain" in reported:
            world = make_world(
                WorldParams(reported["terrain"], TraverseParams(stops=len(reported["stops"]))),
                reported["seed"],
            )
            grid = MapGrid.covering(grid.bounds, 0.04)
            elevation = world.true_elevation(grid)
        return cls(folder, grid, elevation.astype(np.float32))

    def at(self, east: np.ndarray, north: np.ndarray) -> np.ndarray:
        """Elevation, between the nodes bilinear; NaN beyond."""
        col = (np.ravel(east) - self.grid.west) / self.grid.cell_m - 0.5
        row = (self.grid.north - np.ravel(north)) / self.grid.cell_m - 0.5
        width = min(4096, max(1, len(col)))  # no side of a map may have 2^15
        places = np.full((2, -(-len(col) // width) * width), -9.0, dtype=np.float32)
        places[0, : len(col)], places[1, : len(col)] = col, row
        found = cv2.remap(
            self.elevation,
            *places.reshape(2, -1, width),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=np.nan,
        )
        return found.ravel()[: len(col)].reshape(np.shape(east))

    def on(self, grid: MapGrid) -> np.ndarray:
        """Elevation at the cells of a grid."""
        return self.at(*np.meshgrid(*grid.centres()))


@dataclass(frozen=True, slots=True, eq=False)
class StopInTruth:
    """The views of a stop as adjusted, and the same as they truly looked."""

    stop: str
    place: np.ndarray
    """East and north of the rover, adjusted."""
    views: tuple[TerrainView, ...]
    true_views: tuple[TerrainView, ...]


def stops_of(store: Path, truth: Truth) -> Iterator[StopInTruth]:
    """The stops of a store's newest network."""
    workspace = Workspace.open(store)
    networks = workspace.catalogue.pointers(ProductKind.NETWORK)
    network = read_network(max(networks, key=lambda ref: ref.scope.name), workspace.store)
    adjusted = {pair.pair_id: pair for pair in network.adjusted.pairs}
    by_stop: dict[StopId, list[OrientedPair]] = {}
    for mission in workspace.catalogue.missions():
        for files in pairs_of(workspace.catalogue.images(mission.mission)):
            kinds = (ProductKind.MATCHES, ProductKind.PARALLAX)
            scope = pair_scope(files.id)
            refs = [
                ProductRef(kind, scope, digest)
                for kind in kinds
                if (digest := workspace.catalogue.latest(scope.name, kind))
            ]
            if len(refs) == len(kinds) and files.id in adjusted:
                pair = OrientedPair(PairProducts(files, *refs), Orientation.of(adjusted[files.id]))
                by_stop.setdefault(files.stop, []).append(pair)
    for stop, pairs in by_stop.items():
        views = read_views(pairs, workspace.store, sigmas=True)
        images = [read_product_image(p.products.files.left, workspace.store).image for p in pairs]
        true = tuple(
            replace(
                view,
                lsl_from_pair=true_pose(truth.folder, image) @ view.geometry.rover_from_pair,
                covariance=None,
            )
            for view, image in zip(views, images, strict=True)
        )
        north, east, _ = network.adjusted.stop(stop).lsl_from_rover.translation_m
        yield StopInTruth(str(stop), np.array([east, north]), tuple(views), true)


def seen_in_truth(
    truth: Truth, grid: MapGrid, views: tuple[TerrainView, ...], params: SightParams
) -> np.ndarray:
    """Whether each cell lies in a pair's field and reach, and is seen by both of its eyes."""
    east, north = (place.ravel() for place in np.meshgrid(*grid.centres()))
    up = truth.at(east, north)
    points = np.column_stack([north, east, -up])
    seen = np.full(len(points), OUTSIDE)
    for view in views:
        inside = np.flatnonzero(
            (seen != VISIBLE) & np.isfinite(up) & _in_field(view, points, params)
        )
        x = np.array([view.geometry.base_m, 0.0, 0.0])
        eyes = view.lsl_from_pair.apply(np.stack([np.zeros(3), x]))
        free = np.all([_is_free(truth, points[inside], eye) for eye in eyes], axis=0)
        seen[inside] = np.where(free, VISIBLE, HIDDEN)
    return seen.reshape(grid.shape)


def _in_field(view: TerrainView, points: np.ndarray, params: SightParams) -> np.ndarray:
    """Whether both eyes of a pair have points in their images, near enough to be used."""
    geometry = view.geometry
    from_camera = view.lsl_from_pair.inverse.apply(points)
    x, y, z = from_camera.T
    ahead = z > 0.1
    z = np.where(ahead, z, 1.0)
    line = geometry.centre_px[1] + geometry.focal_px * y / z
    sample = geometry.centre_px[0] + geometry.focal_px * x / z
    parallax = geometry.focal_px * geometry.base_m / z
    inside = ahead & (parallax > params.sigma_parallax_px / params.max_relative_sigma)
    inside &= (line >= 0) & (line < geometry.lines - 1) & (sample < geometry.samples - 1)
    inside &= sample - parallax >= 0
    off = points - view.lsl_from_pair.translation_m
    return inside & (np.hypot(off[:, 0], off[:, 1]) < params.radius_m)


def _is_free(truth: Truth, points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Whether no true ground stands between points and an eye (LSL)."""
    way = eye - points
    length = np.linalg.norm(way, axis=1)
    free = np.ones(len(points), dtype=bool)
    at = 2 * MARCH_M
    while len(left := np.flatnonzero(free & (length > at))):
        place = points[left] + way[left] * (at / length[left])[:, None]
        free[left] = ~(truth.at(place[:, 1], place[:, 0]) > -place[:, 2] + FREE_M)
        at += MARCH_M
    return free


@dataclass(slots=True)
class Evaluation:
    """The result of a stop."""

    stop: str
    seconds: float
    bands: list[dict[str, object]] = field(default_factory=list)
    confusion: dict[str, dict[str, int]] = field(default_factory=dict)

    def __str__(self) -> str:
        rows = [f"{self.stop}: {self.seconds} s of processor, {self.completeness:.1%} mapped"]
        rows += [f"    {band}" for band in self.bands]
        return "\n".join([*rows, *(f"    {name:8} {row}" for name, row in self.confusion.items())])

    @property
    def completeness(self) -> float:
        """Share of truly visible ground that is mapped."""
        row = self.confusion["visible"]
        return (row["measured"] + row["interpolated"]) / max(1, sum(row.values()))


def evaluate(
    stop: StopInTruth, truth: Truth, params: DtmParams, *, true_poses: bool = False
) -> tuple[Dtm, Evaluation]:
    """Map a stop and evaluate it."""
    started = time.process_time()
    dtm = build_dtm(stop.true_views if true_poses else stop.views, params)
    evaluated = Evaluation(stop.stop, round(time.process_time() - started, 2))
    error = dtm.elevation - truth.on(dtm.grid)
    east, north = dtm.grid.centres()
    range_m = np.hypot(east[None, :] - stop.place[0], north[:, None] - stop.place[1])
    for low, high in BANDS_M:
        cells = np.isfinite(error) & (range_m >= low) & (range_m < high)
        if cells.any():
            evaluated.bands.append(
                {"range_m": (low, high), **figures(error[cells], dtm.sigma_m[cells])}
            )
    grid, off = dtm.grid, (SAMPLE // 2 - (SAMPLE - 1) / 2) * dtm.grid.cell_m
    sampled = MapGrid(  # whose cells have their centres where those of every fourth have theirs
        grid.west + off,
        grid.north - off,
        grid.cell_m * SAMPLE,
        grid.rows // SAMPLE,
        grid.cols // SAMPLE,
    )
    seen = seen_in_truth(truth, sampled, stop.true_views, params)
    ours = dtm.ground[SAMPLE // 2 :: SAMPLE, SAMPLE // 2 :: SAMPLE]
    known = np.isfinite(truth.on(sampled))
    for number, name in enumerate(TRUTHS):
        evaluated.confusion[name] = {
            ground.name.lower(): int((known & (seen == number) & (ours == ground)).sum())
            for ground in GroundClass
        }
    return dtm, evaluated


def figures(error: np.ndarray, sigma: np.ndarray) -> dict[str, object]:
    """Size of errors and how they compare with their deviations."""
    size = np.abs(error)
    return {
        "cells": len(error),
        "median_m": round(float(np.median(size)), 4),
        "p90_m": round(float(np.percentile(size, 90)), 4),
        "sigma_m": round(float(np.median(sigma)), 4),
        "within": [round(float((size <= k * sigma).mean()), 3) for k in (1, 2, 3)],
    }


def main() -> None:
    """Evaluate all stops of a store and print the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("downlink", type=Path)
    parser.add_argument("--true-poses", action="store_true")
    parser.add_argument("--method", default="grid", help="grid or tin")
    parser.add_argument("--stops", type=int, default=99)
    reported = parser.parse_args()
    truth, params = Truth.of(reported.downlink), DtmParams(method=Gridding(reported.method))
    for stop in islice(stops_of(reported.store, truth), reported.stops):
        evaluated = evaluate(stop, truth, params, true_poses=reported.true_poses)[1]
        print(evaluated, flush=True)  # noqa: T201 - figures are what this makes


if __name__ == "__main__":
    main()
