"""Derived rasters, written here in the layout that VICAR's help texts give."""

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.derived_rasters import RasterKind, read_raster
from solmap.photogrammetry.archive.labels.detached import join_label
from solmap.photogrammetry.errors import LabelError, PhotogrammetryError, PixelError
from solmap.photogrammetry.frames import rover_frame, site_frame

LABEL = """PDS_VERSION_ID = PDS3
RECORD_BYTES = 512
^IMAGE = 5
SOURCE_PRODUCT_ID = ("2N1L", "2N1R")
GROUP = DERIVED_IMAGE_PARMS
  {derived}
  REFERENCE_COORD_SYSTEM_NAME = {frame}
  REFERENCE_COORD_SYSTEM_INDEX = {index}
END_GROUP = DERIVED_IMAGE_PARMS
OBJECT = IMAGE
  LINES = {lines}
  LINE_SAMPLES = {samples}
  BANDS = {bands}
  BAND_STORAGE_TYPE = {storage}
  SAMPLE_TYPE = {sample_type}
  SAMPLE_BITS = 32
  MISSING_CONSTANT = {missing}
END_OBJECT = IMAGE
END
"""


def raster(  # noqa: PLR0913 - the keywords of a label
    values,
    *,
    derived="DERIVED_IMAGE_TYPE = XYZ_MAP",
    frame="SITE_FRAME",
    index="137",
    storage="BAND_SEQUENTIAL",
    sample_type="IEEE_REAL",
    missing="0.0",
):
    """A file with the bands `values`, and its label."""
    stored = {
        "BAND_SEQUENTIAL": values,
        "LINE_INTERLEAVED": values.transpose(1, 0, 2),
        "SAMPLE_INTERLEAVED": values.transpose(1, 2, 0),
    }[storage]
    bands, lines, samples = values.shape
    label = LABEL.format(
        derived=derived,
        frame=frame,
        index=index,
        lines=lines,
        samples=samples,
        bands=bands,
        storage=storage,
        sample_type=sample_type,
        missing=missing,
    )
    order = "<f4" if sample_type == "PC_REAL" else ">f4"
    return label.encode().ljust(4 * 512) + stored.astype(order).tobytes()


@pytest.fixture
def xyz(rng):
    """Metres, with a point on each axis, where one or two of them are 0, and a hole."""
    values = rng.uniform(-40, 40, (3, 6, 9)).astype(np.float32)
    values[:, 0, :3] = np.eye(3)
    values[:, 2, 4] = 0
    return values


@pytest.mark.parametrize("storage", ["BAND_SEQUENTIAL", "LINE_INTERLEAVED", "SAMPLE_INTERLEAVED"])
@pytest.mark.parametrize("sample_type", ["IEEE_REAL", "PC_REAL"])
def test_xyz_is_read_in_every_order_of_bands_and_bytes(xyz, storage, sample_type):
    found = read_raster(raster(xyz, storage=storage, sample_type=sample_type), "x.img")
    assert (found.kind, found.frame) == (RasterKind.XYZ, site_frame(137))
    np.testing.assert_array_equal(found.bands, xyz)
    assert found.mask.sum() == found.mask.size - 1
    assert not found.mask[2, 4]  # (0, 0, 0) alone is nothing; a point on an axis is one


def test_a_disparity_points_to_the_pixel_of_the_partner_counted_from_zero(rng):
    line, sample = rng.uniform(1, 1024, (2, 5, 7)).astype(np.float32)
    line[3, 3] = sample[3, 3] = 0
    data = raster(np.stack([line, sample]), derived="DERIVED_IMAGE_TYPE = DISPARITY_MAP")
    found = read_raster(data, "2n292280938dilb100p0703l0m1.img")
    assert (found.kind, found.frame, found.partner) == (RasterKind.DISPARITY, None, "2N1R")
    np.testing.assert_allclose(found.bands[0][found.mask], sample[found.mask] - 1, atol=1e-4)
    np.testing.assert_allclose(found.bands[1][found.mask], line[found.mask] - 1, atol=1e-4)
    assert not found.mask[3, 3]
    assert (found.bands[:, 3, 3] == 0).all()


def test_a_range_has_one_band_and_no_frame(rng):
    metres = rng.uniform(1, 60, (1, 5, 7)).astype(np.float32)
    metres[0, 1, 1], metres[0, 2, 2] = 0, np.nan
    found = read_raster(raster(metres, derived=""), "2n292280938rnlb100p0703l0m1.img")
    assert (found.kind, found.frame) == (RasterKind.RANGE, None)
    assert found.mask.sum() == 33
    np.testing.assert_array_equal(found.bands[0][found.mask], metres[0][found.mask])
    assert np.isfinite(found.bands).all()


def test_a_stated_missing_constant_counts_besides_zero(xyz):
    xyz[:, 1, 1] = -1e30
    found = read_raster(raster(xyz, missing="-1e30"), "x.img")
    assert not found.mask[1, 1]
    assert not found.mask[2, 4]


def test_points_in_the_rover_frame_name_their_stop(xyz):
    found = read_raster(raster(xyz, frame="ROVER_FRAME", index="(137,4,0,13,7)"), "x.img")
    assert found.frame == rover_frame(137, 4)


def test_a_normal_has_a_frame_and_a_slope_degrees(xyz):
    normal = read_raster(raster(xyz, derived="DERIVED_IMAGE_TYPE = UVW_MAP"), "x.img")
    assert (normal.kind, normal.frame) == (RasterKind.NORMAL, site_frame(137))
    assert (normal.band_names, normal.unit) == (("u", "v", "w"), None)
    slope = read_raster(raster(xyz[:1], derived=""), "2n292280938sllb100p0703l0m1.img")
    assert (slope.kind, slope.frame) == (RasterKind.SLOPE, None)
    assert (slope.band_names, slope.unit) == (("slope",), "degree")


def test_a_raster_may_have_its_label_in_a_file_of_its_own(xyz):
    label, values = raster(xyz)[: 4 * 512], raster(xyz)[4 * 512 :]
    label = label.replace(b"^IMAGE = 5", b'^IMAGE = "X.IMG"')
    found = read_raster(join_label(label, values, "x.img"), "x.img")
    np.testing.assert_array_equal(found.bands, xyz)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            {"derived": "DERIVED_IMAGE_TYPE = IMAGE"},
            LabelError,
            "not a supported derived raster",
        ),
        ({"derived": "DERIVED_IMAGE_TYPE = RANGE_MAP"}, PixelError, "range should be 1 bands of"),
        ({"sample_type": "MSB_INTEGER"}, PixelError, "xyz should be 3 bands of IEEE reals"),
        ({"frame": "MOON_FRAME"}, LabelError, "should name a site or rover frame"),
        ({"frame": "ROVER_FRAME", "index": "137"}, LabelError, "and its counters"),
        ({"index": "-1"}, LabelError, "and its counters"),
    ],
)
def test_files_without_such_a_raster_are_refused(xyz, change, error, message):
    with pytest.raises(error, match=message):
        read_raster(raster(xyz, **change), "x.img")


def test_a_cut_off_raster_is_refused(xyz):
    data = raster(xyz)
    with pytest.raises(PixelError, match="truncated"):
        read_raster(data[:-1], "x.img")
    for cut in range(0, len(data), 97):
        with pytest.raises(PhotogrammetryError):
            read_raster(data[:cut], "x.img")
