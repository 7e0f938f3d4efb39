"""Section 4 of the paper on tracks whose rotation, scale and shift are known."""

import numpy as np
import pytest

from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.traverse.georeference import MapTransform, compare_tracks, georeference

TRACK = np.array(
    [[0, 0], [150, -40], [390, -90], [700, -60], [980, -210], [1300, -420], [1650, -700],
     [2100, -900], [2500, -1100]], dtype=float
)  # fmt: skip


def turned(points_m, degrees, scale=1.0):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return scale * points_m @ np.array([[c, -s], [s, c]]).T


def test_the_rotation_of_a_mosaic_is_found_to_the_centimetre():
    mosaic = turned(TRACK, -1.3, 1 / 1.004) + np.array([37.0, -12.0])
    found = georeference(mosaic, TRACK)
    assert found.rotation_deg == pytest.approx(1.3, abs=1e-9)
    assert found.scale == pytest.approx(1.004, rel=1e-9)
    np.testing.assert_allclose(found.apply(mosaic), TRACK, atol=1e-6)
    assert compare_tracks(found.apply(mosaic), TRACK).mean_m < 0.01


def test_before_georeferencing_tracks_diverge_by_their_rotation():
    apart = compare_tracks(turned(TRACK, 1.3), TRACK)
    far = np.hypot(*TRACK[-1])
    assert apart.end_m == pytest.approx(2 * np.sin(np.radians(0.65)) * far, abs=0.01)
    travelled = np.hypot(*np.diff(TRACK, axis=0).T).sum()
    assert apart.end_percent == pytest.approx(100 * apart.end_m / travelled)


def test_an_affinity_finds_a_stretch_that_a_similarity_leaves_as_residuals():
    mosaic = TRACK * [1.02, 0.99]
    similar, affine = (
        georeference(mosaic, TRACK),
        georeference(mosaic, TRACK, MapTransform.AFFINITY),
    )
    assert np.abs(similar.residuals_m).max() > 1.0
    np.testing.assert_allclose(affine.residuals_m, 0.0, atol=1e-6)


@pytest.mark.parametrize("transform", list(MapTransform))
def test_stated_errors_of_the_rotation_are_true(rng, transform):
    errors, stated, sigmas = [], [], []
    for _ in range(400):
        mosaic = turned(TRACK, -1.3) + rng.normal(0.0, 5.0, TRACK.shape)
        found = georeference(mosaic, TRACK)
        errors.append(found.rotation_deg - 1.3)
        stated.append(found.sigma_rotation_deg)
        sigmas.append(georeference(mosaic, TRACK, transform).sigma_m)
    assert np.std(errors) == pytest.approx(np.median(stated), rel=0.15)
    assert np.sqrt(np.mean(np.square(sigmas))) == pytest.approx(5.0, rel=0.1)


def test_points_that_determine_nothing_are_refused():
    line = np.column_stack([np.arange(5.0), 2 * np.arange(5.0)])
    with pytest.raises(TraverseError, match="one line"):
        georeference(line, line, MapTransform.AFFINITY)
    with pytest.raises(TraverseError, match="coincide"):
        georeference(np.zeros((4, 2)), TRACK[:4])
    with pytest.raises(TraverseError, match="at least 3"):
        georeference(TRACK[:2], TRACK[:2], MapTransform.AFFINITY)
