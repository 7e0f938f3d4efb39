"""The ground lit by the sun of one stop: shading and cast shadows, rendered to a texture.

With the unit normal n, the unit vector s towards the sun, the fraction k of skylight and the albedo
w, the radiance of a node is

    L = w (max(n.s, 0) V + k (1 + n_z) / 2),       V = 1 in the sun, 0 in shadow.

For shadows the ground is rotated so that light runs along its rows: with u the distance from the
sun along a row, a node is lit unless an earlier one of its row has a larger z + u tan(elevation), a
running maximum. The shadow of the rover, if included, is that of its boxes (`body`). Detail finer
than the nodes is a texture too: a square of 8.19 m of grains and pebbles of 4 mm and more, lit in
the same way and repeated everywhere; it has no height in the truth.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.synthetic.body import BODY, MAST, entered
from solmap.photogrammetry.synthetic.lattice import Nodes, Window, stream_of
from solmap.photogrammetry.synthetic.terrain import Patch, Terrain, raise_rocks

SKY_LIGHT = 0.22
"""Skylight of the dusty sky, as a fraction of direct sunlight at right angles."""
GRAIN_M = 0.004
GRAINS = 2048
"""Nodes along the side of the square of grains: 8.19 m."""
PENUMBRA_M = 0.01
"""Height over which the sun rises above an edge: its disc is 0.35 degrees wide."""
LAYERS = ((0, 24.0, 27.0), (1, 42.0, 45.0), (3, 120.0, 130.0), (6, 1000.0, 1024.0))
"""Level, reach and half width in metres, from the camera outwards."""
ROVER_SHADOW_M = 12.0
"""Half the side of the square of ground in which the rover's shadow is searched."""
_baking = threading.Lock()


