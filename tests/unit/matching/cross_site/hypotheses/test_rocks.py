import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import StereoMatches, StopId
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    BirdsEyeParams,
    SearchGate,
    draw_birds_eye,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.rocks import (
    RockParams,
    find_rocks,
    match_rocks,
    similar_rocks,
)
from solmap.photogrammetry.matching.records import EpipolarImages, MatchedPair, MatchedStop

FOCAL_PX, BASE_M, MAST_M, SIZE = 600.0, 0.3, 1.5, 400
BIRDS_EYE = BirdsEyeParams(radius_m=20.0)
PARAMS = RockParams(farthest_m=18.0)


def strewn(seed, number=70):
    """Rocks on a plain: north, east, width, height."""
    rng = np.random.default_rng(seed)
    places = rng.uniform((-4.0, -9.0), (18.0, 9.0), (number, 2))
    width = rng.uniform(0.25, 0.9, number)
    return np.column_stack([places, width, width * rng.uniform(0.5, 0.9, number)])


def stop_at(rocks, north, east, azimuths, drive=0):
    """A stop on the plain; rocks show every camera an upright face half their width before them."""
    stop = StopId("MER2", 1, drive)
    pose = Pose(LSL, stop.frame, np.eye(3), np.array([north, east, 0.0]))
    pairs = tuple(_pair(stop, rocks, (north, east), k, a) for k, a in enumerate(azimuths))
    return MatchedStop(stop, pairs, pose, np.zeros((6, 6)))


def _pair(stop, rocks, place, number, azimuth, down=0.2):
    c, s = np.cos(azimuth), np.sin(azimuth)
    forward = np.array([np.cos(down) * c, np.cos(down) * s, np.sin(down)])
    right = np.array([-s, c, 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    frame = Frame(FrameKind.PAIR, (stop.site, stop.drive, number))
    pose = Pose(stop.frame, frame, rotation, np.array([0.0, 0.0, -MAST_M]))
    middle = (SIZE - 1) / 2
    geometry = EpipolarPair(pose, BASE_M, FOCAL_PX, (middle, middle), SIZE, SIZE)
    parallax = FOCAL_PX * BASE_M / _depth(rocks, place, rotation)
    parallax[~(parallax > 2)] = np.nan
    grey, mask = np.ones((SIZE, SIZE), np.float32), np.ones((SIZE, SIZE), bool)
    matches = StereoMatches(f"P{number}", np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    images = EpipolarImages(geometry, grey, mask, grey, mask)
    return MatchedPair(f"P{number}", "NAVCAM", images, matches, parallax.astype(np.float32))


def _depth(rocks, place, rotation):
    """Depth of every pixel of a camera at the mast: the plain, or the face of a rock before it."""
    y, x = (np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2) / FOCAL_PX
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ rotation.T
    depth = MAST_M / np.where(rays[..., 2] > 0.01, rays[..., 2], np.nan)
    for north, east, width, height in rocks:
        away = np.array([north, east]) - place
        distance = np.hypot(*away)
        if distance < 2:
            continue
        towards = away / distance
        along, across = rays[..., :2] @ towards, rays[..., :2] @ (-towards[1], towards[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            face = (distance - width / 2) / along
        up = MAST_M - face * rays[..., 2]
        hit = (face > 0) & (np.abs(face * across) < width / 2) & (up > 0) & (up < height)
        depth = np.where(hit & ~(face > depth), face, depth)
    return depth


@pytest.fixture(scope="module")
def field():
    return strewn(3)


def rocks_from(rocks, north, east, azimuths):
    stop = stop_at(rocks, north, east, azimuths)
    return find_rocks(stop, draw_birds_eye(stop, BIRDS_EYE, [BIRDS_EYE.cell_m])[0], PARAMS)


@pytest.fixture(scope="module")
def from_the_south(field):
    return rocks_from(field, 0.0, 0.0, (-0.5, 0.0, 0.5))


@pytest.fixture(scope="module")
def from_the_north(field):
    return rocks_from(field, 14.0, 1.0, (np.pi - 0.5, np.pi, np.pi + 0.5))


def test_rocks_are_found_where_they_lie_and_as_wide_as_they_are(field, from_the_south):
    found = from_the_south
    assert len(found) > 15
    off = np.hypot(*(found.landmarks.places[:, None] - field[None, :, :2]).transpose(2, 0, 1))
    near = off.argmin(axis=1)
    right = off.min(axis=1) < 0.3
    assert right.mean() > 0.8  # the others are hidden in part
    ratio = found.width_m[right] / field[near[right], 2]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)  # edges of the parallax are left out


def test_a_rock_in_two_pairs_is_one(field):
    once = rocks_from(field, 0.0, 0.0, (0.0,))
    twice = rocks_from(field, 0.0, 0.0, (0.0, 0.0))
    assert len(twice) == len(once)


def test_rocks_lie_where_they_lie_from_whichever_side(from_the_south, from_the_north):
    south = from_the_south.landmarks.places
    north = from_the_north.landmarks.places + np.array([14.0, 1.0])
    off = np.hypot(*(south[:, None] - north[None]).transpose(2, 0, 1)).min(axis=1)
    common = off < 0.5
    assert common.sum() >= 6
    assert np.median(off[common]) < 0.2  # faces alone would lie half a metre apart


def test_rocks_find_the_place_of_a_stop_that_looks_back(from_the_south, from_the_north):
    gate = SearchGate(12.8, 2.1, 3.0, 0.05)
    best = match_rocks(from_the_south, from_the_north, gate, 3, PARAMS)[0]
    assert np.hypot(best.north_m - 14.0, best.east_m - 1.0) < 0.2
    assert abs(best.azimuth) < 0.02


def test_the_rocks_of_another_field_favour_no_place(from_the_south):
    other = rocks_from(strewn(4), 14.0, 1.0, (np.pi - 0.5, np.pi, np.pi + 0.5))
    found = match_rocks(from_the_south, other, SearchGate(12.8, 2.1, 3.0, 0.05), 3, PARAMS)
    assert not found or found[0].z < 4


def test_rocks_of_different_sizes_are_not_the_same(from_the_south):
    pairs = similar_rocks(from_the_south, from_the_south, PARAMS)
    width = from_the_south.width_m
    ratio = width[pairs[:, 0]] / width[pairs[:, 1]]
    assert ratio.max() < PARAMS.size_ratio
    assert {(k, k) for k in range(len(width))} <= {tuple(pair) for pair in pairs.tolist()}


def test_an_empty_plain_has_no_rocks():
    none = rocks_from(strewn(1, number=0), 0.0, 0.0, (0.0,))
    assert len(none) == 0
    assert match_rocks(none, none, SearchGate(12.8, 2.1, 3.0, 0.05), 3, PARAMS) == []


def test_rocks_narrower_than_the_narrowest_are_refused():
    with pytest.raises(MatchingError, match="give a rising range"):
        RockParams(least_width_m=4.0)
