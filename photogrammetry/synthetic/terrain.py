"""Terrain with known truth: fractal relief, craters with rims, rocks and mottled albedo.

The ground is one function of (north, east): nodes 2 cm apart, bilinear between them. Craters are
added where nodes are 16 cm apart and refined with the relief. With R the radius of a crater,
d its depth below the plain and h its rim,

    z(r) = -d + (d + h) (r / R)^2 inside, z(r) = h (R / r)^3 outside,

simple fresh craters having d = 0.2 * 2R and h = 0.04 * 2R (Melosh 1989), and eroded ones less.
Elevations are metres above the tangent plane at the LSL origin, up positive.

The number of rocks wider than D in a square metre follows a power law,

    N(D) = N_5 (D / 0.05 m)^-q,        0.05 m <= D <= D_max,

as counted at the landing sites between a few centimetres and a metre (Golombek et al. 2003 give the
exponential that it approximates; q is 2 to 2.5). Rocks are drawn by class of size and block of
ground, each with its own random stream, so that windows agree.

A rock is a block with six sides and a tilted top, over an ellipse with the axes a and b: in the
frame of the ellipse, scaled to radius 1, side i is at the distance d_i in the direction u_i and has
the steepness k_i,

    height = H min over i of (k_i (1 - u_i.p / d_i)), limited by the top plane, never below 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.synthetic.lattice import (
    Fractal,
    Nodes,
    Window,
    bilinear,
    parent_window,
    stream_of,
    subdivide,
)

SMALLEST_M = 0.05
ROCK_BLOCK_M = 10.24
"""Side of the block of ground whose rocks are drawn together."""
STREAM = 7
SIDES = 6

Rocks = Float64[np.ndarray, "n 10"]
"""north, east, semi-axes a and b, height (m), azimuth, three phases of its sides, albedo."""
CRATER_LEVEL = 3
"""Level (16 cm) at which craters are added."""
MOTTLE = (0.045, -0.12)
"""Standard deviation of the albedo's logarithm added at nodes 1 m apart, and its Hurst exponent:
nearly the same at all scales, a little more at small ones."""
HILL_M, HILL_HURST = 164.0, 1.2
BLOCK_M = 25.6
"""Side of the blocks in which elevations are interpolated."""


@dataclass(frozen=True, slots=True)
class RockField:
    """The rocks of a landing site."""

    seed: int
    per_m2: float = 1.6
    """Rocks wider than 5 cm per square metre."""
    exponent: float = 2.1
    largest_m: float = 1.2
    clearings: tuple[tuple[float, float], ...] = ()
    """(north, east) of the rover's positions: here all rocks are low enough for a wheel."""
    clearing_m: float = 1.3
    passable_m: float = 0.12

    def within(self, window: Window, narrowest_m: float) -> Rocks:
        """Rocks wider than `narrowest_m` in and around a window, except in clearings."""
        reach = self.largest_m
        rows = _blocks(window.north[0] - reach, window.north[-1] + reach)
        cols = _blocks(window.east[0] - reach, window.east[-1] + reach)
        drawn = [
            self._draw(size, row, col)
            for size in self._classes(narrowest_m)
            for row in rows
            for col in cols
        ]
        rocks = np.concatenate([np.empty((0, 10)), *drawn])
        return rocks[self._is_clear(rocks)]

    def _classes(self, narrowest_m: float) -> list[int]:
        sizes = range(int(np.ceil(np.log2(self.largest_m / SMALLEST_M))))
        return [size for size in sizes if SMALLEST_M * 2**size >= narrowest_m * 0.99]

    def _draw(self, size: int, row: int, col: int) -> Rocks:
        rng = stream_of(self.seed, STREAM, size, row, col)
        more, fewer = (2.0 ** (-self.exponent * k) for k in (size, size + 1))
        number = rng.poisson(self.per_m2 * (more - fewer) * ROCK_BLOCK_M**2)
        place = (np.array([row, col]) + rng.random((number, 2))) * ROCK_BLOCK_M
        exceeding = more - rng.random(number) * (more - fewer)
        width = np.minimum(SMALLEST_M * exceeding ** (-1 / self.exponent), self.largest_m)
        longer = rng.uniform(1.0, 1.5, number)
        axes = np.column_stack([width / 2 * longer, width / 2 / longer**0.5])
        height = axes[:, 1] * rng.uniform(0.5, 1.4, number)
        phases = rng.uniform(0, 2 * np.pi, (number, 4))
        albedo = rng.normal(0.82, 0.1, number)
        return np.column_stack([place, axes, height, phases, albedo])

    def _is_clear(self, rocks: Rocks) -> np.ndarray:
        keep = np.ones(len(rocks), bool)
        for north, east in self.clearings:
            near = np.hypot(rocks[:, 0] - north, rocks[:, 1] - east)
            keep &= (near > self.clearing_m + rocks[:, 2]) | (2 * rocks[:, 3] < self.passable_m)
        return keep


