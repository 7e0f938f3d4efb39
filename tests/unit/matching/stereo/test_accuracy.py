"""Matching compared with truth on three terrains, each under a sun of its own.

Run with `-s` for the figures; plain StereoSGBM of OpenCV matches the same images beside ours. The
rendered world of others is evaluated as well, where its grid gives the parallax.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import epipolar_pair
from solmap.photogrammetry.frames import Frame, FrameKind
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.resampling import epipolar_images
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.photogrammetry.matching.stereo.sparse import match_sparsely
from solmap.photogrammetry.synthetic.render import photograph
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.synthetic.truth import true_parallax
from tests.support.husband_truth import evaluated_pairs
from tests.support.middlebury import MOTORCYCLE, SCENES, compared
from tests.support.plain_stereo import plain_opencv

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

CASES = [
    (terrain, seed, pair)
    for terrain, seed in (("plains", 11), ("hills", 4), ("crater", 7))
    for pair in (0, 10)
]
"""Pair 0 is a Navcam's, pair 10 a Pancam's."""


@dataclass(frozen=True, eq=False)
class Case:
    name: str
    images: EpipolarImages
    truth: np.ndarray


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[0]}-{case[2]}")
def case(request):
    terrain, seed, pair = request.param
    params = WorldParams(terrain, pancam=True, traverse=TraverseParams(stops=3))
    world = make_world(params, seed)
    shot = world.shot(1, pair)
    cameras = [world.exposure(shot, eye).camera for eye in (Eye.LEFT, Eye.RIGHT)]
    bitmaps = [photograph(world, shot, eye).astype(np.float32) for eye in (Eye.LEFT, Eye.RIGHT)]
    size, whole = bitmaps[0].shape[::-1], np.ones(bitmaps[0].shape, dtype=bool)
    frame = Frame(FrameKind.PAIR, (0,))
    geometry = epipolar_pair(*cameras, size, size, world.stops[1].id.frame, frame)
    sources = [(p, whole, c) for p, c in zip(bitmaps, cameras, strict=True)]
    images = epipolar_images(geometry, *sources)
    return Case(f"{terrain} {shot.instrument}", images, true_parallax(world, 1, pair, geometry))


def test_verified_matches_are_true(case):
    matches = match_sparsely(case.name, case.images)
    x, y = matches.left.astype(int).T
    error = matches.parallax_px - case.truth[y, x]
    known = np.isfinite(error)
    off, normalised = np.abs(error[known]), np.abs(error[known] / matches.sigma_px[known])
    print(  # noqa: T201 - figures for the docs
        f"\n{case.name}: {len(matches)} matches, {np.mean(off < 0.3):.2%} within 0.3 px, "
        f"{np.mean(off < 1):.2%} within 1 px, median {np.median(off):.3f} px; "
        f"{np.mean(normalised < 1):.0%} within one sigma, {np.mean(normalised < 3):.0%} within 3"
    )
    assert len(matches) > 500
    assert known.mean() > 0.98  # the rest lies on outlines, where there is no truth
    assert (off < 1).mean() >= 0.99
    assert (off < 0.3).mean() >= 0.95
    assert 0.5 < (normalised < 1).mean() < 0.8  # 0.68 if it were normal


def test_dense_parallax_has_true_values_and_sigmas(case):
    dense, peer = match_densely(case.images), plain_opencv(case.images)
    figures = []
    for parallax in (dense.parallax_px, peer):
        off = np.abs(parallax - case.truth)
        off = off[np.isfinite(off)]
        figures.append((np.median(off), np.mean(off > 1), len(off) / np.isfinite(case.truth).sum()))
    normalised = np.abs(dense.parallax_px - case.truth) / dense.sigma_px
    within = [np.mean(normalised[np.isfinite(normalised)] < k) for k in (1, 2, 3)]
    print(  # noqa: T201 - figures for the docs
        f"\n{case.name}: "
        + "; ".join(f"median {m:.3f} px, bad {b:.2%}, seen {c:.1%}" for m, b, c in figures)
        + f"; within 1, 2, 3 sigma {within[0]:.0%}, {within[1]:.0%}, {within[2]:.0%}"
    )
    assert figures[0][0] < 0.4 * figures[1][0]
    assert figures[0][1] < max(0.02, 1.2 * figures[1][1])
    assert figures[0][2] > 0.75
    assert within[0] == pytest.approx(0.68, abs=0.06)
    assert np.isfinite(dense.parallax_px[np.isnan(case.truth)]).mean() < 0.15  # sky and occlusions


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_off_the_ground_as_few_matches_are_wrong_as_with_opencv_at_equal_fill(scene):
    if not scene.is_here:
        pytest.skip(f"needs {', '.join(map(str, scene.paths))}")
    found = compared(scene)
    print(f"\n{found}")  # noqa: T201
    assert found.filled > (0.86 if scene is MOTORCYCLE else 0.8)
    assert found.wrong[1.0][0] <= found.wrong[1.0][1]
    assert found.sigmas == pytest.approx(1.0, abs=0.2)


TRUTH_WIDTH_PX = 1.0
"""Uncertainty of the truth grid up to which it tests matches to 1 px; for every pair."""


@pytest.fixture(scope="module", params=["NAVCAM", "PANCAM"])
def rendered(request, husband):
    """(pair, its matches, their errors, width of the truth) of the three rendered stops."""
    pairs = [
        pair for sol in (155, 156, 157) for pair in evaluated_pairs(husband, sol, request.param)
    ]
    evaluated = []
    for pair in pairs if request.param == "PANCAM" else pairs[::3]:
        matches = match_sparsely(pair.name, pair.images)
        parallax, width = pair.true_parallax(matches.left)
        evaluated.append((pair, matches, matches.parallax_px - parallax, width))
    return evaluated


def test_matches_in_the_rendered_world_agree_with_its_grid(rendered):
    for pair, matches, error, width in rendered:
        off, reported = np.abs(error[width < TRUTH_WIDTH_PX]), np.abs(error[np.isfinite(error)])
        print(  # noqa: T201 - figures for the docs
            f"\n{pair.name}: {len(matches)} matches, {np.mean(reported < 1):.2%} within 1 px; "
            f"of {len(off)} with truth {np.mean(off < 1):.2%} within 1 px, "
            f"{np.mean(off < 0.3):.2%} within 0.3 px, median {np.median(off):.3f} px"
        )
        assert len(off) > 200
        assert (off < 1).mean() >= 0.99
        assert np.median(off) < 0.15


def test_where_match_and_grid_differ_images_support_the_match(rendered):
    """They correlate better at the match's parallax, in windows a third as wide as the match's."""
    at_match, at_truth = [], []
    for pair, matches, error, _ in rendered:
        for k in np.nonzero(np.abs(error) > 1)[0]:
            point, parallax = matches.left[k], float(matches.parallax_px[k])
            at_match.append(likeness(pair.images, point, parallax))
            at_truth.append(likeness(pair.images, point, parallax - float(error[k])))
    better = np.mean(np.array(at_match) > np.array(at_truth))
    print(  # noqa: T201 - figures for the docs
        f"\n{len(at_match)} matches differ by more than 1 px; median correlation "
        f"{np.median(at_match):.2f} at the match, {np.median(at_truth):.2f} at the truth, "
        f"better at the match {better:.0%}"
    )
    assert better > 0.9


def likeness(images, point, parallax_px, window_px=5):
    """Correlation of windows around a left point and its conjugate, best within 0.3 px of it."""
    left = window(images.left, point, window_px)
    shifts = parallax_px + np.arange(-3, 4) / 10
    rights = [window(images.right, point - [shift, 0.0], window_px) for shift in shifts]
    return max(float(cv2.matchTemplate(r, left, cv2.TM_CCOEFF_NORMED)[0, 0]) for r in rights)


def window(image, centre, side_px):
    return cv2.getRectSubPix(image, (side_px, side_px), tuple(map(float, centre)))
