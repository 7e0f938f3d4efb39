"""Two stops on textured, rolling ground: images and parallax of every pair, and where all stood."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import StereoMatches, StopId
from solmap.photogrammetry.matching.records import EpipolarImages, MatchedPair, MatchedStop

TEXTURE_CELL_M = 0.02
HALF_M = 24.0
FOCAL_PX = 320.0
SIZE_PX = 256
BASE_M = 0.4
MAST_M = 1.5
PARALLAX_NOISE_PX = 0.05


@cache
def texture(seed):
    """Spline coefficients of mottled soil with detail from 4 cm to 1 m, between 0.4 and 1.6."""
    cells = int(2 * HALF_M / TEXTURE_CELL_M)
    rng = np.random.default_rng(seed)
    grey = np.zeros((cells, cells), np.float32)
    for wave_m in (0.04, 0.12, 0.4, 1.0):
        noise = rng.normal(size=(cells // 2, cells // 2)).astype(np.float32)
        blurred = ndimage.gaussian_filter(noise, wave_m / TEXTURE_CELL_M / 4)
        grey += np.kron(blurred / blurred.std(), np.ones((2, 2), np.float32))
    return np.clip(1 + 0.15 * grey, 0.2, 2.0)


def elevation(north, east):
    """Rolling ground, some decimetres high over some metres."""
    return 0.12 * np.sin(north / 1.7 + 0.4) * np.cos(east / 1.3) + 0.06 * np.sin(east / 0.6 + north)


def ground_grey(seed, north, east, sunny):
    """Albedo and shading; `sunny` gives the direction of the sun."""
    at = [(HALF_M - north) / TEXTURE_CELL_M, (east + HALF_M) / TEXTURE_CELL_M]
    albedo = ndimage.map_coordinates(texture(seed), at, order=1, mode="wrap")
    slope = (elevation(north, east + 0.01) - elevation(north, east - 0.01)) / 0.02
    return 1000 * albedo * (1 - 0.5 * sunny * slope)


def ground_points(lsl_from_camera, geometry, columns_from):
    """Where the rays of an image meet the ground, in the LSL; NaN where they do not."""
    y, x = np.mgrid[: geometry.lines, : geometry.samples].astype(float)
    rays = (
        np.stack(
            [
                (x - geometry.centre_px[0]) / FOCAL_PX,
                (y - geometry.centre_px[1]) / FOCAL_PX,
                np.ones_like(x),
            ],
            axis=-1,
        ).reshape(-1, 3)
        @ lsl_from_camera.rotation.T
    )
    start = lsl_from_camera.apply(np.array([[columns_from, 0.0, 0.0]]))[0]
    down = np.where(rays[:, 2] > 0.03, rays[:, 2], np.nan)
    depth = -start[2] / down
    for _ in range(8):
        place = start + depth[:, None] * rays
        depth += 0.7 * (-elevation(place[:, 0], place[:, 1]) - place[:, 2]) / down
    return start + depth[:, None] * rays, depth.reshape(geometry.lines, geometry.samples)


@dataclass(frozen=True)
class Stand:
    """A stop as it was: where the rover stood, and its telemetry."""

    drive: int
    true: Pose
    reported: Pose


def stand(drive, north, east, yaw, reported_off=(0.0, 0.0, 0.0), reported_turn=0.0):
    """A stop at a place, with telemetry off by some metres and turned by some radians."""
    stop = StopId("MER2", 1, drive)
    place = np.array([north, east, 0.0])
    turns = [Rotation.from_euler("z", a).as_matrix() for a in (yaw, yaw + reported_turn)]
    return Stand(
        drive,
        Pose(LSL, stop.frame, turns[0], place),
        Pose(LSL, stop.frame, turns[1], place + np.array(reported_off)),
    )


def camera(stop, number, azimuth, elevation_angle, focal_px=FOCAL_PX):
    """A pair that looks along an azimuth and elevation of the rover frame."""
    forward = np.array(
        [
            np.cos(elevation_angle) * np.cos(azimuth),
            np.cos(elevation_angle) * np.sin(azimuth),
            -np.sin(elevation_angle),
        ]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    frame = Frame(FrameKind.PAIR, (stop.site, stop.drive, number))
    pose = Pose(stop.frame, frame, rotation, np.array([0.0, 0.0, -MAST_M]) - right * BASE_M / 2)
    middle = (SIZE_PX - 1) / 2
    return EpipolarPair(pose, BASE_M, focal_px, (middle, middle), SIZE_PX, SIZE_PX)


def photographed(stand, azimuths, seed=7, sunny=1.0, pointing=0.0):
    """The matched stop: every pair rendered, its labels off in pointing by `pointing` radians."""
    rng = np.random.default_rng(1000 + stand.drive)
    stop = StopId("MER2", 1, stand.drive)
    pairs = []
    for k, azimuth in enumerate(azimuths):
        truth = camera(stop, k, azimuth, np.radians(-16))
        off = Rotation.from_rotvec(rng.normal(0, 1, 3) * pointing).as_matrix()
        pose = truth.rover_from_pair
        label = Pose(pose.target, pose.source, pose.rotation @ off, pose.translation_m)
        reported = EpipolarPair(label, BASE_M, FOCAL_PX, truth.centre_px, SIZE_PX, SIZE_PX)
        pairs.append(
            _pair(f"P{stand.drive:02d}{k}", stand.true @ pose, reported, (seed, sunny), rng)
        )
    return MatchedStop(stop, tuple(pairs), stand.reported, np.zeros((6, 6)))


def _pair(name, lsl_from_pair, geometry, look, rng):
    seed, sunny = look
    images, depths = [], []
    for column in (0.0, BASE_M):
        points, depth = ground_points(lsl_from_pair, geometry, column)
        grey = ground_grey(seed, *np.nan_to_num(points[:, :2]).T, sunny)
        grey = np.where(np.isfinite(points[:, 0]), grey, 800.0).reshape(depth.shape)
        images.append((grey + rng.normal(0, 3, grey.shape)).astype(np.float32))
        depths.append(depth)
    scale = FOCAL_PX * BASE_M
    noise = ndimage.gaussian_filter(rng.normal(0, 1, depths[0].shape), 2)
    parallax = scale / depths[0] + PARALLAX_NOISE_PX * noise / noise.std()
    parallax[~(parallax > 2.5)] = np.nan
    mask = np.ones(parallax.shape, bool)
    x, y = (g.ravel() for g in np.meshgrid(np.arange(8, SIZE_PX - 8, 6), np.arange(8, SIZE_PX, 6)))
    x, y = x[y < SIZE_PX - 8], y[y < SIZE_PX - 8]
    value = parallax[y, x]
    good = np.isfinite(value)
    matches = StereoMatches(
        name,
        np.column_stack([x, y])[good].astype(float),
        value[good].astype(float),
        np.full(int(good.sum()), 0.1),
    )
    kept = EpipolarImages(geometry, images[0], mask, images[1], mask)
    return MatchedPair.of(name, "NAVCAM", kept, matches, parallax.astype(np.float32))


@pytest.fixture(scope="session")
def first_stand():
    """The stop at the origin, as telemetry has it."""
    return stand(0, 0.0, 0.0, 0.3)


@pytest.fixture(scope="session")
def second_stand():
    """Nine metres to the north-east; telemetry has errors of 0.8 m and 1.5 degrees."""
    return stand(1, 7.0, 6.0, 1.1, reported_off=(0.6, -0.5, 0.1), reported_turn=np.radians(1.5))


TOWARDS_SECOND = np.radians(np.array([-22.0, 8.0, 38.0, 68.0]))
TOWARDS_FIRST = np.radians(np.array([113.0, 143.0, 173.0, 203.0]))


@pytest.fixture(scope="session")
def first_stop(first_stand):
    """Four pairs, 30 degrees apart, around the direction of the second stop."""
    return photographed(first_stand, TOWARDS_SECOND, pointing=0.001)


@pytest.fixture(scope="session")
def second_stop(second_stand):
    """Four pairs that look back, the sun on the other side."""
    return photographed(second_stand, TOWARDS_FIRST, sunny=-1.0, pointing=0.001)


@pytest.fixture(scope="session")
def foreign_stop(second_stand):
    """The same view of other ground."""
    return photographed(second_stand, TOWARDS_FIRST, seed=8)
