"""Rover maps and orbital images of simulated ground whose true place is known.

    python -m tests.support.orbital_scenes [--scenes 30] [--first-seed 100] [--dtm | --uncontrolled]

A scene is a landscape as `solmap simulate` draws it, seen from orbit under one sun (cells of 0.25
m, noise, its georeference wrong by up to 8 m and 2 degrees) and by a rover under another: what lies
in its line of sight within 30 m of one or two stops, with errors of the elevation that grow
with the square of the range. An uncontrolled image has errors of up to 250 m east and north, 3
degrees and 1 %.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, fields, replace
from typing import Any

import cv2
import numpy as np

from solmap.photogrammetry.orbital.elevations import register_elevations
from solmap.photogrammetry.orbital.records import GroundMap, OrbitalDtm, OrbitalImage, Registration
from solmap.photogrammetry.orbital.registration import register
from solmap.photogrammetry.synthetic.lattice import Window
from solmap.photogrammetry.synthetic.lighting import Sun, ground_radiance
from solmap.photogrammetry.synthetic.orbital import resampled, turn
from solmap.photogrammetry.synthetic.terrain import TERRAINS, Terrain
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

CELL_M = 0.25
HALF_M = 64.0
EYE_M, REACH_M = 1.5, 30.0
LEVEL = 3


@dataclass(frozen=True)
class Scene:
    """A rover's map, an orbital image, and how that must be moved (about the map's centre).

    A point that the image claims at p truly lies at (1 + scale) R p + (east, north).
    """

    name: str
    ground: GroundMap
    image: OrbitalImage
    east_m: float
    north_m: float
    rotation_deg: float
    scale: float = 0.0


def scene(seed: int, *, uncontrolled: bool = False) -> Scene:
    """The scene of a seed."""
    rng = np.random.default_rng(seed)
    kind = sorted(TERRAINS)[seed % len(TERRAINS)]
    terrain = Terrain(seed, kind)
    patch = terrain.patch(Window.around(LEVEL, 0.0, 0.0, HALF_M))
    suns = [Sun(*_sun(rng)) for _ in range(2)]
    cell_m = patch.window.cell_m
    radiance = [ground_radiance(patch.elevation, cell_m, sun) * patch.albedo for sun in suns]
    shift = rng.uniform(-8, 8, 2)
    rotation_deg = float(rng.uniform(-2, 2))
    far, scale = np.zeros(2), 0.0
    if uncontrolled:
        more = np.random.default_rng([seed, 1])
        far, rotation_deg = more.uniform(-250, 250, 2), float(more.uniform(-3, 3))
        scale = float(more.uniform(-0.01, 0.01))
    grid = MapGrid(-40.0, 40.0, CELL_M, 320, 320)
    wide = MapGrid(-60.0, 60.0, CELL_M, 480, 480)
    truth = _resampled(patch.elevation, patch.window, grid)
    seen = _seen(truth, grid, rng)
    east, north = grid.centres()
    range_m = np.hypot(east[None, :], north[:, None])
    noise = cv2.GaussianBlur(rng.normal(size=grid.shape), (0, 0), 2.0) * 7.0
    elevation = np.where(seen, truth + noise * (0.004 + 0.0001 * range_m**2), np.nan)
    own = _resampled(radiance[0], patch.window, grid)
    brightness = np.where(seen, own * (1 + 0.03 * rng.normal(size=grid.shape)), np.nan)
    # The image claims p for what truly lies at c + R (p - c) + t, with c the map's centre (0, 0).
    png = _resampled(radiance[1], patch.window, wide, (rotation_deg, scale), shift)
    png = 60 + 400 * png + rng.normal(0, 3.0, wide.shape)
    return Scene(
        f"{kind}{seed}",
        GroundMap(grid, elevation.astype(np.float32), brightness.astype(np.float32)),
        OrbitalImage(
            replace(wide, west=wide.west + far[0], north=wide.north + far[1]),
            png.astype(np.float32),
        ),
        *(shift - enlarged(rotation_deg, scale) @ far).tolist(),
        rotation_deg,
        scale,
    )


def middle_of(one: Scene) -> Scene:
    """The inner half of a scene: it is registered as surely, in half of the time."""
    return replace(one, ground=_middle(one.ground, 160), image=_middle(one.image, 288))


def _middle(map_: Any, cells: int) -> Any:
    rows, grid = (map_.grid.rows - cells) // 2, map_.grid
    part = np.s_[rows : rows + cells, rows : rows + cells]
    rasters = {f.name: getattr(map_, f.name)[part] for f in fields(map_) if f.name != "grid"}
    west, north = grid.west + rows * grid.cell_m, grid.north - rows * grid.cell_m
    return replace(map_, grid=MapGrid(west, north, grid.cell_m, cells, cells), **rasters)


def enlarged(rotation_deg: float, scale: float) -> np.ndarray:
    """A rotation with a change of scale."""
    return (1 + scale) * turn(rotation_deg)


def place_error(found: Registration, one: Scene | DtmScene) -> np.ndarray:
    """What is wrong of the place of the map's centre in the image: m, m, rad, and of the scale."""
    correction = found.correction
    scale = one.scale if isinstance(one, Scene) else 0.0
    true = -np.linalg.solve(enlarged(one.rotation_deg, scale), [one.east_m, one.north_m])
    off = correction.apply_inverse(np.zeros((1, 2)))[0] - true
    turn = np.radians(correction.rotation_deg - one.rotation_deg)
    return np.array([*off, turn, correction.scale - scale])


