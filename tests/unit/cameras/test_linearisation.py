import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.cameras.cahv import Cahv, interior_orientation
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.linearisation import Field, linearise_image, linearise_pair
from solmap.photogrammetry.errors import CameraError


def eye(entry):
    return Cahvor(**{key.lower(): np.array(value) for key, value in entry.items()})


def test_jpls_rule_gives_the_models_of_the_facts(test_vectors):
    for row in test_vectors["linearisation"]:
        left, right = linearise_pair(eye(row["left"]), eye(row["right"]), 1024, 1024)
        for key, expected in row["mer_era_model_smallest_field"].items():
            np.testing.assert_allclose(getattr(left, key.lower()), expected, atol=1e-5)
            np.testing.assert_array_equal(getattr(left, key.lower()), getattr(right, key.lower()))
        inner = interior_orientation(left.a, left.h, left.v)
        np.testing.assert_allclose(
            [inner.hs, inner.vs, inner.hc, inner.vc], row["internals_hs_vs_hc_vc"], atol=1e-6
        )
        assert (right.c - left.c) @ left.a == pytest.approx(row["baseline_along_axis_m"], abs=1e-6)


def test_jpls_rule_reproduces_the_archived_labels(test_vectors, cameras):
    corners = np.array([[0.0, 0.0], [1023, 0], [0, 1023], [1023, 1023], [511.5, 511.5]])
    for row in test_vectors["linearisation"]:
        ours, _ = linearise_pair(eye(row["left"]), eye(row["right"]), 1024, 1024)
        label = cameras[row["label_camera"]]
        assert isinstance(label, Cahv)
        far = ours.c + 1e6 * ours.rays(corners)
        assert np.abs(label.project(far) - corners).max() < 0.03


def test_an_image_linearised_by_the_rule_equals_jpls_product(test_vectors, shared_data):
    """Spirit, sol 1869: RAD resampled to the model of the pair is RSL, where RSL is not cut off."""
    folder = shared_data / "mer_spirit_sol1869_troy"
    radiometric, product = (
        read_image((folder / name).read_bytes(), name)
        for name in ("2n292280938radb100p0703l0c1.img", "2n292280938rslb100p0703l0m1.img")
    )
    row = test_vectors["linearisation"][0]
    linear, _ = linearise_pair(eye(row["left"]), eye(row["right"]), 1024, 1024)
    grey, mask = linearise_image(
        radiometric.pixels, radiometric.mask, radiometric.image.camera, linear
    )
    assert (mask & product.mask).sum() == product.mask.sum()
    both = mask & product.mask & (product.pixels < 4095)
    assert np.corrcoef(grey[both], product.pixels[both])[0, 1] > 0.999  # facts: 0.9991
    both[970:] = False  # the deck of the rover, where scaling to 12 bits cuts off
    assert np.corrcoef(grey[both], product.pixels[both])[0, 1] > 0.99998


def test_pixels_outside_the_original_are_masked(navcam):
    image, mask = np.full((64, 64), 7.0, np.float32), np.ones((64, 64), bool)
    mask[30, 20] = False
    camera = navcam.average(16, 16)
    grey, found = linearise_image(image, mask, camera, camera.perspective.subframe(-8, 0))
    assert not found[:, :6].any()
    assert (grey[found] == 7.0).all()
    assert (grey[~found] == 0.0).all()
    assert 3800 > found.sum() > 2500


def test_the_largest_field_loses_no_edge(navcam):
    other = Cahvor(navcam.c + np.array([0.12, 0.16, 0]), *(getattr(navcam, k) for k in "ahvor"))
    smallest, _ = linearise_pair(navcam, other, 1024, 1024)
    largest, _ = linearise_pair(navcam, other, 1024, 1024, Field.LARGEST)
    edges = np.array([[0.0, 511.5], [1023, 511.5], [511.5, 0], [511.5, 1023]])
    seen = largest.project(navcam.c + 1e6 * navcam.rays(edges))
    assert seen.min() > -1
    assert seen.max() < 1024
    inner = [interior_orientation(m.a, m.h, m.v).hs for m in (smallest, largest)]
    assert inner[0] > inner[1]


def test_two_cameras_in_one_place_are_not_a_pair(navcam):
    with pytest.raises(CameraError, match="no baseline to linearise along"):
        linearise_pair(navcam, navcam, 1024, 1024)
