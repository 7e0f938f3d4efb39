"""Voting for the place of a later stop by pairs of landmarks that may be the same.

Landmarks p of the earlier stop and q of the later one, each in the level plane of its stop, are the
same if p = R(a) q + t. At every azimuth a, every pair of them therefore votes for one place

    t = p - R(a) q,        C_t = C_p + R(a) C_q R(a)' + c^2 I,

C being the covariances of the landmarks (long along the ray: range is what stereo knows least) and
c the cell. A vote is spread over the places as a Gaussian of covariance C_t and unit square sum, so
that every vote adds the same to the variance of the sum S; sharp votes count more than blunt ones.
At the true pose the votes of common landmarks meet, all others lie anywhere. With M the mean of S
and r the votes in a cell in the neighbourhood of a place, S is worth k votes where l are expected,

    k = S M / r,        l = M^2 / r,        z = +-sqrt(2 (k ln(k / l) - k + l)),

z being the signed root of the likelihood ratio of two Poisson counts, as normal as k allows.
Landmarks come in groups, so chance does more than that; z is therefore divided by its own robust
scatter over the gate if that is above 1. This is the exhaustive form of matching constellations (Li
et al. 2007, 2011): no distance between two landmarks is compared, but all sets that agree with a
rigid motion are found, and with three unknowns no sample needs to be drawn. A peak is then settled
by least squares over the pairs that voted for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float64, Int32, Raster
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import SearchGate
from solmap.photogrammetry.ranges import AzimuthStep, CellSize, Metres
from solmap.photogrammetry.robust import robust_sigma

CUT_SIGMAS = 2.5
"""A vote ends here; its weight has fallen to 4 %."""
LEAST_DENSITY = 1e-3
"""Votes in a cell, against division by zero where nobody votes."""
SETTLING_ROUNDS = 4
FARTHEST_STEPS = 2.0
"""Cells, and steps of azimuth, from a peak to where its pairs may move it."""
LEAST_TO_SETTLE = 4
"""Pairs for the three unknowns of a plane motion: 8 equations."""


SEPARATION_M = 1.5
"""Two peaks nearer than this are one."""


@dataclass(frozen=True, slots=True)
class VotingParams:
    """How votes are collected."""

    cell_m: CellSize = 0.2
    azimuth_step: AzimuthStep = 0.0087
    """Radians (0.5 degrees): moves a landmark by a cell at 23 m."""
    around_m: Metres = 2.5
    """Standard deviation of the neighbourhood that tells what chance does."""
    largest_sigma_m: Metres = 1.0
    """Votes that are blunter than this along any direction are not cast."""

    def __post_init__(self) -> None:
        if not 0 < self.cell_m < self.largest_sigma_m < self.around_m or self.azimuth_step <= 0:
            raise MatchingError(
                f"voting needs cell < largest sigma < neighbourhood and steps of azimuth, not "
                f"{self.cell_m}, {self.largest_sigma_m}, {self.around_m} m and {self.azimuth_step}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Things on the ground that can be seen from all sides, in the level frame of a stop."""

    places: Float64[np.ndarray, "n 2"]
    """North and east, metres."""
    covariances: Float64[np.ndarray, "n 2 2"]

    def __len__(self) -> int:
        return len(self.places)


@dataclass(frozen=True, slots=True)
class VotedPlace:
    """A place that many votes meet at."""

    azimuth: float
    north_m: float
    east_m: float
    z: float


def vote_for_places(
    earlier: Landmarks,
    later: Landmarks,
    pairs: Int32[np.ndarray, "n 2"],
    gate: SearchGate,
    most: int,
    params: VotingParams,
) -> list[VotedPlace]:
    """The places of the later stop that most pairs of (earlier, later) landmarks vote for."""
    steps = int(np.ceil(gate.azimuth_reach / params.azimuth_step))
    azimuths = np.arange(-steps, steps + 1) * params.azimuth_step
    reach = int(np.ceil(gate.reach_m / params.cell_m))
    z = np.stack([_significance(earlier, later, pairs, float(a), gate, params) for a in azimuths])
    shift = np.arange(-reach, reach + 1) * params.cell_m
    z[:, np.hypot(shift[:, None], shift[None, :]) > gate.reach_m] = -np.inf
    found: list[VotedPlace] = []
    while len(found) < most:
        k, i, j = (int(v) for v in np.unravel_index(int(np.argmax(z)), z.shape))
        if not z[k, i, j] > 0:
            break
        north, east = gate.north_m + float(shift[i]), gate.east_m + float(shift[j])
        peak = VotedPlace(float(azimuths[k]), north, east, float(z[k, i, j]))
        found.append(_refine_peak(earlier, later, pairs, peak, params))
        near = np.hypot(shift[:, None] - shift[i], shift[None, :] - shift[j])
        z[:, near < SEPARATION_M] = -np.inf
    return found


