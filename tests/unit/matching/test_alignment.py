import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.matching import alignment
from solmap.photogrammetry.matching.alignment import AlignmentParams, align
from solmap.photogrammetry.matching.records import Ties

FIRST, SECOND = rover_frame(1, 0), rover_frame(1, 8)
MAST = (0.1, 0.0, -1.2)
PRIOR = np.diag([0.01, 0.01, 0.03, 2.0, 2.0, 1.0]) ** 2
SETS = {"a": "NAVCAM", "b": "NAVCAM", "c": "PANCAM", "d": "PANCAM"}


def pair(rover, number, turn, origin=(0.0, 0.0, -1.4)):
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # right, down, forward in the rover
    rotation = Rotation.from_euler("ZY", [turn, -0.2]).as_matrix() @ axes
    frame = Frame(FrameKind.PAIR, (*rover.index, number))
    pose = Pose(rover, frame, rotation, np.array(origin))
    return EpipolarPair(pose, 0.2, 1200.0, (511.5, 511.5), 1024, 1024, MAST)


def network(rng, true, noise=1.0, count=120):
    """Ties of two pairs at each of two stops, measured with noise of the stated sigmas."""
    geometries = {"a": pair(FIRST, 0, 0.0), "b": pair(FIRST, 1, 0.5)}
    geometries |= {"c": pair(SECOND, 0, 0.1), "d": pair(SECOND, 1, 0.7)}
    first = rng.integers(0, 2, count).astype(np.int32)
    second = rng.integers(2, 4, count).astype(np.int32)
    ids = tuple(geometries)
    columns = {name: [] for name in ("l1", "p1", "l2", "p2")}
    for i, j in zip(first, second, strict=True):
        one, other = geometries[ids[i]], geometries[ids[j]]
        left, parallax = rng.uniform(200, 800, (1, 2)), rng.uniform(15, 60, 1)
        rover = one.rover_from_pair.apply(one.triangulate(left, parallax))
        seen, p2 = other.project(other.rover_from_pair.inverse.apply(true.inverse.apply(rover)))
        values = zip(columns.values(), (left[0], parallax[0], seen[0], p2[0]), strict=True)
        for column, value in values:
            column.append(value + noise * 0.2 * rng.normal(size=np.shape(value)))
    sigma = np.full(count, 0.2)
    lefts, parallaxes = [
        [np.array(columns[k]) for k in some] for some in (("l1", "l2"), ("p1", "p2"))
    ]
    ties = Ties(ids, first, second, *lefts, *parallaxes, *[sigma.copy() for _ in range(6)])
    return ties, geometries


@pytest.fixture
def true():
    turn = Rotation.from_euler("ZYX", [0.05, 0.01, -0.02]).as_matrix()
    return Pose(FIRST, SECOND, turn, np.array([-2.0, 0.7, 0.2]))


@pytest.fixture
def start():
    return Pose(FIRST, SECOND, np.eye(3), np.array([-1.0, 0.2, 0.0]))


def test_the_design_matrix_is_the_derivative_of_the_residuals(rng, true, start):
    ties, geometries = network(rng, true, count=12)
    system = alignment._system(ties, geometries, np.arange(4), [*SETS.values()])
    x = rng.normal(0, 1e-3, 20)
    # rotation vectors are turned one after the other: their sum is exact to first order about zero
    x[:3] = 0.0
    x[6:18] = 0.0
    _, design, _ = alignment._linearise(system, x, start, 6)
    step = 1e-6
    for k in range(20):
        ahead, behind = x.copy(), x.copy()
        ahead[k] += step
        behind[k] -= step
        v_ahead = alignment._linearise(system, ahead, start, 6)[0]
        v_behind = alignment._linearise(system, behind, start, 6)[0]
        slope = -(v_ahead - v_behind) / (2 * step)
        np.testing.assert_allclose(design[:, :, k], slope, rtol=1e-4, atol=1e-4)


def test_exact_ties_give_the_exact_pose(rng, true, start):
    ties, geometries = network(rng, true, noise=0.0)
    found = align(ties, geometries, start, np.diag([0.1] * 3 + [10.0] * 3), AlignmentParams())
    np.testing.assert_allclose(
        found.first_from_second.translation_m, true.translation_m, atol=2e-3
    )  # the priors, of some metres and of pointing, pull by a millimetre
    assert found.agrees.all()


def test_noise_of_the_stated_size_gives_a_sigma0_of_one(rng, true, start):
    ties, geometries = network(rng, true, count=400)
    found = align(ties, geometries, start, PRIOR, AlignmentParams())
    assert found.sigma0 == pytest.approx(1.0, abs=0.1)
    assert found.agrees.mean() > 0.95


