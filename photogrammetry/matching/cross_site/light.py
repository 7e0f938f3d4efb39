"""Illumination of the ground: shading under a given sun, and displacement of shadows by its motion.

With the unit normal n of the ground, the unit vector s towards the sun and the fraction k of
skylight, ground of albedo w has the radiance

    L = w E(s),        E(s) = max(n.s, 0) + k (1 + n_z) / 2,

n_z being the vertical component (Lambert's law; Horn 1981, Proc. IEEE 69, 14-47). A patch imaged
under the sun s is therefore relit for another sun s' by the factor E(s') / E(s), with normals from
the dense surface of its own stop. Under equal suns the factor is 1.

The shadow of a point at height h above the ground is displaced by h a(s), a(s) = -(s_n, s_e) /
s_up. Images of the same relief under two suns are therefore displaced by h (a(s) - a(s')) at most.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, Raster, Vector3
from solmap.photogrammetry.matching.records import MatchedStop

SKY_LIGHT = 0.25
"""k: light of the dusty sky, as a fraction of direct sunlight at right angles."""

LOWEST_SUN = 0.05
"""Least sine of the sun's elevation, which limits the length of shadows."""


def slopes(elevation: Raster, cell_m: float) -> Float32[np.ndarray, "2 rows cols"]:
    """Slope of the ground to north and east, by central differences; row 0 is the northernmost.

    0 where it is unknown: such ground is shaded as if level.
    """
    rise = np.zeros((2, *elevation.shape), np.float32)
    rise[0, 1:-1] = (elevation[:-2] - elevation[2:]) / (2 * cell_m)
    rise[1, :, 1:-1] = (elevation[:, 2:] - elevation[:, :-2]) / (2 * cell_m)
    return np.nan_to_num(rise, nan=0.0, posinf=0.0, neginf=0.0)


def relighting(
    north: Float32[np.ndarray, "*shape"],
    east: Float32[np.ndarray, "*shape"],
    sun: Vector3,
    other: Vector3,
) -> Float32[np.ndarray, "*shape"]:
    """E(other) / E(sun) of ground with these slopes towards north and east."""
    steepness = np.sqrt(1.0 + north**2 + east**2)
    before, after = (
        np.maximum(-north * s[0] - east * s[1] - s[2], 0.0) + SKY_LIGHT * (steepness + 1.0) / 2
        for s in (sun, other)
    )
    return (after / before).astype(np.float32)


def shadow_difference(sun: Vector3, other: Vector3) -> Float64[np.ndarray, " 2"]:
    """a(sun) - a(other): north and east displacement between shadows, per metre of height."""
    one, two = (-s[:2] / max(-s[2], LOWEST_SUN) for s in (sun, other))
    return one - two


def mean_sun(stop: MatchedStop) -> Vector3 | None:
    """Mean of the unit vectors towards the sun, level frame; None if no pair has any."""
    suns = [pair.sun for pair in stop.pairs if pair.sun is not None]
    return np.mean(suns, axis=0) if suns else None


def sun_difference(one: Vector3 | None, other: Vector3 | None) -> float:
    """Half the length of the difference of unit vectors towards two suns, level frame.

    0 for the same direction, 1 for opposite ones, and where one is unknown.
    """
    return 1.0 if one is None or other is None else float(np.linalg.norm(one - other)) / 2
