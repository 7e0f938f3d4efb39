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
from solmap.products.formats.documents.archives import (
    radiometry_digest,
    read_radiometry,
    write_radiometry,
)

COUNTS = np.arange(0, 4096, 16, dtype=np.float32)
MODEL = RadialVignetting(k1=-0.2, k2=0.05, centre=(500.0, 510.5), source="a test")


@pytest.fixture
def all_kinds(rng) -> Radiometry:
    """A table, the approximation, a model and a measured flat field."""
    flat = rng.uniform(0.7, 1.0, (40, 60)).astype(np.float32)
    tables = {"LUT3": InverseTable("LUT3", COUNTS, "a test"), "LUT1": square_root_table("LUT1")}
    return Radiometry(Companding(tables), {"NAVCAM_LEFT": MODEL, "NAVCAM_RIGHT": flat})


def test_what_is_written_is_read_back(all_kinds, tmp_path):
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
def test_an_image_needs_what_its_label_calls_for(all_kinds, state, tables, cameras):
    needed = all_kinds.needed_by(state)
    assert set(needed.companding.tables) == tables
    assert set(needed.flat_fields) == cameras
    assert needed.changes_nothing == (not tables and not cameras)


def test_the_approximation_is_a_table_once_an_image_needs_it():
    anything = Radiometry(Companding(approximate=True))
    assert not anything.changes_nothing
    needed = anything.needed_by(PixelState("LUT2"))
    assert not needed.companding.approximate
    assert needed.companding.tables["LUT2"].is_approximation
