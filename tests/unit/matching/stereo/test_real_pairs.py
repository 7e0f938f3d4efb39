"""Pairs whose rows are known to correspond, or known not to: rendered, Curiosity's, Spirit's."""

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.adjustment.modes.rig_pooling import (
    CameraRows,
    StopRig,
    pooled_rotations,
)
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.epipolar import epipolar_pair
from solmap.photogrammetry.frames import Frame, FrameKind, rover_frame
from solmap.photogrammetry.matching.resampling import epipolar_images
from solmap.photogrammetry.matching.stereo.dense import DenseParams, match_densely
from solmap.photogrammetry.matching.stereo.orientation import (
    MeasuredOffsets,
    OrientationParams,
    RowCells,
    relative_orientation,
    rig_rotation,
    turn_in_place,
    vertical_parallax,
)
from solmap.photogrammetry.matching.stereo.sparse import SparseParams, match_sparsely

PAIR = Frame(FrameKind.PAIR, (0,))


def read(path):
    found = read_image(path.read_bytes(), path.name)
    return found.pixels, found.mask, found.image.camera, found.image.stop.frame


def resampled(left, right):
    (grey_l, mask_l, camera_l, rover), (grey_r, mask_r, camera_r, _) = left, right
    size_l, size_r = grey_l.shape[::-1], grey_r.shape[::-1]
    geometry = epipolar_pair(camera_l, camera_r, size_l, size_r, rover, PAIR)
    return epipolar_images(geometry, (grey_l, mask_l, camera_l), (grey_r, mask_r, camera_r))


def corrected(left, right, params=None):
    """Vertical parallax before and after the right camera is turned to where it points."""
    images = resampled(left, right)
    before = vertical_parallax(images, params)
    pose = images.geometry.rover_from_pair
    camera = turn_in_place(right[2], pose.target, pose.rotation @ rig_rotation(before))
    images = resampled(left, (*right[:2], camera, right[3]))
    return before, vertical_parallax(images, params), images


