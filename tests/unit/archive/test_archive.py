"""Every real image there is, and the rendered ones, through the readers."""

import hashlib

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.archive.images.pixels import radiance_scale, read_pixels
from solmap.photogrammetry.archive.images.reading import (
    read_image,
    read_image_record,
    read_label,
)
from solmap.photogrammetry.archive.images.rover_image import camera_model
from solmap.photogrammetry.archive.labels.label import parse_label
from solmap.photogrammetry.archive.labels.vicar import parse_vicar_label
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.cameras.linearisation import linearise_pair
from solmap.photogrammetry.errors import PixelError
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.imagery import Eye

ALTERED = "1p216067135edn76pop2102l2m1.img"


@pytest.fixture(scope="module")
def real_images(shared_data):
    """Every image file of the shared data that is not known to be altered."""
    paths = [path for path in sorted(shared_data.rglob("*.[iI][mM][gG]")) if path.name != ALTERED]
    assert len(paths) >= 18
    return {path.name: read_image(path.read_bytes(), path.name) for path in paths}


def test_every_real_image_is_read(real_images):
    for name, read in real_images.items():
        assert read.image.id == name.partition(".")[0].upper()
        assert read.pixels.shape == (1024, 1024)
        assert read.mask.mean() > 0.8
        assert read.image.sun_elevation is not None
        assert read.image.sun_elevation > 0  # all were taken by day
        assert isinstance(read.image.camera, Cahv | Cahvor | Cahvore)


def test_pixels_equal_those_of_the_facts(test_vectors, shared_data):
    for row in test_vectors["image_decoding"]:
        if "image_offset_bytes" not in row:
            continue
        data = (shared_data / row["file"]).read_bytes()
        assert hashlib.sha256(data).hexdigest() == row["sha256_of_file"]
        label = read_label(data, row["file"])
        pixels, _ = read_pixels(data, label, row["file"])
        assert pixels.shape == (row["lines"], row["samples"])
        assert (pixels.min(), pixels.max()) == (row["minimum"], row["maximum"])
        assert pixels.mean(dtype=np.float64) == pytest.approx(row["mean"], abs=1e-6)
        for line, sample in ((0, 0), (511, 511), (100, 900), (1023, 1023)):
            assert pixels[line, sample] == row[f"pixel_line{line}_sample{sample}"]
        scale = radiance_scale(label)
        assert (scale and scale.factor) == row["radiance_scaling_factor"]
        assert (scale and scale.offset) == row["radiance_offset"]


def test_the_altered_sub_frame_gives_its_own_error_and_is_read_by_its_vicar_label(
    test_vectors, shared_data
):
    data = next(shared_data.rglob(ALTERED)).read_bytes()
    with pytest.raises(PixelError, match=f"{ALTERED}: truncated: .* probably altered"):
        read_image(data, ALTERED)
    pixels, mask = read_pixels(data, parse_vicar_label(data, ALTERED), ALTERED)
    row = test_vectors["image_decoding"][-1]
    assert pixels.shape == (row["lines"], row["samples"])
    assert (pixels.min(), pixels.max()) == (row["minimum"], row["maximum"])
    assert pixels.mean(dtype=np.float64) == pytest.approx(row["mean"], abs=1e-6)
    assert (pixels[0, 0], pixels[191, 319]) == (155, 135)
    assert mask.all()


def test_labels_give_the_cameras_of_the_facts(test_vectors, shared_data):
    files = {
        "navcam_left_spirit_sol767": "2n194463440effapa0p0685l0m1.excerpt.lbl",
        "navcam_right_spirit_sol767": "2n194463440effapa0p0685r0m1.excerpt.lbl",
        "navcam_left_spirit_sol1869": "2n292280938effb100p0703l0m1.lbl",
        "navcam_left_spirit_sol1869_linearised": "2n292280938rslb100p0703l0m1.lbl",
        "navcam_left_spirit_sol1900_linearised": "2n295043924fflb1dnp1979l0m1.lbl",
        "pancam_left_spirit_sol1900_linearised": "2p295043688fflb1dnp2380l2m1.lbl",
        "navcam_left_opportunity_sol4087": "1N491020376ILFCNY9P0706L0M1.lbl",
        "pancam_left_opportunity_sol4090": "1P491287702ILFCNY9P2584L2M1.lbl",
        "pancam_left_opportunity_sol990_subframe_2x2": ALTERED,
        "front_hazcam_left_opportunity_sol4000": "1F483288473EFFCMUFP1214L0M1.IMG",
    }
    for name, file in files.items():
        text = next(shared_data.rglob(file)).read_bytes().decode("latin-1")
        camera = camera_model(parse_label(text, file))
        expected = test_vectors["cameras"][name]
        for letter in "CAHVRE":
            if letter in expected:
                np.testing.assert_array_equal(getattr(camera, letter.lower()), expected[letter])
        if "O" in expected:  # made a unit vector, which a label's six digits are not quite
            np.testing.assert_allclose(camera.o, expected["O"], atol=2e-6)


def test_projecting_and_back_projecting_closes_for_every_real_camera(real_images, rng):
    image_points = rng.uniform(0, 1023, (400, 2))
    corners = np.array([[0.0, 0.0], [1023, 0], [0, 1023], [1023, 1023], [511.5, 511.5]])
    image_points = np.vstack([image_points, corners])
    for name, read in real_images.items():
        camera = read.image.camera
        for metres in (0.5, 10.0, 1000.0):
            points = camera.ray_origins(image_points) + metres * camera.rays(image_points)
            np.testing.assert_allclose(
                camera.project(points), image_points, atol=1e-8, err_msg=name
            )


