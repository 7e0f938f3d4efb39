"""Projection between map and images of a run of `rendered_husband`, compared with its truth.

    python -m tests.support.terrain.projection_truth STORE TRUTH_FOLDER [points]

Pixels are drawn at random in left Navcam images. With the true poses and the true surface each has
a true place on the ground and true places in the images of other stops; the results of the server's
functions for the pixel are compared with those, in metres, in pixels, and in the standard
deviations that they state. Errors of the surface between nodes of the truth grid (0.1 m) are in all
figures.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solmap.gis_server.analysis.ground import BEST, Ground
from solmap.gis_server.analysis.image_to_ground import ground_at
from solmap.gis_server.analysis.projection import add_visibility, project_into
from solmap.gis_server.rendering.reading import RasterPool
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import range_to_ground
from solmap.photogrammetry.terrain.visibility.viewshed import Sight
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError
from tests.support.husband_truth import _bilinear, _grid, true_pose

FARTHEST_M = 25.0
SIGMA_PX = 0.1


def elevations(folder: Path):
    """The true surface, between the nodes of its grid."""
    nodes, to_cell = _grid(folder / "truth" / "dtm.tif")

    def at(places):
        column, row = to_cell @ np.column_stack([places, np.ones(len(places))]).T
        i, j = np.floor(row).astype(int), np.floor(column).astype(int)
        _, rows, columns = nodes.shape
        inside = (i >= 0) & (j >= 0) & (i < rows) & (j < columns)
        corners = nodes[:, i.clip(0, rows - 1), j.clip(0, columns - 1)]
        return np.where(inside, _bilinear(corners, row - i, column - j), np.nan)

    return at


def evaluate(store: Path, folder: Path, points: int) -> dict[str, np.ndarray]:
    """Errors of `points` pixels: on the ground and in other stops' images."""
    workspace = Workspace.open(store)
    mission = OrientedMission.latest("MER2", workspace)
    layers = workspace.catalogue.layers("MER2")
    ground = Ground.of(layers, BEST, workspace.store, RasterPool())
    entries = [e for e in workspace.catalogue.images("MER2") if e.instrument == "NAVCAM"]
    surface, rng = elevations(folder), np.random.default_rng(5)
    rows: dict[str, list] = {k: [] for k in ("how", "error", "normalised", "px", "ratio", "sight")}
    lefts = [entry for entry in entries if entry.eye == "left"]
    while len(rows["how"]) < points:
        entry = lefts[rng.integers(len(lefts))]
        pixel = rng.uniform([20, 300], [1000, 1000])
        truth = _true_point(entry, pixel, mission, folder, surface)
        if truth is None:
            continue
        found = ground_at(entry, tuple(pixel), SIGMA_PX, mission, ground)
        if found is None:
            continue
        error = found.ground.on_map - MAP_FROM_LSL @ truth
        covariance = found.ground.total_covariance
        rows["how"].append(found.told_by)
        rows["error"].append(np.linalg.norm(error))
        rows["normalised"].append(error @ np.linalg.solve(covariance + 1e-8 * np.eye(3), error))
        others = [e for e in entries if e.stop != entry.stop and e.eye == "left"]
        for other in rng.permutation(np.array(others, object))[:8]:
            _evaluate_in(other, found, truth, (mission, ground, folder, surface), rows)
    return {name: np.array(values) for name, values in rows.items()}


def _evaluate_in(other, found, truth, world, rows) -> None:
    mission, ground, folder, surface = world
    try:
        seen = project_into(other, found.ground, mission)
    except ProductError:
        return
    if seen is None:
        return
    record = mission.record(other)
    camera = record.camera.transform(true_pose(folder, record))
    at = camera.project(truth[None])[0]
    off = seen.point - at
    turn = np.array([np.cos(seen.ellipse.angle), np.sin(seen.ellipse.angle)])
    along, across = off @ turn, off @ np.array([-turn[1], turn[0]])
    square = (along / seen.ellipse.semi_major) ** 2 + (across / seen.ellipse.semi_minor) ** 2
    rows["px"].append(np.linalg.norm(off))
    rows["ratio"].append(square)
    reported = add_visibility([seen], found.ground, mission, ground)[0].sight
    ray = truth - camera.centre
    distance = np.linalg.norm(ray)
    met = range_to_ground(camera.centre, ray / distance, surface, distance + 5.0, 0.02)
    rows["sight"].append((int(reported), 0.0 if met is None else distance - met))


def _true_point(entry, pixel, mission, folder, surface):
    record = mission.record(entry)
    camera = record.camera.transform(true_pose(folder, record))
    ray = camera.rays(pixel[None])[0]
    met = range_to_ground(camera.centre, ray, surface, FARTHEST_M, 0.02)
    return None if met is None else camera.centre + met * ray


def summary(found: dict[str, np.ndarray]) -> Iterator[str]:
    """The figures, a line each; what theory expects stands in brackets."""
    for how in ("parallax", "terrain"):
        some = found["how"] == how
        if some.any():
            error, square = found["error"][some], found["normalised"][some]
            yield (
                f"{how}: {some.sum()} pixels, median {np.median(error):.3f} m, 90 % "
                f"{np.percentile(error, 90):.3f} m; chi2 of 3: median {np.median(square):.2f} "
                f"(2.37), within 7.81: {np.mean(square < 7.81):.2f} (0.95)"
            )
    px, ratio = found["px"], found["ratio"]
    yield (
        f"other stops: {len(px)} images, median {np.median(px):.2f} px, 90 % "
        f"{np.percentile(px, 90):.2f} px; chi2 of 2: median {np.median(ratio):.2f} (1.39), "
        f"within 5.99: {np.mean(ratio < 5.99):.2f} (0.95)"
    )
    reported, behind = found["sight"].T
    for sight in Sight:
        some = behind[reported == sight]
        yield (
            f"stated {sight.name}: truly in sight {np.sum(some <= 0.3)}, hidden by ground up to "
            f"1 m before {np.sum((some > 0.3) & (some <= 1))}, farther before {np.sum(some > 1)}"
        )


if __name__ == "__main__":
    requested = int(sys.argv[3]) if len(sys.argv) > 3 else 300
    print("\n".join(summary(evaluate(Path(sys.argv[1]), Path(sys.argv[2]), requested))))  # noqa: T201