def test_a_rendered_pair_is_matched_in_all_its_terrain(husband):
    name = husband / "sol0155" / "edr" / "2n151760178eff1000p1500l0m1.img"
    images = resampled(read(name), read(name.with_name(name.name.replace("0l0m1", "0r0m1"))))
    rows = vertical_parallax(images)
    assert rows.fits_the_rig
    assert abs(rows.median_px) < 0.05  # the baseline of the labels is exact
    matches = match_sparsely("pair", images)
    cells = np.unique(matches.left // 128, axis=0)
    assert len(matches) > 800
    assert len(cells) > 50  # of 64, some of which hold sky
    parallax = match_densely(images).parallax_px
    x, y = matches.left.astype(int).T
    apart = np.abs(parallax[y, x] - matches.parallax_px)
    apart = apart[np.isfinite(apart)]
    assert np.isfinite(parallax).mean() > 0.85
    assert (apart < 0.5).mean() > 0.97  # two ways to one parallax


@pytest.fixture
def curiosity(shared_data):
    folder = shared_data / "msl_navcam_sol1431_pair"
    eyes = []
    for png, label in (
        ("NLB_524534514EDR_F0562034NCAM00280M_.jpeg", "NLB_517261274EDR_F0541610CCAM15900M1.IMG"),
        ("NRB_524534514EDR_F0562034NCAM00280M_.jpeg", "NRB_680874728RAD_F0900232NCAM00354M1.IMG"),
    ):
        _, _, camera, rover = read(folder / label)
        grey = cv2.imread(str(folder / png), cv2.IMREAD_GRAYSCALE).astype(np.float32)
        eyes.append((grey, np.ones(grey.shape, dtype=bool), camera, rover))
    return eyes


def test_camera_models_of_other_exposures_are_detected_and_corrected(curiosity):
    before, after, images = corrected(*curiosity)
    assert not before.fits_the_rig
    assert abs(before.median_px) == pytest.approx(2.7, abs=0.3)  # as the data's README measured
    assert after.fits_the_rig
    assert np.median(np.abs(after.vertical_px)) < 0.14  # README: 0.14 with SIFT
    matches = match_sparsely("curiosity", images)
    ranges = images.geometry.focal_px * images.geometry.base_m / matches.parallax_px
    assert len(matches) > 1200  # spread over the image; SIFT has 2571 inliers in clusters
    assert np.median(matches.sigma_px) < 0.1
    np.testing.assert_allclose(np.percentile(ranges, [5, 95]), [13.2, 32.0], rtol=0.15)
    parallax = match_densely(images).parallax_px
    x, y = matches.left.astype(int).T
    apart = np.abs(parallax[y, x] - matches.parallax_px)
    assert (apart[np.isfinite(apart)] < 0.5).mean() > 0.99  # two ways to one parallax
    assert np.isfinite(parallax[:380]).mean() < 0.001  # sky
    assert np.isfinite(parallax[720:, 60:-20]).mean() > 0.75  # ground


def test_errors_of_real_lenses_are_not_mistaken_for_toe_in(curiosity):
    images = resampled(*curiosity)
    measured = vertical_parallax(images)
    free = rig_rotation(measured) * images.geometry.focal_px
    assert abs(free[1]) > 0.5  # pixels: the pattern that the lenses leave in the rows
    geometry = images.geometry
    rows = CameraRows(RowCells.of(measured), 1, geometry.focal_px, geometry.samples)
    assert rows.cells.variance_factor > 10
    found = pooled_rotations({"stop": StopRig({"NAVCAM": rows})})["stop"]["NAVCAM"]
    toe_in_px, sigma_px = found.rotation[1] * geometry.focal_px, found.sigmas[1]
    assert abs(toe_in_px) < 0.4
    assert sigma_px * geometry.focal_px > 0.8  # as the rest of the rotation, 2.7 pixels, suggests


def test_two_frames_of_one_mast_swing_make_a_stereo_pair(shared_data):
    folder = shared_data / "mer_spirit_sol1869_troy"
    left, right = (read(folder / f"2n292280{n}effb100p0703l0m1.img") for n in ("938", "989"))
    before, after, _ = corrected(left, right, SparseParams(least_parallax_px=-15.0))
    assert np.median(np.abs(before.vertical_px)) > 1.0
    assert len(after.vertical_px) > 300
    assert np.median(np.abs(after.vertical_px)) < 0.15  # README: 0.12 with SIFT


def tsai_eye(folder, name):
    """An image of the K10 rover without its distortion, and the pinhole camera that saw it so."""
    rows = (line.split("=") for line in (folder / f"black_{name}.tsai").read_text().splitlines())
    message = {key.strip(): np.array(value.split(), float) for key, value in rows}
    fu, fv, cu, cv = (float(message[key][0]) for key in ("fu", "fv", "cu", "cv"))
    matrix = np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]])
    lens = np.array([message[key][0] for key in ("k1", "k2", "p1", "p2")])
    image = cv2.imread(str(folder / f"{name}4.png"), cv2.IMREAD_GRAYSCALE)
    grey = cv2.undistort(image, matrix, lens).astype(np.float32)
    mask = cv2.undistort(np.full_like(image, 255), matrix, lens) == 255
    right, down, forward = message["R"].reshape(3, 3).T
    camera = Cahv(message["C"], forward, fu * right + cu * forward, fv * down + cv * forward)
    return grey, mask, camera, rover_frame(1, 0)


def test_a_wrong_baseline_direction_is_corrected_where_a_rotation_is_not_enough(shared_data):
    folder = shared_data / "analogue_k10_pair"
    left, right = (tsai_eye(folder, name) for name in ("left", "right"))
    near = SparseParams(nearest_range_m=0.6)
    before, turned, _ = corrected(left, right, near)
    assert before.mad_px > 1.0  # README: 1.3
    assert np.median(np.abs(turned.vertical_px)) > 0.5
    loose = OrientationParams(rotation_sigma=np.deg2rad(3.0), position_sigma_m=0.01)
    rows, found = before, None
    for _ in range(3):
        found = relative_orientation(MeasuredOffsets(rows), loose, found)
        right = (*right[:2], found.apply(right[2], rows.geometry), right[3])
        images = resampled(left, right)
        rows = vertical_parallax(images, near)
    assert rows.fits_the_rig
    assert np.median(np.abs(rows.vertical_px)) < 0.25
    assert len(match_sparsely("k10", images, near)) > 700
    assert (
        np.isfinite(match_densely(images, DenseParams(nearest_range_m=0.6)).parallax_px).mean()
        > 0.4
    )