def _refine_peak(
    earlier: Landmarks,
    later: Landmarks,
    pairs: Int32[np.ndarray, "n 2"],
    peak: VotedPlace,
    params: VotingParams,
) -> VotedPlace:
    """A peak after least squares over the pairs that agree with it.

    It stays where it is if they are too few, or if it would leave the peak's neighbourhood.
    """
    first, second = pairs.T
    p, q = earlier.places[first], later.places[second]
    x = np.array([peak.azimuth, peak.north_m, peak.east_m])
    for _ in range(SETTLING_ROUNDS):
        c, s = np.cos(x[0]), np.sin(x[0])
        turn = np.array([[c, -s], [s, c]])
        turned = q @ turn.T
        off = p - turned - x[1:]
        spread = earlier.covariances[first] + turn @ later.covariances[second] @ turn.T
        weight = np.linalg.inv(spread + np.eye(2) * params.cell_m**2)
        agree = np.einsum("ni,nij,nj->n", off, weight, off) < CUT_SIGMAS**2
        if agree.sum() < LEAST_TO_SETTLE:
            return peak
        design = np.zeros((int(agree.sum()), 2, 3))
        design[:, 0, 0], design[:, 1, 0] = -turned[agree, 1], turned[agree, 0]
        design[:, 0, 1] = design[:, 1, 2] = 1.0
        weighted = np.swapaxes(design, 1, 2) @ weight[agree]
        normal = (weighted @ design).sum(axis=0)
        x = x + np.linalg.solve(normal, (weighted @ off[agree][:, :, None]).sum(axis=0)[:, 0])
    moved = np.hypot(x[1] - peak.north_m, x[2] - peak.east_m)
    turned_by = abs(x[0] - peak.azimuth)
    if moved > FARTHEST_STEPS * params.cell_m or turned_by > FARTHEST_STEPS * params.azimuth_step:
        return peak
    return VotedPlace(float(x[0]), float(x[1]), float(x[2]), peak.z)


def _significance(
    earlier: Landmarks,
    later: Landmarks,
    pairs: Int32[np.ndarray, "n 2"],
    azimuth: float,
    gate: SearchGate,
    params: VotingParams,
) -> Raster:
    """The z of every place of the gate at one azimuth; rows run north, columns east."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    turn = np.array([[c, -s], [s, c]])
    places = later.places @ turn.T
    first, second = pairs.T
    away = earlier.places[first] - places[second] - (gate.north_m, gate.east_m)
    margin = gate.reach_m + CUT_SIGMAS * params.largest_sigma_m
    near = np.abs(away).max(axis=1, initial=0.0) < margin
    covariances = turn @ later.covariances @ turn.T
    spread = earlier.covariances[first[near]] + covariances[second[near]]
    spread += np.eye(2) * params.cell_m**2
    sharp = np.linalg.eigvalsh(spread)[:, 1] < params.largest_sigma_m**2
    # The neighbourhood of places at the rim lies outside of the gate.
    beyond = int(np.ceil(params.around_m / params.cell_m))
    cells = int(np.ceil(gate.reach_m / params.cell_m)) + beyond
    votes, sums = _collect_votes(away[near][sharp], spread[sharp], cells, params.cell_m)
    around = params.around_m / params.cell_m
    inside = slice(beyond, len(sums) - beyond)
    density, mean = (
        np.maximum(local, local[inside, inside].mean(), dtype=np.float32)
        for local in (cv2.GaussianBlur(what, (0, 0), around) for what in (votes, sums))
    )
    z = likelihood_root(sums, mean, np.maximum(density, LEAST_DENSITY))[inside, inside]
    scatter = robust_sigma(z)
    return (z / max(scatter, 1.0)).astype(np.float32)


def likelihood_root(sums: Raster, mean: Raster, density: Raster) -> Raster:
    """The z of sums of votes, given their mean and the density of votes around."""
    expected = np.maximum(mean * mean / density, LEAST_DENSITY)
    counted = np.maximum(sums * mean / density, LEAST_DENSITY)
    ratio = counted * np.log(counted / expected) - counted + expected
    return (np.sign(counted - expected) * np.sqrt(np.maximum(2 * ratio, 0))).astype(np.float32)


def _collect_votes(
    away: Float64[np.ndarray, "n 2"],
    spread: Float64[np.ndarray, "n 2 2"],
    cells: int,
    cell_m: float,
) -> tuple[Raster, Raster]:
    """(number of votes, their sums) on a grid of 2 cells + 1 around the middle of the gate."""
    size = 2 * cells + 1
    at = np.round(away / cell_m).astype(np.int64) + cells
    inside = ((at >= 0) & (at < size)).all(axis=1)
    votes = np.bincount(at[inside] @ (size, 1), minlength=size * size)
    sums = np.zeros(size * size)
    half = np.ceil(CUT_SIGMAS * np.sqrt(np.linalg.eigvalsh(spread)[:, 1]) / cell_m).astype(int)
    for reach in np.unique(half):
        some = half == reach
        index, weight = _vote_kernels(
            away[some] / cell_m, spread[some] / cell_m**2, int(reach), cells
        )
        sums += np.bincount(index, weight, minlength=size * size)
    return (
        votes.reshape(size, size).astype(np.float32),
        sums.reshape(size, size).astype(np.float32),
    )


def _vote_kernels(
    away: Float64[np.ndarray, "n 2"], spread: Float64[np.ndarray, "n 2 2"], reach: int, cells: int
) -> tuple[np.ndarray, np.ndarray]:
    """(flat cell, weight) of Gaussians of unit square sum around votes, in cells."""
    steps = np.arange(-reach, reach + 1)
    around = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(1, -1, 2)
    at = np.round(away)[:, None, :] + around
    off = at - away[:, None, :]
    length2 = np.einsum("nki,nij,nkj->nk", off, np.linalg.inv(spread), off)
    height = (np.pi * np.sqrt(np.linalg.det(spread))) ** -0.5
    weight = np.exp(-0.5 * length2) * height[:, None]
    row, col = (at[..., k].astype(np.int64) + cells for k in (0, 1))
    inside = (row >= 0) & (col >= 0) & (row <= 2 * cells) & (col <= 2 * cells)
    inside &= length2 < CUT_SIGMAS**2
    return (row * (2 * cells + 1) + col)[inside], weight[inside]
