"""Areas of polygons, and volumes between the ground and a base plane.

With the ground h and the base b at the cells of area a inside a polygon,

    V+ = a sum max(h - b, 0)        V- = a sum max(b - h, 0)        V = V+ - V-

Cells that were not measured get the mean of the others, and the fraction of measured ones is
reported. The variance of V has three parts,

    (A s_p)^2                 the common part of the elevation errors, by poses,
    A a_c mean(s_o^2)         independent errors, common to points within an area a_c,
    j' C j                    the base, where it was fitted: j = (A, A mean e, A mean n).

The volumes above and below have variances of the same form, each for its part of A. A base that was
fitted to the rim of the same model has the same common error as the ground, so that the first part
cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from solmap.photogrammetry.arrays import Flags, Float64, PerPoint, Vector3
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import least_squares_plane_with_cofactors
from solmap.photogrammetry.terrain.dtm.resampling import Elevations, GroundSamples, MapPoints
from solmap.photogrammetry.terrain.relief.slope import CORRELATION_M

LEAST_RIM = 6
"""Points of the rim to which a base is fitted: at least twice its unknowns."""
LEAST_SHARE = 0.5
"""Fraction of the polygon that must be measured."""
MOST_PLACES = 250_000
"""Most points inside a polygon at which the ground is sampled."""


@dataclass(frozen=True, slots=True, eq=False)
class BasePlane:
    """A plane b = p_0 + p_1 (e - e_0) + p_2 (n - n_0)."""

    origin: Float64[np.ndarray, " 2"]
    parameters: Vector3
    covariance: Float64[np.ndarray, "3 3"]
    follows_poses: bool
    """Whether it has the common error of the model's poses, as after a fit to it."""

    @classmethod
    def level(cls, elevation_m: float) -> BasePlane:
        """A level base at an elevation."""
        return cls(
            np.zeros(2), np.array([elevation_m, 0.0, 0.0]), np.zeros((3, 3)), follows_poses=False
        )

    @classmethod
    def fit(cls, places: MapPoints, ground: GroundSamples, spacing_m: float) -> BasePlane:
        """The least-squares plane through the ground at points of a rim, `spacing_m` apart.

        Raises:
            TerrainError: too few of them have an elevation, or they are on a line.
        """
        known = np.isfinite(ground.elevation)
        if known.sum() < LEAST_RIM:
            raise TerrainError(
                f"{known.sum()} points of the rim have an elevation and {LEAST_RIM} are needed: "
                "draw the polygon around measured ground, or give an elevation of the base"
            )
        origin = places[known].mean(axis=0)
        east, north = (places[known] - origin).T
        parameters, cofactors, variance = least_squares_plane_with_cofactors(
            east, north, ground.elevation[known]
        )
        shared = max(1.0, CORRELATION_M / spacing_m)
        return cls(origin, parameters, shared * variance * cofactors, follows_poses=True)

    def elevations(self, places: MapPoints) -> PerPoint:
        """Elevation of the base."""
        return self.parameters[0] + (places - self.origin) @ self.parameters[1:]

    def sigma(self, place: Float64[np.ndarray, " 2"]) -> float:
        """Standard deviation of its elevation at a point, metres."""
        j = np.array([1.0, *(place - self.origin)])
        return float(np.sqrt(max(j @ self.covariance @ j, 0.0)))

    @property
    def slope(self) -> float:
        """Radians."""
        return float(np.arctan(np.hypot(*self.parameters[1:])))

    @property
    def sigma_slope(self) -> float:
        """Standard deviation of the slope, radians; for a level plane in the worst direction."""
        gradient = float(np.hypot(*self.parameters[1:]))
        if gradient == 0.0:
            return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance[1:, 1:])[-1], 0.0)))
        j = self.parameters[1:] / gradient / (1.0 + gradient**2)
        return float(np.sqrt(max(j @ self.covariance[1:, 1:] @ j, 0.0)))


