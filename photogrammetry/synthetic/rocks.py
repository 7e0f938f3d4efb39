"""Rocks: how many of which size, where they lie, and the bumps they are.

The number of rocks wider than D in a square metre follows a power law,

    N(D) = N_5 (D / 0.05 m)^-q,        0.05 m <= D <= D_max,

as counted at the landing sites between a few centimetres and a metre (Golombek et al. 2003 give the
exponential that it approximates; q is 2 to 2.5). Rocks are drawn a class of sizes and a block of
ground at a time, every one with a stream of its own, so that windows agree.

A rock is a block with six sides and a tilted top, over an ellipse with the axes a and b: in the
frame of the ellipse, scaled to radius 1, side i stands at the distance d_i in the direction u_i and
leans back with the steepness k_i,

    height = H min over i of (k_i (1 - u_i.p / d_i)),  cut off by the top plane,  never below 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.synthetic.lattice import Nodes, Window, stream_of

SMALLEST_M = 0.05
BLOCK_M = 10.24
"""Side of the block of ground whose rocks are drawn together."""
STREAM = 7
SIDES = 6

Rocks = Float64[np.ndarray, "n 10"]
"""north, east, semi-axes a and b, height (m), azimuth, three phases of its sides, albedo."""


@dataclass(frozen=True, slots=True)
class RockField:
    """The rocks of a landing site."""

    seed: int
    per_m2: float = 1.6
    """Rocks wider than 5 cm in a square metre."""
    exponent: float = 2.1
    largest_m: float = 1.2
    clearings: tuple[tuple[float, float], ...] = ()
    """(north, east) where the rover stands: nothing here that a wheel would not roll over."""
    clearing_m: float = 1.3
    passable_m: float = 0.12

    def within(self, window: Window, narrowest_m: float) -> Rocks:
        """Rocks wider than `narrowest_m` in and around a window, a clearing's left out."""
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
        number = rng.poisson(self.per_m2 * (more - fewer) * BLOCK_M**2)
        place = (np.array([row, col]) + rng.random((number, 2))) * BLOCK_M
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
    return range(int(np.floor(lowest / BLOCK_M)), int(np.floor(highest / BLOCK_M)) + 1)


def raise_rocks(rocks: Rocks, window: Window) -> tuple[Nodes, Nodes]:
    """Height of rocks above the ground, and what they multiply the albedo by, at every node."""
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
