import json
from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.radiometry import (
    Companding,
    InverseTable,
    PixelState,
    RadialVignetting,
    Radiometry,
    square_root_table,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import (
    Frame,
    FrameKind,
    Pose,
    rotation_of_roll_pitch_yaw,
    rover_frame,
)
from solmap.photogrammetry.imagery import StereoMatches
from solmap.photogrammetry.matching.records import DenseMatches, SharedSigma
from solmap.products.errors import ProductError
from solmap.products.formats.documents.archives import (
    StoredParallax,
    finite,
    radiometry_digest,
    read_matches,
    read_radiometry,
    write_dense,
    write_matches,
    write_radiometry,
)


def a_geometry() -> EpipolarPair:
    pose = Pose(
        rover_frame(10, 64),
        Frame(FrameKind.PAIR, (10, 64, 5)),
        rotation_of_roll_pitch_yaw(0.1, -0.3, 2.0),
        np.array([0.4, -0.1, -1.4]),
    )
    return EpipolarPair(pose, 0.2, 1220.0, (511.5, 500.25), 1024, 1000)


def test_an_unmeasured_figure_is_null():
    figures = (
        "same sol",
        12,
        True,
        0.5,
        np.float64("nan"),
        float("inf"),
        (1.0, float("nan")),
        None,
    )
    written = json.dumps([finite(figure) for figure in figures], allow_nan=False)
    assert json.loads(written) == ["same sol", 12, True, 0.5, None, None, [1.0, None], None]


def test_matches_and_their_geometry_are_read_back_exactly(tmp_path, rng):
    matches = StereoMatches("A", rng.normal(size=(5, 2)), rng.random(5), rng.random(5))
    write_matches(tmp_path / "m.npz", a_geometry(), matches)
    geometry, again = read_matches(tmp_path / "m.npz")
    np.testing.assert_array_equal(again.left, matches.left)
    np.testing.assert_array_equal(
        geometry.rover_from_pair.rotation, a_geometry().rover_from_pair.rotation
    )
    assert geometry.rover_from_pair.source == a_geometry().rover_from_pair.source
    assert (geometry.focal_px, geometry.centre_px) == (1220.0, (511.5, 500.25))


def dense_of(parallax: np.ndarray, rng: np.random.Generator) -> DenseMatches:
    sigma = rng.uniform(0.01, 1.0, parallax.shape).astype(np.float32)
    return DenseMatches(parallax, np.where(np.isfinite(parallax), sigma, np.float32(np.nan)))


def test_the_common_parallax_error_is_read_back(tmp_path, rng):
    alone = dense_of(rng.uniform(1.0, 60.0, (8, 9)).astype(np.float32), rng)
    shared = replace(alone, shared=SharedSigma(1.1, 0.005))
    for dense in (alone, shared):
        write_dense(tmp_path / "p.npz", dense)
        assert StoredParallax.read(tmp_path / "p.npz").dense().shared == dense.shared


def test_dense_matches_are_read_back_within_half_a_step(tmp_path, rng):
    parallax = rng.uniform(0.01, 300.0, (40, 50)).astype(np.float32)
    parallax[3:9] = np.nan
    dense = dense_of(parallax, rng)
    write_dense(tmp_path / "p.npz", dense)
    stored = StoredParallax.read(tmp_path / "p.npz")
    again = stored.dense()
    np.testing.assert_allclose(again.parallax_px, parallax, atol=0.5 / 128 + 1e-4)
    np.testing.assert_allclose(again.sigma_px, dense.sigma_px, rtol=0.016)
    np.testing.assert_array_equal(stored.parallax_px(), again.parallax_px)


def test_parallax_beyond_the_fine_range_is_stored_coarser_and_not_cut_off(tmp_path, rng):
    parallax = np.array([[900.0, 10.0]], dtype=np.float32)
    write_dense(tmp_path / "p.npz", dense_of(parallax, rng))
    again = StoredParallax.read(tmp_path / "p.npz").parallax_px()
    np.testing.assert_allclose(again, parallax, atol=0.01)


def test_the_same_arrays_give_the_same_bytes(tmp_path, rng):
    dense = dense_of(rng.uniform(0.01, 300.0, (40, 50)).astype(np.float32), rng)
    for name in ("a.npz", "b.npz"):
        write_dense(tmp_path / name, dense)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_file_that_is_not_an_archive_is_named(tmp_path):
    (tmp_path / "broken.npz").write_bytes(b"not a zip")
    with pytest.raises(ProductError, match=r"broken\.npz is not an archive"):
        StoredParallax.read(tmp_path / "broken.npz")


COUNTS = np.arange(0, 4096, 16, dtype=np.float32)
MODEL = RadialVignetting(k1=-0.2, k2=0.05, centre=(500.0, 510.5), source="a test")


@pytest.fixture
def all_kinds(rng) -> Radiometry:
    """A table, the approximation, a model and a measured flat field."""
    flat = rng.uniform(0.7, 1.0, (40, 60)).astype(np.float32)
    tables = {"LUT3": InverseTable("LUT3", COUNTS, "a test"), "LUT1": square_root_table("LUT1")}
    return Radiometry(Companding(tables), {"NAVCAM_LEFT": MODEL, "NAVCAM_RIGHT": flat})


def test_a_written_archive_is_read_back(all_kinds, tmp_path):
    write_radiometry(tmp_path / "tables.npz", all_kinds)
    again = read_radiometry(tmp_path / "tables.npz")
    assert radiometry_digest(again) == radiometry_digest(all_kinds)
    for name, table in all_kinds.companding.tables.items():
        same = again.companding.tables[name]
        np.testing.assert_array_equal(same.counts, table.counts)
        assert (same.source, same.is_approximation) == (table.source, table.is_approximation)
    assert again.flat_fields["NAVCAM_LEFT"] == MODEL
    np.testing.assert_array_equal(
        again.flat_fields["NAVCAM_RIGHT"], all_kinds.flat_fields["NAVCAM_RIGHT"]
    )


def test_the_digest_is_that_of_the_content(all_kinds):
    other_order = Radiometry(
        Companding(dict(reversed(all_kinds.companding.tables.items()))),
        dict(reversed(all_kinds.flat_fields.items())),
    )
    assert radiometry_digest(other_order) == radiometry_digest(all_kinds)
    changed = COUNTS.copy()
    changed[17] += 1
    fewer = Radiometry(Companding({"LUT3": InverseTable("LUT3", COUNTS, "a test")}))
    other = Radiometry(Companding({"LUT3": InverseTable("LUT3", changed, "a test")}))
    digests = {radiometry_digest(each) for each in (all_kinds, fewer, other, Radiometry())}
    assert len(digests) == 4


@pytest.mark.parametrize(
    ("state", "tables", "cameras"),
    [
        (PixelState(), set(), set()),
        (PixelState("LUT3"), {"LUT3"}, set()),
        (PixelState("LUT3", "NAVCAM_LEFT"), {"LUT3"}, {"NAVCAM_LEFT"}),
        (PixelState(None, "NAVCAM_RIGHT"), set(), {"NAVCAM_RIGHT"}),
        (PixelState("LUT2", "NAVCAM_LEFT"), set(), set()),  # codes are not proportional to light
        (PixelState(None, "PANCAM_LEFT"), set(), set()),
    ],
)
def test_an_image_requires_the_tables_of_its_label(all_kinds, state, tables, cameras):
    needed = all_kinds.needed_by(state)
    assert set(needed.companding.tables) == tables
    assert set(needed.flat_fields) == cameras
    assert needed.changes_nothing == (not tables and not cameras)


def test_the_approximation_is_a_required_table():
    anything = Radiometry(Companding(approximate=True))
    assert not anything.changes_nothing
    needed = anything.needed_by(PixelState("LUT2"))
    assert not needed.companding.approximate
    assert needed.companding.tables["LUT2"].is_approximation
