"""Pairs whose rows are known to correspond, or known not to: rendered, Curiosity's, Spirit's."""

import cv2
import numpy as np
import pytest

from photogrammetry.cameras.epipolar import epipolar_pair
from photogrammetry.frames import Frame, FrameKind
from photogrammetry.matching.dense import match_densely
from photogrammetry.matching.resampling import epipolar_images
from photogrammetry.matching.sparse import SparseParams, match_sparsely
from photogrammetry.matching.vertical_parallax import (
    rotation_of_the_bar,
    straightened,
    vertical_parallax,
)
from photogrammetry.pds3.reading import read_image

PAIR = Frame(FrameKind.PAIR, (0,))


def read(path):
    found = read_image(path.read_bytes(), path.name)
    return found.pixels, found.mask, found.image.camera, found.image.stop.frame


def resampled(left, right):
    (grey_l, mask_l, camera_l, rover), (grey_r, mask_r, camera_r, _) = left, right
    size_l, size_r = grey_l.shape[::-1], grey_r.shape[::-1]
    geometry = epipolar_pair(camera_l, camera_r, size_l, size_r, rover, PAIR)
    return epipolar_images(geometry, (grey_l, mask_l, camera_l), (grey_r, mask_r, camera_r))


def put_right(left, right, params=None):
    """Vertical parallax before and after the right camera is turned to where it points."""
    images = resampled(left, right)
    before = vertical_parallax(images, params)
    camera = straightened(right[2], images.geometry, rotation_of_the_bar(before))
    images = resampled(left, (*right[:2], camera, right[3]))
    return before, vertical_parallax(images, params), images


def test_a_rendered_pair_is_matched_in_all_its_terrain(husband):
    name = husband / "sol0155" / "edr" / "2n151760178eff1000p1500l0m1.img"
    images = resampled(read(name), read(name.with_name(name.name.replace("0l0m1", "0r0m1"))))
    rows = vertical_parallax(images)
    assert rows.fits_the_bar
    assert abs(rows.median_px) < 0.05  # the stereo bar of the labels is exact
    matches = match_sparsely("pair", images)
    cells = np.unique(matches.left // 128, axis=0)
    assert len(matches) > 800
    assert len(cells) > 50  # of 64, some of which hold sky
    parallax = match_densely(images)
    x, y = matches.left.astype(int).T
    apart = np.abs(parallax[y, x] - matches.parallax_px)
    apart = apart[np.isfinite(apart)]
    assert np.isfinite(parallax).mean() > 0.85
    assert (apart < 0.5).mean() > 0.97  # two ways to one parallax


@pytest.fixture
def curiosity(shared_data):
    folder = shared_data / "msl_navcam_sol1431_pair"
    eyes = []
    for picture, label in (
        ("NLB_524534514EDR_F0562034NCAM00280M_.jpeg", "NLB_517261274EDR_F0541610CCAM15900M1.IMG"),
        ("NRB_524534514EDR_F0562034NCAM00280M_.jpeg", "NRB_680874728RAD_F0900232NCAM00354M1.IMG"),
    ):
        _, _, camera, rover = read(folder / label)
        grey = cv2.imread(str(folder / picture), cv2.IMREAD_GRAYSCALE).astype(np.float32)
        eyes.append((grey, np.ones(grey.shape, dtype=bool), camera, rover))
    return eyes


def test_camera_models_of_other_exposures_are_noticed_and_put_right(curiosity):
    before, after, images = put_right(*curiosity)
    assert not before.fits_the_bar
    assert abs(before.median_px) == pytest.approx(2.7, abs=0.3)  # as the data's README measured
    assert after.fits_the_bar
    assert np.median(np.abs(after.vertical_px)) < 0.2  # README: 0.14
    matches = match_sparsely("curiosity", images)
    ranges = images.geometry.focal_px * images.geometry.base_m / matches.parallax_px
    assert len(matches) > 500
    np.testing.assert_allclose(np.percentile(ranges, [5, 95]), [13.2, 32.0], rtol=0.15)
    parallax = match_densely(images)
    assert np.isfinite(parallax[:380]).mean() < 0.001  # sky
    assert np.isfinite(parallax[720:, 60:-20]).mean() > 0.75  # ground


def test_two_frames_of_one_mast_swing_make_a_stereo_pair(shared_data):
    folder = shared_data / "mer_spirit_sol1869_troy"
    left, right = (read(folder / f"2n292280{n}effb100p0703l0m1.img") for n in ("938", "989"))
    before, after, _ = put_right(left, right, SparseParams(least_parallax_px=-15.0))
    assert np.median(np.abs(before.vertical_px)) > 1.0
    assert len(after.vertical_px) > 300
    assert np.median(np.abs(after.vertical_px)) < 0.15  # README: 0.12 with SIFT