def test_frames_without_partner_are_listed(real_images):
    pairing = find_stereo_pairs([read.image for read in real_images.values()])
    assert pairing.pairs == ()
    assert len(pairing.unpaired) == len(real_images)
    assert pairing.unpaired["1N491020376ILFCNY9P0706L0M1"] == (
        "no right-eye partner within 1 s of clock 491020376"
    )


def test_products_of_one_real_exposure_are_one_observation(real_images):
    pairing = find_stereo_pairs([read.image for read in real_images.values()])
    rad = "2N292280938RADB100P0703L0C1"
    assert pairing.repeats == {
        "2N292280938EFFB100P0703L0M1": rad,
        "2N292280938RSLB100P0703L0M1": rad,
    }


def test_the_labels_of_the_sol_767_pair_are_one_baseline_apart(shared_data):
    centres = []
    for eye in "lr":
        path = next(shared_data.rglob(f"2n194463440effapa0p0685{eye}0m1.excerpt.lbl"))
        centres.append(camera_model(parse_label(path.read_text(), path.name)).c)
    assert np.linalg.norm(centres[1] - centres[0]) == pytest.approx(0.200345, abs=1e-5)


def head_of(path):
    """The start of a file: enough for its record."""
    with path.open("rb") as stream:
        return stream.read(1 << 16)


@pytest.mark.usefixtures("unchecked")
def test_every_rendered_image_has_its_partner(husband):
    paths = sorted(husband.rglob("*.img"))
    images = [read_image_record(head_of(path), path.name) for path in paths]
    pairing = find_stereo_pairs(images)
    assert (len(images), len(pairing.pairs), pairing.unpaired) == (76, 38, {})
    bars_m = {"NAVCAM": 0.2003, "PANCAM": 0.3}
    for pair in pairing.pairs:
        assert (pair.left.eye, pair.right.eye) == (Eye.LEFT, Eye.RIGHT)
        base_m = np.linalg.norm(pair.right.camera.centre - pair.left.camera.centre)
        assert base_m == pytest.approx(bars_m[pair.left.instrument], abs=1e-3)
    read = read_image(paths[0].read_bytes(), paths[0].name)
    assert read.mask.all()
    assert 0 < read.pixels.min() < read.pixels.max() < 4096


# The true right eye of Spirit's Navcam, known from the sol 767 labels, carried to sol 1869.
MAST_767 = np.array([0.798036, -0.107988, -0.150269, -0.573494])
MAST_1869 = np.array([0.317432, 0.21062, -0.0725336, 0.921746])
MAST_ORIGIN = np.array([0.45781, 0.02779, -1.09668])


@pytest.fixture(scope="module")
def own_linear_model(shared_data, real_images):
    """The common CAHV model of the sol 1869 pair by our JPL rule."""
    mast, rover = Frame(FrameKind.MAST), rover_frame(137, 0)
    before = Pose.of_quaternion(rover, mast, MAST_767, MAST_ORIGIN)
    after = Pose.of_quaternion(rover, mast, MAST_1869, MAST_ORIGIN)
    path = next(shared_data.rglob("2n194463440effapa0p0685r0m1.excerpt.lbl"))
    right = camera_model(parse_label(path.read_text(), path.name)).transform(after @ before.inverse)
    left = real_images["2n292280938effb100p0703l0m1.img"].image.camera
    assert isinstance(right, Cahvor)
    return linearise_pair(left, right, 1024, 1024)[0]


def grid_of_pixels():
    samples, lines = np.meshgrid(np.arange(1024.0), np.arange(1024.0))
    return np.column_stack([samples.ravel(), lines.ravel()])


def test_our_linearisation_by_jpls_rule_equals_the_archived_label_to_0_03_px(
    own_linear_model, real_images
):
    archived = real_images["2n292280938rslb100p0703l0m1.img"].image.camera
    pixels = grid_of_pixels()[::97]
    far = own_linear_model.c + 1e6 * own_linear_model.rays(pixels)
    assert np.abs(archived.project(far) - pixels).max() <= 0.03


def texture(image):
    """An image without its slow changes: vignetting, sky gradient, calibration."""
    return image - cv2.GaussianBlur(image, (0, 0), 10)


@pytest.mark.parametrize(
    ("source", "least_correlation"),
    [("2n292280938effb100p0703l0m1.img", 0.95), ("2n292280938radb100p0703l0c1.img", 0.999)],
)
def test_our_linearised_pixels_equal_those_of_the_archive(
    own_linear_model, real_images, source, least_correlation
):
    """RSL is made of the radiometrically corrected frame, so RAD agrees closer than the EDR.

    The archive interpolates bilinearly. 375 of its pixels are cut off at 4095.
    """
    read, archived = real_images[source], real_images["2n292280938rslb100p0703l0m1.img"]
    rays = own_linear_model.rays(grid_of_pixels())
    maps = read.image.camera.project(own_linear_model.c + 10 * rays).reshape(1024, 1024, 2)
    warped = cv2.remap(read.pixels, maps.astype(np.float32), None, cv2.INTER_LINEAR)
    usable = archived.mask & (archived.pixels < 4095) & (maps > 0).all(-1) & (maps < 1023).all(-1)
    inside = cv2.erode(usable.astype(np.uint8), np.ones((41, 41))) > 0
    assert inside.mean() > 0.9
    ours, theirs = texture(warped), texture(archived.pixels)
    assert np.corrcoef(ours[inside], theirs[inside])[0, 1] > least_correlation
    assert np.corrcoef(warped[inside], archived.pixels[inside])[0, 1] > least_correlation - 0.15
    hanning = cv2.createHanningWindow((512, 512), cv2.CV_32F)
    middle = (slice(256, 768), slice(256, 768))
    shift, _ = cv2.phaseCorrelate(ours[middle].copy(), theirs[middle].copy(), hanning)
    assert np.hypot(*shift) < 0.03
