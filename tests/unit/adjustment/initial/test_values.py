"""Points that single images alone see."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.initial.values import (
    FURTHEST_BASES,
    intersect_rays,
)
from solmap.photogrammetry.adjustment.model.collinearity import Observations, State
from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import StopId, TiePoints

STOP = StopId("MER2", 1, 0)
MAST = (0.0, 0.0, -1.1)
AZIMUTHS = np.radians([0.0, 34.0, 68.0])


def single(number, azimuth):
    """A Navcam eye 10 cm left of the mast's axis."""
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    forward = np.array([np.cos(azimuth), np.sin(azimuth), 0.6])
    forward /= np.linalg.norm(forward)
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    frame = Frame(FrameKind.PAIR, (1, 0, number))
    pose = Pose(STOP.frame, frame, rotation, np.array([0.0, 0.0, -1.25]) - 0.1 * right)
    return EpipolarPair(pose, 1.0, 1200.0, (511.5, 511.5), 1024, 1024, MAST)


def seen_by(geometries, points, rng, sigma=0.1):
    """Tie points of rover points, seen by every image that has them inside."""
    rows = []
    for k, g in enumerate(geometries):
        left, _ = g.project(g.rover_from_pair.inverse.apply(points))
        inside = ((left > 0) & (left < 1023)).all(axis=1)
        rows += [(p, k, *(left[p] + rng.normal(0, sigma, 2))) for p in np.flatnonzero(inside)]
    table = np.array(rows)
    count = np.bincount(table[:, 0].astype(int), minlength=len(points))
    table = table[count[table[:, 0].astype(int)] > 1]
    _, number = np.unique(table[:, 0], return_inverse=True)
    nothing = np.full(len(table), np.nan)
    return TiePoints(
        tuple(f"S{k}" for k in range(len(geometries))),
        number.astype(np.int32),
        table[:, 1].astype(np.int32),
        table[:, 2:4].copy(),
        nothing,
        np.full(len(table), sigma),
        nothing.copy(),
        np.full(len(table), sigma),
    ), points[np.unique(table[:, 0]).astype(int)]


def network(geometries, ties):
    prior = StopPrior(STOP, Pose(LSL, STOP.frame, np.eye(3), np.zeros(3)))
    pairs = (PairGeometry(f"S{k}", STOP, g) for k, g in enumerate(geometries))
    return Network((prior,), tuple(pairs), ties)


@pytest.fixture
def ground(rng):
    azimuth, distance = rng.uniform(-0.3, 1.5, 900), rng.uniform(1.5, 8.0, 900)
    return np.column_stack(
        [distance * np.cos(azimuth), distance * np.sin(azimuth), rng.normal(0.3, 0.05, 900)]
    )


def nowhere(observations):
    points = np.full((observations.points, 3), np.nan)
    return State(np.eye(3)[None], np.zeros((1, 3)), np.zeros((3, 3)), points)


def test_rays_without_errors_meet_at_the_point(ground, rng):
    geometries = [single(k, a) for k, a in enumerate(AZIMUTHS)]
    ties, truth = seen_by(geometries, ground, rng, sigma=1e-9)
    observations = Observations.of(network(geometries, ties))
    placed = intersect_rays(nowhere(observations), observations, np.ones(len(observations), bool))
    np.testing.assert_allclose(placed.points, truth, atol=1e-5)


def test_rays_that_diverge_end_far_away_in_front(ground, rng):
    geometries = [single(k, a) for k, a in enumerate(AZIMUTHS)]
    ties, _ = seen_by(geometries, ground * 300, rng, sigma=1.0)
    observations = Observations.of(network(geometries, ties))
    placed = intersect_rays(nowhere(observations), observations, np.ones(len(observations), bool))
    distance = np.linalg.norm(placed.points, axis=1)
    assert distance.min() > 1.0
    assert distance.max() < 1.1 * FURTHEST_BASES * 0.2
    for g in geometries:
        in_camera = g.rover_from_pair.inverse.apply(placed.points)
        ahead = np.isin(np.arange(len(distance)), ties.point[ties.pair == geometries.index(g)])
        assert (in_camera[ahead, 2] > 0).all()


def test_points_with_known_places_or_one_ray_are_not_recomputed(ground, rng):
    geometries = [single(k, a) for k, a in enumerate(AZIMUTHS)]
    ties, _ = seen_by(geometries, ground, rng)
    observations = Observations.of(network(geometries, ties))
    state = nowhere(observations)
    state.points[3] = (1.0, 2.0, 3.0)
    used = np.ones(len(observations), bool)
    used[np.flatnonzero(observations.point == 5)[0]] = False
    placed = intersect_rays(state, observations, used)
    np.testing.assert_array_equal(placed.points[3], (1.0, 2.0, 3.0))
    assert np.isfinite(placed.points[5]).all() == ((observations.point == 5).sum() > 2)


def test_pointing_errors_of_single_images_are_found_within_their_uncertainty(ground, rng):
    true = [single(k, a) for k, a in enumerate(AZIMUTHS)]
    ties, _ = seen_by(true, ground, rng)
    turns = np.radians(rng.normal(0, 0.1, (3, 3)))
    reported = []
    for g, w in zip(true, turns, strict=True):
        off, pose = Rotation.from_rotvec(-w).as_matrix(), g.rover_from_pair
        place = np.array(MAST) + off @ (pose.translation_m - np.array(MAST))
        reported.append(
            replace(g, rover_from_pair=Pose(pose.target, pose.source, off @ pose.rotation, place))
        )
    adjusted, report = adjust(network(reported, ties), {STOP}, AdjustmentParams())
    assert report.converged
    assert report.sigma0 == pytest.approx(1.0, abs=0.1)
    for k in (1, 2):  # relative to the first: all together only the prior holds
        found = adjusted.pairs[k].pointing - adjusted.pairs[0].pointing
        assert np.degrees(np.abs(found - (turns[k] - turns[0]))).max() < 0.08
    before = np.degrees(np.linalg.norm(turns[1:] - turns[0], axis=1))
    assert before.min() > 0.08