def _blocks(lowest: float, highest: float) -> range:
    return range(int(np.floor(lowest / ROCK_BLOCK_M)), int(np.floor(highest / ROCK_BLOCK_M)) + 1)


def raise_rocks(rocks: Rocks, window: Window) -> tuple[Nodes, Nodes]:
    """Height of rocks above the ground, and their factor on the albedo, at every node."""
    relief = np.zeros((window.rows, window.cols), np.float32)
    albedo = np.ones((window.rows, window.cols), np.float32)
    reach = 1.3 * rocks[:, 2]
    row, col = window.nodes_of(rocks[:, 0], rocks[:, 1])
    cells = reach / window.cell_m
    low = np.maximum(np.ceil(np.column_stack([row - cells, col - cells])), 0).astype(int)
    limits = (window.rows, window.cols)
    high = np.minimum(np.floor(np.column_stack([row + cells, col + cells])) + 1, limits).astype(int)
    for rock, (top, left), (bottom, right), i, j in zip(rocks, low, high, row, col, strict=True):
        if bottom <= top or right <= left:
            continue
        north = ((np.arange(top, bottom) - i) * window.cell_m)[:, None]
        east = ((np.arange(left, right) - j) * window.cell_m)[None, :]
        bump = _bump(rock, north, east)
        here = (slice(top, bottom), slice(left, right))
        higher = bump > relief[here]
        relief[here][higher] = bump[higher]
        albedo[here][higher] = rock[9]
    return relief, albedo


def _bump(rock: np.ndarray, north: np.ndarray, east: np.ndarray) -> np.ndarray:
    a, b, height, azimuth, turn, size, lean = rock[2:9]
    along = north * np.cos(azimuth) + east * np.sin(azimuth)
    across = east * np.cos(azimuth) - north * np.sin(azimuth)
    p, q = along / a, across / b
    lowest = 0.85 + 0.35 * (p * np.cos(lean) + q * np.sin(lean))
    for side in range(SIDES):
        angle = side * 2 * np.pi / SIDES + 0.4 * np.sin((side + 2) * turn)
        distance = 0.92 + 0.14 * np.sin((side + 3) * size)
        steepness = 2.2 + 0.9 * np.sin((side + 1) * lean + turn)
        beyond = (p * np.cos(angle) + q * np.sin(angle)) / distance
        lowest = np.minimum(lowest, steepness * (1 - beyond))
    return np.maximum(height * lowest, 0).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Crater:
    """A bowl with a rim."""

    north: float
    east: float
    radius_m: float
    depth_m: float
    rim_m: float


@dataclass(frozen=True, slots=True)
class TerrainType:
    """Parameters of a kind of landscape."""

    roughness_m: float
    """Standard deviation of the relief added at nodes 1 m apart."""
    hurst: float
    """Growth of relief with distance: below 0.7 rubble, above 0.9 rolling hills."""
    slope: float
    """Regional rise towards the north-east, as a tangent."""
    rocks_per_m2: float
    """Rocks wider than 5 cm."""
    largest_rock_m: float
    craters_per_ha: float
    """Craters wider than 2 m; their number decreases with the square of the width."""
    hills_m: float
    """Standard deviation of the relief at nodes 164 m apart; it decreases with the power 1.2."""
    large_crater_m: float = 0.0
    """Diameter of a crater beside the traverse, if any."""


TERRAINS = {
    "plains": TerrainType(0.013, 0.72, 0.01, 1.8, 0.9, 6.0, 1.0),
    "hills": TerrainType(0.016, 0.76, 0.07, 1.4, 1.3, 3.0, 9.0),
    "crater": TerrainType(0.014, 0.74, 0.02, 2.4, 1.5, 8.0, 1.5, large_crater_m=34.0),
}


@dataclass(frozen=True, slots=True)
class Patch:
    """The ground at the nodes of a window; bilinear between them."""

    window: Window
    elevation: Nodes
    albedo: Nodes

    def elevation_at(self, north: np.ndarray, east: np.ndarray) -> np.ndarray:
        """Elevation of points, metres; NaN outside."""
        return bilinear(self.elevation, *self.window.nodes_of(north, east))