@dataclass(frozen=True)
class DtmScene:
    """A rover's map, an orbital terrain model, and how that must be moved and raised."""

    name: str
    ground: GroundMap
    model: OrbitalDtm
    east_m: float
    north_m: float
    rotation_deg: float
    up_m: float


def dtm_scene(seed: int, cell_m: float = 1.0) -> DtmScene:
    """The scene of a seed with an orbital terrain model: smooth, noisy, on another level."""
    rng = np.random.default_rng(seed)
    kind = sorted(TERRAINS)[seed % len(TERRAINS)]
    patch = Terrain(seed, kind).patch(Window.around(LEVEL, 0.0, 0.0, HALF_M))
    shift, rotation_deg = rng.uniform(-8, 8, 2), float(rng.uniform(-2, 2))
    up_m = float(rng.uniform(-2000, 2000))
    cells = int(80 / cell_m)
    grid = MapGrid(-40.0, 40.0, cell_m, cells, cells)
    fine = MapGrid(-40.0, 40.0, CELL_M, 320, 320)
    truth = _resampled(patch.elevation, patch.window, fine)
    seen = _seen(truth, fine, rng)
    east, north = fine.centres()
    range_m = np.hypot(east[None, :], north[:, None])
    noise = cv2.GaussianBlur(rng.normal(size=fine.shape), (0, 0), 2.0) * 7.0
    known = np.where(seen, truth + noise * (0.004 + 0.0001 * range_m**2), np.nan)
    blocks = known.reshape(cells, 320 // cells, cells, 320 // cells)
    share = np.isfinite(blocks).mean(axis=(1, 3))
    with np.errstate(invalid="ignore"):
        mean = np.nansum(blocks, axis=(1, 3)) / np.isfinite(blocks).sum(axis=(1, 3))
    elevation = np.where(share > 0.5, mean, np.nan).astype(np.float32)
    wide = MapGrid(-60.0, 60.0, cell_m, int(120 / cell_m), int(120 / cell_m))
    heights = _resampled(patch.elevation, patch.window, wide, (rotation_deg, 0.0), shift)
    heights = cv2.GaussianBlur(heights, (0, 0), 1.0)  # a stereo matcher's window
    heights += 0.1 * cv2.GaussianBlur(rng.normal(size=wide.shape), (0, 0), 1.5) * 5.3 - up_m
    return DtmScene(
        f"{kind}{seed}",
        GroundMap(grid, elevation, elevation),
        OrbitalDtm(wide, heights.astype(np.float32)),
        float(shift[0]),
        float(shift[1]),
        rotation_deg,
        up_m,
    )


def _sun(rng: np.random.Generator) -> tuple[float, float]:
    return float(rng.uniform(0, 2 * np.pi)), float(np.radians(rng.uniform(25, 65)))


def _resampled(
    nodes: np.ndarray,
    window: Window,
    grid: MapGrid,
    similarity: tuple[float, float] = (0.0, 0.0),
    shift: np.ndarray | tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Mean of the nodes over the cells of a grid that is turned, enlarged and shifted."""
    return resampled(nodes, window, grid, enlarged(*similarity), shift).astype(np.float64)


def _seen(elevation: np.ndarray, grid: MapGrid, rng: np.random.Generator) -> np.ndarray:
    """What lies in the line of sight of one or two stops."""
    seen = np.zeros(grid.shape, bool)
    for stop in range(int(rng.integers(1, 3))):
        place = np.zeros(2) if stop == 0 else rng.uniform(-14, 14, 2)
        row, col = (grid.north - place[1]) / CELL_M, (place[0] - grid.west) / CELL_M
        eye = elevation[int(row), int(col)] + EYE_M
        steps = np.arange(4, int(REACH_M / CELL_M), 0.5)
        for azimuth in np.linspace(0, 2 * np.pi, 1500, endpoint=False):
            r = np.clip((row - steps * np.cos(azimuth)).astype(int), 0, grid.rows - 1)
            q = np.clip((col + steps * np.sin(azimuth)).astype(int), 0, grid.cols - 1)
            tangent = (elevation[r, q] - eye) / (steps * CELL_M)
            open_sky = tangent >= np.maximum.accumulate(tangent) - 1e-3
            seen[r[open_sky], q[open_sky]] = True
    return seen


def main() -> None:
    """Print how well every scene is registered."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--scenes", type=int, default=30)
    arguments.add_argument("--first-seed", type=int, default=100)
    arguments.add_argument("--dtm", action="store_true", help="terrain models rather than images")
    arguments.add_argument("--uncontrolled", action="store_true", help="mosaics off by 250 m")
    given = arguments.parse_args()
    in_sigmas = []
    for seed in range(given.first_seed, given.first_seed + given.scenes):
        one = dtm_scene(seed) if given.dtm else scene(seed, uncontrolled=given.uncontrolled)
        start = time.process_time()
        if isinstance(one, DtmScene):
            found = register_elevations(one.ground, one.model)
        else:
            found = register(one.ground, one.image)
        spent_s = time.process_time() - start
        fit = f"[{found.explained:.2f}, elsewhere {found.runner_up:.2f}] {spent_s:.1f} s\n"
        sys.stdout.write(f"{one.name:12} {_message(found, one)} {fit}")
        if found.correction is not None:
            sigmas = np.sqrt(np.diagonal(found.correction.covariance))
            in_sigmas.append(place_error(found, one) / sigmas)
    squares = np.mean(np.square(in_sigmas), axis=0)
    sys.stdout.write(f"{len(in_sigmas)} found; errors in stated deviations {np.sqrt(squares)}\n")


def _message(found: Registration, one: Scene | DtmScene) -> str:
    if found.correction is None:
        return f"no answer: {found.reason}"
    east, north, turn, scale = place_error(found, one)
    turn = np.degrees(turn)
    sigma_m, sigma_deg = found.correction.sigma_m[0], found.correction.sigma_rotation_deg
    up = ""
    if isinstance(one, DtmScene) and found.correction.up_m is not None:
        up = f", up {found.correction.up_m - one.up_m:+.3f} m ({found.correction.sigma_up_m:.3f})"
    place = f"off {east:+.3f} {north:+.3f} m ({sigma_m:.3f}), {turn:+.4f} deg ({sigma_deg:.4f})"
    return f"{place}, scale {scale:+.4f}{up}"


if __name__ == "__main__":
    main()
