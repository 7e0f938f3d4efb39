"""First places of points that only single images see: where their rays pass nearest each other.

An observation without parallax is a ray, origin o and unit direction u in the LSL. The point X of
two or more rays minimises the sum of its squared distances from them,

    sum_i (I - u_i u_i') (X - o_i) = 0

The images of a panorama stand centimetres apart, so pointing errors of 0.1 degrees make the rays of
far points diverge. What would lie behind the cameras or further than `FURTHEST_BASES` times the
distance between them is put there along the mean direction; points are adjusted by their inverse
depth, so the adjustment finds the way from there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import Observations, State, pair_orientations
from solmap.photogrammetry.arrays import Flags, Float64

FURTHEST_BASES = 1000.0
"""The parallax there is a pixel of a Navcam."""
LEAST_BASE_M = 1e-3
STIFFNESS = 1e-13
"""Keeps parallel rays solvable; they end at the furthest distance."""


def with_rays_intersected(state: State, observations: Observations, used: Flags) -> State:
    """The state with every point placed that has no place but two or more used observations."""
    lost = ~np.isfinite(state.points).all(axis=1)
    rows = np.flatnonzero(used & lost[observations.point])
    count = np.bincount(observations.point[rows], minlength=observations.points)
    rows = rows[count[observations.point[rows]] > 1]
    if not len(rows):
        return state
    origins, rays = _rays(state, observations, rows)
    number, of = np.unique(observations.point[rows], return_inverse=True)
    shape = (len(number), 3)
    centre, mean, reach = np.zeros(shape), np.zeros(shape), np.full(len(number), LEAST_BASE_M)
    np.add.at(centre, of, origins)
    centre /= np.bincount(of)[:, None]
    np.add.at(mean, of, rays)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    np.maximum.at(reach, of, 2.0 * np.linalg.norm(origins - centre[of], axis=1))
    N, n = np.tile(STIFFNESS * np.eye(3), (len(number), 1, 1)), np.zeros(shape)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    np.add.at(N, of, across)
    np.add.at(n, of, (across @ (origins - centre[of])[:, :, None])[:, :, 0])
    away = np.linalg.solve(N, n[:, :, None])[:, :, 0]
    depth, furthest = (away * mean).sum(axis=1), reach * FURTHEST_BASES
    bad = (depth <= 0) | (depth > furthest)
    points = state.points.copy()
    points[number] = centre + np.where(bad[:, None], furthest[:, None] * mean, away)
    return replace(state, points=points)


def _rays(
    state: State, observations: Observations, rows: np.ndarray
) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m 3"]]:
    """Origin and unit direction of some observations, in the LSL."""
    rotations, origins = pair_orientations(state, observations)
    j = observations.pair[rows]
    plane = observations.measured[rows, :2] - observations.centre_px[j]
    rays = np.column_stack([plane / observations.focal_px[j, None], np.ones(len(rows))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return origins[j], (rotations[j] @ rays[:, :, None])[:, :, 0]
