"""How far orthophotos lie from where the ground truly is, and their views from each other.

    python -m tests.support.terrain.orthophoto_truth [--worlds plains:31 hills:32 crater:33]
    python -m tests.support.terrain.orthophoto_truth --rendered FOLDER --store STORE

Simulated worlds contain the radiance of their ground, which is laid out at the orthophoto's own
cells and matched against it, block by block; the pairs stand where they truly stood. Views of one
stop are rendered one by one and matched where two show the same ground. The rendered traverse has
no true texture: there its images are projected to the true ground from their true poses, and the
orthophotos of a store, with adjusted poses and terrain of their own, are matched against that, and
those of two stops against each other.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.photogrammetry.synthetic.lighting import GRAIN_M, GRAINS, LitGround
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.ground import camera_on_map
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass, TerrainView
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, build_dtm
from solmap.photogrammetry.terrain.orthophoto.rendering import (
    OrthophotoParams,
)
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind
from tests.support.husband_truth import EvaluatedPair, evaluated_pairs
from tests.support.product_readers import read_orthophoto
from tests.support.simulated_stops import SimulatedStop, WorldOfStops, simulated_stop
from tests.support.terrain.orthophotos import render_orthophoto

BANDS_M = ((0, 5), (5, 10), (10, 20), (20, 40))
BLOCK, SEARCH = 128, 12
"""Cells along the side of a matched window, and how far it is searched: 1.28 m, 0.12 m."""
LEAST_SHOWN = 0.95
LEAST_CORRELATION = 0.7
GRAINS_REACH_M = 24.0
"""How far the simulated images have grains."""


@dataclass(frozen=True, slots=True)
class Shift:
    """The offset of a block of one image in another, metres; and its position."""

    east: float
    north: float
    off_east: float
    off_north: float
    correlation: float

    @property
    def length_m(self) -> float:
        """Distance between where ground is shown and where it is."""
        return float(np.hypot(self.off_east, self.off_north))


def shifts(image: np.ndarray, truth: np.ndarray, grid: MapGrid) -> list[Shift]:
    """Where blocks of an image are found in the truth; NaN is not shown in either."""
    found = []
    for row in range(SEARCH, grid.rows - BLOCK - SEARCH, BLOCK):
        for col in range(SEARCH, grid.cols - BLOCK - SEARCH, BLOCK):
            part = image[row : row + BLOCK, col : col + BLOCK]
            around = truth[row - SEARCH : row + BLOCK + SEARCH, col - SEARCH : col + BLOCK + SEARCH]
            if min(np.isfinite(part).mean(), np.isfinite(around).mean()) < LEAST_SHOWN:
                continue
            match = _matched(part, around)
            if match is not None:
                right, down, peak = match
                east = grid.west + (col + BLOCK / 2) * grid.cell_m
                north = grid.north - (row + BLOCK / 2) * grid.cell_m
                off = (-right * grid.cell_m, down * grid.cell_m)
                found.append(Shift(east, north, *off, peak))
    return found


def _matched(part: np.ndarray, around: np.ndarray) -> tuple[float, float, float] | None:
    """(right, down, correlation) of the best place, by a parabola through the peak."""
    kernel, window = _fine(part), _fine(around)
    score = cv2.matchTemplate(window, kernel, cv2.TM_CCOEFF_NORMED)
    _, peak, _, (col, row) = cv2.minMaxLoc(score)
    inside = 0 < col < score.shape[1] - 1 and 0 < row < score.shape[0] - 1
    if peak < LEAST_CORRELATION or not inside:
        return None
    across = _vertex(*score[row, col - 1 : col + 2])
    down = _vertex(*score[row - 1 : row + 2, col])
    return col + across - SEARCH, row + down - SEARCH, float(peak)


def _fine(image: np.ndarray) -> np.ndarray:
    """Without shading that is wider than half a metre, and without single-cell noise."""
    filled = np.where(np.isfinite(image), image, np.nanmean(image)).astype(np.float32)
    return cv2.GaussianBlur(filled, (0, 0), 1.5) - cv2.GaussianBlur(filled, (0, 0), 25)


def _vertex(before: float, middle: float, after: float) -> float:
    curvature = before - 2 * middle + after
    return float(0.5 * (before - after) / curvature) if curvature < 0 else 0.0


def true_radiance(ground: LitGround, grid: MapGrid, centre: np.ndarray) -> np.ndarray:
    """Radiance of the simulated ground at the cells of a grid, as far as its nodes are fine."""
    layer = ground.layers[0]
    east, north = np.meshgrid(*grid.centres())
    row, col = layer.window.nodes_of(north, east)
    how = {"interpolation": cv2.INTER_LINEAR, "borderValue": float("nan")}
    radiance = cv2.remap(layer.radiance, col.astype(np.float32), row.astype(np.float32), **how)
    for_level, step = ground.grains[1], 2 * GRAIN_M
    period = GRAINS / 2
    middle = 0.25  # of a grain twice as wide, from its edge
    at = [np.mod(w / step - middle, period).astype(np.float32) for w in (east, north)]
    radiance *= cv2.remap(for_level, *at, cv2.INTER_LINEAR)
    radiance[np.hypot(east - centre[0], north - centre[1]) > GRAINS_REACH_M] = np.nan
    return radiance


def views_of(stop: SimulatedStop) -> list[TerrainView]:
    """The matched pairs of a simulated stop, standing where they truly stood."""
    world = stop.world.world()
    views = []
    for number, pair in enumerate(stop.matched.pairs):
        shot = world.shot(stop.number, number)
        pose = world.true_lsl_from_label_rover(shot) @ pair.geometry.rover_from_pair
        views.append(
            TerrainView(
                pair_id=pair.pair_id,
                instrument=pair.instrument,
                lsl_from_pair=pose,
                geometry=pair.geometry,
                parallax=pair.parallax,
                image=pair.left,
                mask=pair.left_mask,
            )
        )
    return views


def between_views(dtm: Dtm, views: Sequence[TerrainView]) -> list[Shift]:
    """Shifts between the orthophotos of single views, where two show the same ground."""
    bitmaps = [_alone(dtm, view) for view in views]
    found: list[Shift] = []
    for (one, grid), (other, _) in combinations(bitmaps, 2):
        if (np.isfinite(one) & np.isfinite(other)).sum() > 4 * BLOCK**2:
            found += shifts(one, other, grid)
    return found


def _alone(dtm: Dtm, view: TerrainView) -> tuple[np.ndarray, MapGrid]:
    made = render_orthophoto(dtm, [view], OrthophotoParams())
    return made.brightness, made.grid


def show(title: str, found: Iterable[Shift], centre: np.ndarray) -> None:
    """A line a range band."""
    rows = list(found)
    range_m = np.array([np.hypot(s.east - centre[0], s.north - centre[1]) for s in rows])
    for low, high in BANDS_M:
        here = [s for s, r in zip(rows, range_m, strict=True) if low <= r < high]
        if not here:
            continue
        length = np.array([s.length_m for s in here]) * 100
        bias = np.mean([(s.off_east, s.off_north) for s in here], axis=0) * 100
        line = (
            f"{title:>28} {low:3d}-{high:2d} m  blocks {len(here):5d}",
            f"median {np.median(length):5.2f} cm  90 % {np.percentile(length, 90):5.2f} cm",
            f"mean ({bias[0]:+.2f}, {bias[1]:+.2f}) cm",
            f"correlation {np.median([s.correlation for s in here]):.2f}",
        )
        print("  ".join(line), flush=True)  # noqa: T201 - a table


def evaluate_simulated(terrain: str, seed: int) -> None:
    """One stop of a world, standing where it truly stood."""
    stop = simulated_stop(WorldOfStops(terrain, (9.0, 10.0), seed, stops=1), 0)
    views = views_of(stop)
    dtm = build_dtm(views, DtmParams())
    made = render_orthophoto(dtm, views, OrthophotoParams())
    centre = camera_on_map(views[0].lsl_from_pair)
    truth = true_radiance(stop.world.world().ground(0), made.grid, centre)
    show(f"{terrain}:{seed}", shifts(made.brightness, truth, made.grid), centre)
    show(f"{terrain}:{seed} between views", between_views(dtm, views), centre)


def evaluate_rendered(folder: Path, store: Path) -> None:
    """The orthophotos of a store of the rendered traverse, against its true ground and poses."""
    workspace = Workspace.open(store)
    reported = json.loads((folder / "truth" / "truth.json").read_text())["stops"]
    bitmaps = []
    for row in reported:
        scope = str(StopId("MER2", row["site"], row["drive"]))
        if workspace.catalogue.latest(scope, ProductKind.ORTHOPHOTO) is None:
            continue
        layer = workspace.catalogue.layer(scope, ProductKind.ORTHOPHOTO)
        grid, image = read_orthophoto(workspace.store.path(layer.ref))
        centre = np.array(row["position"])[[1, 0]]
        truth = _laid_on_truth(folder, row["sol"], grid)
        show(scope, shifts(image, truth, grid), centre)
        bitmaps.append((scope, grid, image))
    for (one, grid, image), (other, other_grid, there) in combinations(bitmaps, 2):
        common = on_grid(there, other_grid, grid)
        show(f"{one[-18:]} {other[-9:]}", shifts(image, common, grid), np.zeros(2))


def _laid_on_truth(folder: Path, sol: int, grid: MapGrid) -> np.ndarray:
    """The images of a sol on the true ground, from their true poses, at the cells of a grid."""
    views, nodes = [], None
    for instrument in ("NAVCAM", "PANCAM"):
        for pair in evaluated_pairs(folder, sol, instrument):
            nodes, images = pair, pair.images
            parallax = match_densely(images).parallax_px
            views.append(
                TerrainView(
                    pair_id=pair.name,
                    instrument=instrument,
                    lsl_from_pair=pair.lsl_from_pair,
                    geometry=images.geometry,
                    parallax=parallax,
                    image=images.left,
                    mask=images.left_mask,
                )
            )
    coarse = MapGrid.covering(grid.bounds, 4 * grid.cell_m)
    made = render_orthophoto(_true_dtm(nodes, coarse), views, OrthophotoParams())
    return on_grid(made.brightness, made.grid, grid)


def _true_dtm(pair: EvaluatedPair, grid: MapGrid) -> Dtm:
    """The true ground at the cells of a grid."""
    east, north = np.meshgrid(*grid.centres())
    points = np.stack([east.ravel(), north.ravel(), np.ones(east.size)])
    col, row = (pair.cell_from_east_north @ points).astype(np.float32)
    upper_left = pair.nodes[0].astype(np.float32)
    how = {"interpolation": cv2.INTER_LINEAR, "borderValue": float("nan")}
    elevation = cv2.remap(upper_left, col.reshape(east.shape), row.reshape(east.shape), **how)
    known = np.isfinite(elevation)
    sigma = np.where(known, np.float32(0.01), np.float32(np.nan))
    ground = np.where(known, GroundClass.MEASURED, GroundClass.UNSEEN).astype(np.uint8)
    return Dtm(grid, elevation, sigma, known.astype(np.float32), ground)


def on_grid(image: np.ndarray, own: MapGrid, grid: MapGrid) -> np.ndarray:
    """An image at the cells of another grid of the same lattice; NaN beyond."""
    laid = np.full(grid.shape, np.nan, np.float32)
    row, col = (
        round((grid.north - own.north) / grid.cell_m),
        round((own.west - grid.west) / grid.cell_m),
    )
    top, left = max(0, row), max(0, col)
    bottom, right = min(grid.rows, row + own.rows), min(grid.cols, col + own.cols)
    if bottom > top and right > left:
        laid[top:bottom, left:right] = image[top - row : bottom - row, left - col : right - col]
    return laid


def main() -> None:
    """Read the arguments, evaluate, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="*", default=["plains:31", "hills:32", "crater:33"])
    parser.add_argument("--rendered", type=Path, help="folder of the rendered traverse")
    parser.add_argument("--store", type=Path, help="what a run made of it")
    arguments = parser.parse_args()
    if arguments.rendered:
        evaluate_rendered(arguments.rendered, arguments.store)
        return
    for name in arguments.worlds:
        terrain, seed = name.split(":")
        evaluate_simulated(terrain, int(seed))


if __name__ == "__main__":
    main()