@dataclass(frozen=True, slots=True)
class Sun:
    """Direction of the sun, radians: azimuth clockwise from north, elevation above the horizon."""

    azimuth: float
    elevation: float

    @property
    def direction(self) -> Vector3:
        """(north, east, up) of the unit vector towards the sun."""
        level = np.cos(self.elevation)
        return np.array(
            [
                level * np.cos(self.azimuth),
                level * np.sin(self.azimuth),
                np.sin(self.elevation),
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Ground of one node distance, used up to some distance from the camera."""

    window: Window
    elevation: Nodes
    radiance: Nodes
    reach_m: float


@dataclass(frozen=True, slots=True, eq=False)
class LitGround:
    """Everything visible from a stop: coarser layers outwards, and the grains of the soil."""

    sun: Sun
    layers: tuple[Layer, ...]
    grains: tuple[np.ndarray, ...]
    """Ratio of the radiance by grains at 4, 8 and 16 mm, one more row and column than the
    period."""

    def sky(self, tangent: np.ndarray) -> np.ndarray:
        """Radiance of the sky over the tangent of the elevation: brightest at the horizon."""
        level_ground = np.sin(self.sun.elevation) + SKY_LIGHT
        return level_ground * (0.25 + 0.65 * np.exp(-np.maximum(tangent, 0) / 0.8))


def light_ground(
    terrain: Terrain, north: float, east: float, sun: Sun, rover: Pose | None = None
) -> LitGround:
    """The lit ground around a stop; the last two are cached.

    Args:
        terrain: the ground.
        north: of the stop.
        east: of the stop.
        sun: its direction.
        rover: its true pose in the LSL, if its shadow is to be included.
    """
    with _baking:
        return _light(terrain, north, east, sun, rover)


@lru_cache(maxsize=2)
def _light(terrain: Terrain, north: float, east: float, sun: Sun, rover: Pose | None) -> LitGround:
    layers = []
    for level, reach_m, half_m in LAYERS:
        patch = terrain.patch(Window.around(level, north, east, half_m))
        beside = None if rover is None or level else _beside_shadow(patch, sun, rover)
        radiance = ground_radiance(patch.elevation, patch.window.cell_m, sun, beside)
        radiance *= patch.albedo
        layers.append(Layer(patch.window, patch.elevation, radiance, reach_m))
    return LitGround(sun, tuple(layers), _grains(terrain.seed, sun))


def _beside_shadow(patch: Patch, sun: Sun, rover: Pose) -> Nodes:
    """1 where a node is outside the rover's shadow, 0 inside."""
    window, beside = patch.window, np.ones_like(patch.elevation)
    rows = np.flatnonzero(np.abs(window.north - rover.translation_m[0]) < ROVER_SHADOW_M)
    cols = np.flatnonzero(np.abs(window.east - rover.translation_m[1]) < ROVER_SHADOW_M)
    north, east = np.meshgrid(window.north[rows], window.east[cols], indexing="ij")
    ground = np.column_stack(
        [north.ravel(), east.ravel(), -patch.elevation[np.ix_(rows, cols)].ravel()]
    )
    origins = rover.inverse.apply(ground).astype(np.float32)
    towards = (sun.direction * [1, 1, -1]) @ rover.rotation
    rays = np.tile(towards.astype(np.float32), (len(origins), 1))
    distance, _ = entered(origins, rays, BODY + MAST)
    beside[np.ix_(rows, cols)] = np.isinf(distance).reshape(north.shape)
    return beside


def ground_radiance(
    elevation: Nodes, cell_m: float, sun: Sun, sunlit: Nodes | None = None
) -> Nodes:
    """Radiance of ground of albedo 1; `sunlit` is the fraction transmitted by other objects."""
    to_north, to_east, up = (float(part) for part in sun.direction)
    north: np.ndarray = cv2.Sobel(elevation, cv2.CV_32F, 0, 1, ksize=1, scale=-0.5 / cell_m)
    east: np.ndarray = cv2.Sobel(elevation, cv2.CV_32F, 1, 0, ksize=1, scale=-0.5 / cell_m)
    upright = 1 / np.sqrt(north * north + east * east + 1)  # n = (north, east, 1), not normalised
    north *= np.float32(to_north)
    east *= np.float32(to_east)
    north += east
    north += np.float32(up)
    north *= upright
    np.maximum(north, 0, out=north)
    north *= _sunlit_share(elevation, cell_m, sun)
    if sunlit is not None:
        north *= sunlit
    upright += 1
    upright *= np.float32(SKY_LIGHT / 2)
    north += upright
    return north


def _sunlit_share(elevation: Nodes, cell_m: float, sun: Sun) -> Nodes:
    """Fraction of the sun's disc visible from every node."""
    rows, cols = elevation.shape
    side = int(np.ceil(np.hypot(rows, cols)))
    # Rotated raster: x runs away from the sun, (x, y) = (side - 1) / 2 + turn (col - c, row - r).
    from_sun = np.array([-np.sin(sun.azimuth), -np.cos(sun.azimuth)])  # (col, row)
    turn = np.array([from_sun, [-from_sun[1], from_sun[0]]])
    middle = np.array([(cols - 1) / 2, (rows - 1) / 2])
    shift = (side - 1) / 2 - turn @ middle
    motion = np.column_stack([turn, shift])
    flags = cv2.INTER_LINEAR
    lowest = float(elevation.min()) - 1e3
    turned: np.ndarray = cv2.warpAffine(
        elevation, motion, (side, side), flags=flags, borderMode=cv2.BORDER_CONSTANT,
        borderValue=lowest,
    )  # fmt: skip
    turned += np.arange(side, dtype=np.float32) * np.float32(cell_m * np.tan(sun.elevation))
    below = np.maximum.accumulate(turned, axis=1)
    below -= turned
    back = flags | cv2.WARP_INVERSE_MAP
    seen: np.ndarray = cv2.warpAffine(
        below, motion, (cols, rows), flags=back, borderMode=cv2.BORDER_REPLICATE
    )
    seen *= np.float32(-1 / PENUMBRA_M)
    seen += 1
    return np.clip(seen, 0, 1, out=seen)


@lru_cache(maxsize=2)
def _grain_relief(seed: int) -> tuple[Nodes, Nodes]:
    """Height (m) and albedo of a periodic square of grains and pebbles."""
    rng = stream_of(seed, 11)
    relief = np.zeros((GRAINS, GRAINS), np.float32)
    mottle = np.zeros((GRAINS, GRAINS), np.float32)
    for octave in range(5):
        cells = GRAINS >> octave
        relief += _ring_noise(rng, cells, octave, 0.0005 * 1.6**octave)
        mottle += _ring_noise(rng, cells, octave, 0.05)
    number = 9000
    rocks = np.zeros((number, 10))
    period_m = GRAINS * GRAIN_M
    width = np.minimum(0.008 * rng.uniform(size=number) ** (-1 / 2.3), 0.05)
    rocks[:, :2] = rng.uniform(0.03, period_m - 0.03, (number, 2))
    rocks[:, 2] = width / 2 * rng.uniform(1.0, 1.5, number)
    rocks[:, 3] = width / 2
    rocks[:, 4] = width * rng.uniform(0.2, 0.4, number)
    rocks[:, 5:9] = rng.uniform(0, 2 * np.pi, (number, 4))
    rocks[:, 9] = rng.normal(0.9, 0.15, number)
    bumps, albedo = raise_rocks(rocks, _GrainWindow(0, 0, 0, GRAINS, GRAINS))
    return relief + bumps, np.exp(mottle) * albedo


class _GrainWindow(Window):
    """Nodes 4 mm apart."""

    __slots__ = ()

    @property
    def cell_m(self) -> float:
        return GRAIN_M


def _ring_noise(rng: np.random.Generator, cells: int, octaves: int, sigma: float) -> Nodes:
    """Random numbers on a periodic square, subdivided some octaves."""
    noise: np.ndarray = rng.standard_normal((cells, cells), dtype=np.float32) * np.float32(sigma)
    for _ in range(octaves):
        ringed = cv2.copyMakeBorder(noise, 2, 2, 2, 2, cv2.BORDER_WRAP)
        noise = cv2.pyrUp(ringed)[4:-4, 4:-4]
    return noise


def _grains(seed: int, sun: Sun) -> tuple[np.ndarray, ...]:
    relief, albedo = _grain_relief(seed)
    margin = 64
    ringed = cv2.copyMakeBorder(relief, *(margin,) * 4, cv2.BORDER_WRAP)
    shade = ground_radiance(ringed, GRAIN_M, sun)[margin:-margin, margin:-margin] * albedo
    shade = np.ascontiguousarray(shade / shade.mean())
    levels = []
    for _ in range(3):
        levels.append(cv2.copyMakeBorder(shade, 0, 1, 0, 1, cv2.BORDER_WRAP))
        shade = cv2.resize(shade, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return tuple(levels)
