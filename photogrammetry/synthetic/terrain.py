"""Terrain with known truth: fractal relief, craters with rims, rocks and mottled albedo.

The ground is one function of (north, east): nodes 2 cm apart, bilinear between them. Craters are
added where nodes are 16 cm apart and refined with the relief. With R the radius of a crater,
d its depth below the plain and h its rim,

    z(r) = -d + (d + h) (r / R)^2   inside,        z(r) = h (R / r)^3   outside,

simple craters being d = 0.2 * 2R and h = 0.04 * 2R deep and high when fresh (Melosh 1989), and less
when worn. Elevations are metres above the tangent plane at the LSL origin, up positive.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.synthetic.lattice import (
    Fractal,
    Nodes,
    Window,
    bilinear,
    parent,
    stream_of,
    subdivided,
)
from solmap.photogrammetry.synthetic.rocks import SMALLEST_M, RockField, raise_rocks

CRATER_LEVEL = 3
"""Level (16 cm) at which craters are added."""
MOTTLE = (0.045, -0.12)
"""Standard deviation of the albedo's logarithm added at nodes 1 m apart, and its Hurst exponent:
nearly the same at all scales, a little more at small ones."""
HILL_M, HILL_HURST = 164.0, 1.2
BLOCK_M = 25.6
"""Side of the blocks in which elevations are looked up."""


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
    """What a kind of landscape is like."""

    roughness_m: float
    """Standard deviation of the relief added at nodes 1 m apart."""
    hurst: float
    """How relief grows with distance: below 0.7 rubble, above 0.9 rolling hills."""
    slope: float
    """Regional rise towards the north-east, as a tangent."""
    rocks_per_m2: float
    """Rocks wider than 5 cm."""
    largest_rock_m: float
    craters_per_ha: float
    """Craters wider than 2 m; their number falls with the square of the width."""
    hills_m: float
    """Standard deviation of the relief at nodes 164 m apart; it falls with the power 1.2."""
    large_crater_m: float = 0.0
    """Diameter of a crater beside the traverse, if any."""


TERRAINS = {
    "plains": TerrainType(0.013, 0.72, 0.01, 1.8, 0.9, 6.0, 1.0),
    "hills": TerrainType(0.016, 0.76, 0.07, 1.4, 1.3, 3.0, 9.0),
    "crater": TerrainType(0.014, 0.74, 0.02, 2.4, 1.5, 8.0, 1.5, large_crater_m=34.0),
}


@dataclass(frozen=True, slots=True)
class Patch:
    """The ground at the nodes of a window; between them it is bilinear."""

    window: Window
    elevation: Nodes
    albedo: Nodes

    def elevation_at(self, north: np.ndarray, east: np.ndarray) -> np.ndarray:
        """Elevation of points, metres; NaN outside."""
        return bilinear(self.elevation, *self.window.nodes_of(north, east))


@dataclass(frozen=True, slots=True)
class Terrain:
    """A landscape that is the same whichever part of it is asked for."""

    seed: int
    kind: str = "plains"
    clearings: tuple[tuple[float, float], ...] = ()
    """(north, east) of the rover's stops."""
    datum_m: float = 0.0
    """Taken off every elevation, so that the LSL origin gets elevation 0."""
    craters: tuple[Crater, ...] = field(init=False)

    def __post_init__(self) -> None:
        if self.kind not in TERRAINS:
            raise TerrainError(f"there is no terrain {self.kind!r}: choose from {list(TERRAINS)}")
        object.__setattr__(self, "craters", _dig(self.seed, TERRAINS[self.kind]))

    @property
    def type(self) -> TerrainType:
        """What the landscape is like."""
        return TERRAINS[self.kind]

    @property
    def rocks(self) -> RockField:
        """The rocks that lie about."""
        per_m2, largest_m = self.type.rocks_per_m2, self.type.largest_rock_m
        return RockField(self.seed, per_m2, largest_m=largest_m, clearings=self.clearings)

    def lowered(self, by_m: float) -> Terrain:
        """The same landscape with its datum `by_m` higher."""
        return replace(self, datum_m=self.datum_m + by_m)

    def patch(self, window: Window) -> Patch:
        """Elevation and albedo of a window, rocks included that its nodes can show."""
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
        return self._refined(window, fractal) + plane.astype(np.float32)

    def _refined(self, window: Window, fractal: Fractal) -> Nodes:
        """Relief and craters; below the craters' level both are refined together."""
        if window.level >= CRATER_LEVEL:
            hills = Fractal(self.seed, 3, self.type.hills_m / HILL_M**HILL_HURST, HILL_HURST)
            return fractal.values(window) + hills.values(window) + self._bowls(window)
        fine = subdivided(self._refined(parent(window), fractal), window)
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
        """Elevation of points, metres: the truth that every picture was taken of."""
        north, east = np.broadcast_arrays(np.float64(north), np.float64(east))
        found = np.empty(north.shape)
        blocks = np.floor(np.stack([north, east], axis=-1) / BLOCK_M)
        for block in np.unique(blocks.reshape(-1, 2), axis=0):
            here = (blocks == block).all(axis=-1)
            window = Window.covering(0, north[here], east[here])
            found[here] = self.patch(window).elevation_at(north[here], east[here])
        return found


def _dig(seed: int, kind: TerrainType, half_m: float = 200.0) -> tuple[Crater, ...]:
    rng = stream_of(seed, 5)
    number = rng.poisson(kind.craters_per_ha * (2 * half_m / 100) ** 2)
    places = rng.uniform(-half_m, half_m, (number, 2))
    radii = np.minimum(rng.uniform(size=number) ** -0.5, 12.0)
    wear = rng.uniform(0.2, 0.8, number)
    craters = [
        Crater(float(n), float(e), float(r), float(0.4 * r * w), float(0.08 * r * w))
        for (n, e), r, w in zip(places, radii, wear, strict=True)
    ]
    if kind.large_crater_m:
        r = kind.large_crater_m / 2
        craters.append(Crater(float(rng.uniform(6, 14)), -(r + 9.0), r, 0.26 * r, 0.06 * r))
    return tuple(craters)