def test_a_third_of_wrong_ties_is_set_aside(rng, true, start):
    ties, geometries = network(rng, true, count=150)
    wrong = np.arange(150) % 3 == 0
    ties.second_left[wrong] += rng.uniform(20, 60, (50, 2)) * rng.choice([-1, 1], (50, 2))
    found = align(ties, geometries, start, PRIOR, AlignmentParams())
    assert found.agrees[wrong].mean() < 0.05
    assert found.agrees[~wrong].mean() > 0.95
    error_m = np.linalg.norm(found.first_from_second.translation_m - true.translation_m)
    assert error_m < 0.05


def test_a_wrong_toe_in_rejects_no_ties_where_it_is_unknown(rng, true):
    ties, geometries = network(rng, true, count=400)
    before = align(ties, geometries, true, None, AlignmentParams(), SETS).agrees
    u = (ties.second_left[:, 0] - ties.second_parallax_px - 511.5) / 1200
    ties.second_parallax_px[:] += 1200 * 0.6e-3 * (1 + u**2)
    known, unknown = (
        align(ties, geometries, true, None, AlignmentParams(), sets) for sets in (None, SETS)
    )
    assert known.agrees.mean() < 0.5
    np.testing.assert_array_equal(unknown.agrees, before)


@pytest.mark.usefixtures("unchecked")
def test_the_covariance_of_the_pose_is_that_of_its_errors(true, start):
    misfits = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        ties, geometries = network(rng, true, count=60)
        found = align(ties, geometries, start, PRIOR, AlignmentParams())
        shift = true.translation_m - found.first_from_second.translation_m
        misfits.append(shift @ np.linalg.solve(found.covariance[3:, 3:], shift) / 3)
    # the labels here point exactly, while the covariance allows for 0.15 degrees: below one
    assert 0.01 < np.mean(misfits) < 1.2


def panorama(count=10):
    """Pairs of one stop, each overlapping the next; cameras 0.1 to 0.3 m from the mast."""
    arm = np.array([0.15, -0.1, -0.15])
    turns = [Rotation.from_rotvec([0, 0, 2 * np.pi * k / count]) for k in range(count)]
    return [pair(FIRST, k, t.as_rotvec()[2], MAST + t.apply(arm)) for k, t in enumerate(turns)]


def neighbours(rng, pairs, count=40):
    """Exact ties of every pair with the next."""
    rows = []
    for k, one in enumerate(pairs):
        other, left = pairs[(k + 1) % len(pairs)], rng.uniform(0, 1023, (60 * count, 2))
        parallax = rng.uniform(15, 60, len(left))
        rover = one.rover_from_pair.apply(one.triangulate(left, parallax))
        seen, p2 = other.project(other.rover_from_pair.inverse.apply(rover))
        found = np.flatnonzero(other.shows(seen))[:count]
        number = np.full(len(found), k)
        rows.append((number, (number + 1) % len(pairs), left[found], seen[found],
                     parallax[found], p2[found]))  # fmt: skip
    first, second, *measured = (np.concatenate(column) for column in zip(*rows, strict=True))
    ids = tuple(str(k) for k in range(len(pairs)))
    first, second = first.astype(np.int32), second.astype(np.int32)
    sigma = [np.full(len(first), 0.2) for _ in range(6)]
    return Ties(ids, first, second, *measured, *sigma)


def test_pointing_errors_of_a_panorama_are_found_up_to_their_mean(rng):
    true = panorama()
    ties = neighbours(rng, true)
    errors = rng.normal(0, np.radians(0.1), (len(true), 3))  # in the rover frame
    labels = [
        p.turn(p.rover_from_pair.rotation.T @ turn @ p.rover_from_pair.rotation)
        for p, turn in zip(true, Rotation.from_rotvec(errors).as_matrix(), strict=True)
    ]
    rest = Pose.identity(FIRST, FIRST)
    found = align(
        ties, dict(zip(ties.pair_ids, labels, strict=True)), rest, None, AlignmentParams()
    )
    left = [
        p.turn(Rotation.from_rotvec(found.pointing[name]).as_matrix()).rover_from_pair.rotation
        @ one.rover_from_pair.rotation.T
        for name, p, one in zip(ties.pair_ids, labels, true, strict=True)
    ]
    turns = np.degrees(Rotation.from_matrix(left).as_rotvec())
    np.testing.assert_allclose(turns, np.degrees([errors.mean(axis=0)] * len(true)), atol=3e-4)


def test_points_behind_a_camera_do_not_agree(rng, true):
    ties, geometries = network(rng, true, count=20)
    beyond = Pose(FIRST, SECOND, np.eye(3), np.array([100.0, 0.0, 0.0]))
    found = align(ties, geometries, beyond, 1e-6 * np.eye(6), AlignmentParams())
    assert not found.agrees.any()
    assert np.isinf(found.mahalanobis2).all()


def test_without_ties_there_is_no_alignment(start):
    with pytest.raises(MatchingError, match="needs at least one tie"):
        align(Ties.none(("a",)), {}, start, PRIOR, AlignmentParams())