@dataclass(frozen=True, slots=True)
class Volume:
    """Volume between ground and base."""

    above_m3: float
    below_m3: float
    net_m3: float
    sigma_above_m3: float
    sigma_below_m3: float
    sigma_m3: float
    """Standard deviation of the net volume."""
    area_m2: float
    measured_share: float
    highest_m: float
    """Volume of ground above the base."""
    sigma_highest_m: float
    lowest_m: float
    """Volume between base and lower ground, zero or negative."""
    sigma_lowest_m: float


def volume(places: MapPoints, ground: GroundSamples, base: BasePlane, area_m2: float) -> Volume:
    """The volume over `area_m2` of ground sampled at the centres of equal cells.

    Raises:
        TerrainError: too little of the area was measured.
    """
    height = ground.elevation - base.elevations(places)
    known = np.isfinite(height)
    share = float(known.mean())
    if share < LEAST_SHARE:
        raise TerrainError(
            f"{share:.0%} of the polygon was measured and {LEAST_SHARE:.0%} is needed for a volume"
        )
    h = height[known]
    shift = 0.0 if base.follows_poses else float(np.nan_to_num(ground.pose_sigma_m[known]).mean())
    own = float(np.mean(np.nan_to_num(ground.own_sigma_m[known]) ** 2))

    def sigma_of(part: Flags) -> float:
        if not part.any():
            return 0.0
        size = area_m2 * float(part.mean())
        variance = (size * shift) ** 2 + size * CORRELATION_M**2 * own
        centre = places[known][part].mean(axis=0)
        return float(np.sqrt(variance + (size * base.sigma(centre)) ** 2))

    def sigma_at(k: int) -> float:
        sigma = float(np.nan_to_num(ground.own_sigma_m[known][k]))
        return float(np.sqrt(sigma**2 + shift**2 + base.sigma(places[known][k]) ** 2))

    above, below = (area_m2 * float(np.maximum(sign * h, 0.0).mean()) for sign in (1.0, -1.0))
    return Volume(
        above,
        below,
        above - below,
        sigma_of(h > 0.0),
        sigma_of(h < 0.0),
        sigma_of(np.ones(len(h), bool)),
        area_m2,
        share,
        float(h.max()),
        sigma_at(int(h.argmax())),
        float(h.min()),
        sigma_at(int(h.argmin())),
    )


def polygon_of(corners: MapPoints) -> shapely.Polygon:
    """The polygon of a ring of corners, closed or not.

    Raises:
        TerrainError: it crosses itself or has no area.
    """
    polygon = shapely.Polygon(corners)
    if not polygon.is_valid or not polygon.area > 0:
        why = shapely.is_valid_reason(polygon)
        raise TerrainError(
            f"the corners do not form a simple polygon ({why}): draw it without crossing"
        )
    return polygon


def places_inside(
    polygon: shapely.Polygon, cell_m: float, most: int = MOST_PLACES
) -> tuple[MapPoints, float]:
    """Centres of the lattice cells in a polygon, and the cell size: `cell_m` or more.

    The cell is widened where the polygon's box would hold more than `most` of them.

    Raises:
        TerrainError: it contains no centre.
    """
    west, south, east, north = polygon.bounds
    cell = max(cell_m, float(np.sqrt((east - west) * (north - south) / most)))
    across = west + (np.arange(int(np.ceil((east - west) / cell))) + 0.5) * cell
    down = south + (np.arange(int(np.ceil((north - south) / cell))) + 0.5) * cell
    places = np.stack([axis.ravel() for axis in np.meshgrid(across, down)], axis=1)
    inside: Flags = shapely.contains_xy(polygon, places[:, 0], places[:, 1])
    if not inside.any():
        raise TerrainError(
            f"the polygon of {polygon.area:.3g} m2 contains no cell of {cell:.3g} m: draw a "
            "larger one"
        )
    return places[inside], cell


def surface_ratio(places: MapPoints, elevations: Elevations, half_m: float) -> PerPoint:
    """Area of the ground over its area on the map, from its slope over 2 `half_m`; NaN in gaps."""
    squares = np.zeros(len(places))
    for step in half_m * np.eye(2):
        rise = (elevations(places + step) - elevations(places - step)) / (2 * half_m)
        squares += rise**2
    return np.sqrt(1 + squares)
