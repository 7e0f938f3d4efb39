"""What single observations see: a point by its own parallax, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from photogrammetry.adjustment.collinearity import Observations, State, triangulated_in_pair
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.rotations import cross_matrix, rotation_of_vector


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Every observation's own point in its rover frame, with covariance; which may align."""

    points: np.ndarray
    covariances: np.ndarray
    usable: np.ndarray
    size: np.ndarray
    """Sum of the three variances, square metres."""


def sightings(
    observations: Observations, pointings: np.ndarray, params: AdjustmentParams
) -> Sightings:
    """Triangulate every observation by itself in the frame of its rover."""
    j = observations.pair
    in_pair = triangulated_in_pair(observations)
    turned = (rotation_of_vector(pointings) @ observations.rover_from_pair)[j]
    arm = (turned @ in_pair[:, :, None])[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = 1.0 / observations.weight
        along = in_pair / observations.measured[:, 2:] * sigma[:, 2:]
        across = (in_pair[:, 2] * sigma[:, 0] / observations.focal_px[j]) ** 2
    S = along[:, :, None] * along[:, None, :]
    S[:, 0, 0] += across
    S[:, 1, 1] += across
    lever = cross_matrix(arm) * np.radians(params.pointing_deg)
    S = turned @ S @ turned.swapaxes(1, 2) + lever @ lever.swapaxes(1, 2)
    usable = observations.is_stereo & (observations.measured[:, 2] >= params.far_parallax_px)
    size = np.trace(S, axis1=1, axis2=2)
    return Sightings(observations.origins_in_rover(pointings)[j] + arm, S, usable, size)


def best_sightings(observations: Observations, seen: Sightings, stops: int) -> list[np.ndarray]:
    """For each stop its observations that may align, the best one of each point."""
    rows = np.flatnonzero(seen.usable)
    stop, point = observations.stop[rows], observations.point[rows]
    order = np.lexsort((seen.size[rows], point, stop))
    rows, stop, point = rows[order], stop[order], point[order]
    first = np.ones(len(rows), dtype=bool)
    first[1:] = (point[1:] != point[:-1]) | (stop[1:] != stop[:-1])
    ends = np.searchsorted(stop[first], np.arange(stops + 1))
    return [rows[first][a:b] for a, b in pairwise(ends.tolist())]


def with_points(
    state: State, observations: Observations, seen: Sightings, used: np.ndarray
) -> State:
    """The state with every point at the weighted mean of its used sightings; NaN if none can.

    The weights are the inverse covariances of the sightings, so rays of several stops intersect
    here although each sighting alone is poor in range.
    """
    rows = np.flatnonzero(used & observations.is_stereo)
    stop, number = observations.stop[rows], observations.point[rows]
    R = state.rotations[stop]
    place = state.centres[stop] + (R @ seen.points[rows][:, :, None])[:, :, 0]
    P = np.linalg.inv(R @ seen.covariances[rows] @ R.swapaxes(1, 2))
    N, n = np.zeros((observations.points, 3, 3)), np.zeros((observations.points, 3))
    np.add.at(N, number, P)
    np.add.at(n, number, (P @ place[:, :, None])[:, :, 0])
    points = np.full((observations.points, 3), np.nan)
    placed = np.unique(number)
    points[placed] = np.linalg.solve(N[placed], n[placed][:, :, None])[:, :, 0]
    return State(state.rotations, state.centres, state.pointings, points)