@dataclass(frozen=True, slots=True)
class Terrain:
    """A landscape that does not depend on which part of it is computed."""

    seed: int
    kind: str = "plains"
    clearings: tuple[tuple[float, float], ...] = ()
    """(north, east) of the rover's stops."""
    datum_m: float = 0.0
    """Subtracted from every elevation, so that the LSL origin has elevation 0."""
    craters: tuple[Crater, ...] = field(init=False)

    def __post_init__(self) -> None:
        if self.kind not in TERRAINS:
            raise TerrainError(f"there is no terrain {self.kind!r}: choose from {list(TERRAINS)}")
        object.__setattr__(self, "craters", _draw_craters(self.seed, TERRAINS[self.kind]))

    @property
    def type(self) -> TerrainType:
        """Parameters of the landscape."""
        return TERRAINS[self.kind]

    @property
    def rocks(self) -> RockField:
        """The rocks of the landscape."""
        per_m2, largest_m = self.type.rocks_per_m2, self.type.largest_rock_m
        return RockField(self.seed, per_m2, largest_m=largest_m, clearings=self.clearings)

    def lower(self, by_m: float) -> Terrain:
        """The same landscape with a datum `by_m` higher."""
        return replace(self, datum_m=self.datum_m + by_m)

    def patch(self, window: Window) -> Patch:
        """Elevation and albedo of a window, with the rocks that its nodes can resolve."""
        rocks = self.rocks.within(window, max(SMALLEST_M, 3 * window.cell_m))
        relief, albedo = raise_rocks(rocks, window)
        mottle = Fractal(self.seed, 2, *MOTTLE).values(window)
        relief *= np.clip(1 + 1.2 * mottle, 0.6, 1.4)  # weathered faces
        relief += self.soil(window)
        albedo *= np.exp(mottle, out=mottle)
        return Patch(window, relief, albedo)

    def soil(self, window: Window) -> Nodes:
        """Elevation without rocks."""
        fractal = Fractal(self.seed, 1, self.type.roughness_m, self.type.hurst)
        rise = self.type.slope * np.sqrt(0.5)
        plane = rise * (window.north[:, None] + window.east[None, :]) - self.datum_m
        return self._relief(window, fractal) + plane.astype(np.float32)

    def _relief(self, window: Window, fractal: Fractal) -> Nodes:
        """Relief and craters; below the craters' level both are refined together."""
        if window.level >= CRATER_LEVEL:
            hills = Fractal(self.seed, 3, self.type.hills_m / HILL_M**HILL_HURST, HILL_HURST)
            return fractal.values(window) + hills.values(window) + self._bowls(window)
        fine = subdivide(self._relief(parent_window(window), fractal), window)
        return fine + fractal.displacement(window)

    def _bowls(self, window: Window) -> Nodes:
        bowls = np.zeros((window.rows, window.cols), np.float32)
        for crater in self.craters:
            north = (window.north - crater.north)[:, None] / crater.radius_m
            east = (window.east - crater.east)[None, :] / crater.radius_m
            near = (np.abs(north[:, 0]) < 5, np.abs(east[0]) < 5)  # noqa: PLR2004 - rim below 1 %
            if near[0].any() and near[1].any():
                r2 = north[near[0]] ** 2 + east[:, near[1]] ** 2
                inside = -crater.depth_m + (crater.depth_m + crater.rim_m) * r2
                outside = crater.rim_m * np.maximum(r2, 1) ** -1.5
                bowls[np.ix_(*near)] += np.where(r2 < 1, inside, outside).astype(np.float32)
        return bowls

    def elevation(self, north: np.ndarray, east: np.ndarray) -> np.ndarray:
        """Elevation of points, metres: the truth of every image."""
        north, east = np.broadcast_arrays(np.float64(north), np.float64(east))
        found = np.empty(north.shape)
        blocks = np.floor(np.stack([north, east], axis=-1) / BLOCK_M)
        for block in np.unique(blocks.reshape(-1, 2), axis=0):
            here = (blocks == block).all(axis=-1)
            window = Window.covering(0, north[here], east[here])
            found[here] = self.patch(window).elevation_at(north[here], east[here])
        return found


def _draw_craters(seed: int, kind: TerrainType, half_m: float = 200.0) -> tuple[Crater, ...]:
    rng = stream_of(seed, 5)
    number = rng.poisson(kind.craters_per_ha * (2 * half_m / 100) ** 2)
    places = rng.uniform(-half_m, half_m, (number, 2))
    radii = np.minimum(rng.uniform(size=number) ** -0.5, 12.0)
    roundness = rng.uniform(0.2, 0.8, number)
    craters = [
        Crater(float(n), float(e), float(r), float(0.4 * r * w), float(0.08 * r * w))
        for (n, e), r, w in zip(places, radii, roundness, strict=True)
    ]
    if kind.large_crater_m:
        r = kind.large_crater_m / 2
        craters.append(Crater(float(rng.uniform(6, 14)), -(r + 9.0), r, 0.26 * r, 0.06 * r))
    return tuple(craters)
