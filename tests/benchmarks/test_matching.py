"""CPU time of matching one stereo pair of 1024 x 1024 pixels, stage by stage.

The pair is a made-up ground below a mast with parallaxes of 4 to 140 pixels, as a Navcam sees from
its horizon to its feet. OpenCV's own semi-global matcher and SIFT with ratio test run beside it.
"""

import time
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from scipy import ndimage

from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.resampling import epipolar_images
from solmap.photogrammetry.matching.stereo.dense import (
    match_densely,
)
from solmap.photogrammetry.matching.stereo.interest_points import (
    FoerstnerParams,
    interest_points,
)
from solmap.photogrammetry.matching.stereo.orientation import vertical_parallax
from solmap.photogrammetry.matching.stereo.sparse import match_sparsely
from solmap.photogrammetry.stretching import stretch
from solmap.photogrammetry.synthetic.render import photograph
from solmap.photogrammetry.synthetic.rig import Instrument
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams

pytestmark = pytest.mark.benchmark(timer=time.process_time)

SIZE = 1024
ROVER, PAIR = rover_frame(1, 0), Frame(FrameKind.PAIR, (1,))


@pytest.fixture(scope="module")
def images() -> EpipolarImages:
    rng = np.random.default_rng(1)
    octaves = (ndimage.gaussian_filter(rng.normal(size=(SIZE, 1300)), k) * k for k in (0.8, 3, 12))
    texture = sum(octaves)
    texture = 1200 + 200 * texture / texture.std()
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    left = ndimage.map_coordinates(texture, [y, x], order=1)
    right = ndimage.map_coordinates(texture, [y, (x + 4 + 0.13 * y) / 0.99], order=3)
    noisy = [(i + rng.normal(size=i.shape) * 10).astype(np.float32) for i in (left, right)]
    still = Pose(ROVER, PAIR, np.eye(3), np.zeros(3))
    geometry = EpipolarPair(still, 0.2, 1220.0, (511.5, 511.5), SIZE, SIZE)
    whole = np.ones((SIZE, SIZE), dtype=bool)
    return EpipolarImages(geometry, noisy[0], whole, noisy[1], whole)


def eye(y_m: float) -> Cahvor:
    a = np.array([0.94, 0.0, 0.342])
    a /= np.linalg.norm(a)
    right = np.array([0.0, 1.0, 0.0])
    h, v = 1220 * right + 511.5 * a, 1220 * np.cross(a, right) + 511.5 * a
    return Cahvor(np.array([0.4, y_m, -1.3]), a, h, v, a, np.array([0.0, -0.02, 0.02]))


def test_resampling_a_pair_to_its_epipolar_geometry(benchmark, images):
    left, right = eye(0.1), eye(0.3)
    geometry = epipolar_pair(left, right, (SIZE, SIZE), (SIZE, SIZE), ROVER, PAIR)
    benchmark(
        epipolar_images,
        geometry,
        (images.left, images.left_mask, left),
        (images.right, images.right_mask, right),
    )


def test_matching_a_pair_sparsely(benchmark, images):
    assert len(benchmark(match_sparsely, "pair", images)) > 500


def test_matching_a_pair_densely(benchmark, images):
    parallax = benchmark(match_densely, images).parallax_px
    assert np.isfinite(parallax[:, 160:]).mean() > 0.9


def test_finding_five_thousand_interest_points(benchmark, images):
    params = FoerstnerParams(smallest_weight=0.1)
    points = benchmark(interest_points, images.left, images.left_mask, params, 8)
    assert len(points) == params.count


def test_measuring_the_vertical_parallax_of_a_pair(benchmark, images):
    assert abs(benchmark(vertical_parallax, images).median_px) < 0.1


def test_opencv_semi_global_matching_for_comparison(benchmark, images):
    left = stretch(images.left, images.left_mask)
    right = stretch(images.right, images.right_mask)
    matcher = cv2.StereoSGBM.create(0, 208, 5, P1=200, P2=800, disp12MaxDiff=1)
    benchmark(matcher.compute, left, right)


def test_sift_with_ratio_test_for_comparison(benchmark, images):
    bitmaps = [
        stretch(image, mask)
        for image, mask in ((images.left, images.left_mask), (images.right, images.right_mask))
    ]

    def match():
        sift = cv2.SIFT.create(5000)
        found = [sift.detectAndCompute(png, None)[1] for png in bitmaps]
        pairs = cv2.BFMatcher().knnMatch(*found, k=2)
        return [a for a, b in pairs if a.distance < 0.8 * b.distance]

    assert len(benchmark(match)) > 100


def test_matching_a_panorama_of_ten_pairs(benchmark):
    """Resampled, checked for its rows, matched sparsely and densely: two pairs at a time.

    The timer counts both threads; what passes on the wall is in `extra_info`, in seconds.
    """
    world = make_world(WorldParams("plains", traverse=TraverseParams(stops=1)), 3)
    shots = [shot for shot in world.shots if shot.instrument == Instrument.NAVCAM]
    pairs = [[_source(world, shot, one) for one in (Eye.LEFT, Eye.RIGHT)] for shot in shots]

    def match(pair):
        (left, _, camera), (_, _, other) = pair
        size = left.shape[::-1]
        geometry = epipolar_pair(camera, other, size, size, world.stops[0].id.frame, PAIR)
        images = epipolar_images(geometry, *pair)
        assert vertical_parallax(images).fits_the_rig
        return len(match_sparsely("pair", images)), match_densely(images).parallax_px

    def panorama():
        started = time.perf_counter()
        with ThreadPoolExecutor(2) as pool:
            matched = list(pool.map(match, pairs))
        benchmark.extra_info["wall_s"] = time.perf_counter() - started
        return matched

    matched = benchmark.pedantic(panorama, rounds=1)
    print(f"panorama: {benchmark.extra_info['wall_s']:.1f} s on the wall")  # noqa: T201
    assert len(matched) == 10
    assert min(count for count, _ in matched) > 1000


def _source(world, shot, one):
    png = photograph(world, shot, one).astype(np.float32)
    return png, np.ones(png.shape, dtype=bool), world.exposure(shot, one).camera
