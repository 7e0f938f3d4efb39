from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.pixels import (
    demosaiced,
    pixel_layout,
    radiance_scale,
    read_pixels,
)
from solmap.photogrammetry.archive.labels.label import parse_label
from solmap.photogrammetry.errors import LabelError, PixelError


def read(image):
    return read_pixels(image.data, parse_label(image.label, "x.img"), "x.img")


@pytest.mark.parametrize(
    ("stored", "sample_type"),
    [
        (">i2", "MSB_INTEGER"),
        ("<i2", "LSB_INTEGER"),
        (">u2", "MSB_UNSIGNED_INTEGER"),
        ("<u2", "PC_UNSIGNED_INTEGER"),
        (">i4", "MSB_INTEGER"),
        (">f4", "IEEE_REAL"),
        ("<f4", "PC_REAL"),
        (">f8", "IEEE_REAL"),
    ],
)
def test_every_sample_type_gives_its_values(small, stored, sample_type):
    pixels, mask = read(replace(small, stored=stored, sample_type=sample_type))
    np.testing.assert_array_equal(pixels, small.pixels)
    assert pixels.dtype == np.float32
    assert mask.all()


def test_eight_bit_values_are_unsigned_for_any_label(rng, small):
    values = rng.integers(1, 256, (20, 30))
    for sample_type in ("UNSIGNED_INTEGER", "MSB_INTEGER"):
        image = replace(small, pixels=values, stored="u1", sample_type=sample_type)
        np.testing.assert_array_equal(read(image)[0], values)


def test_three_bands_become_their_mean(small, rng):
    bands = rng.integers(1, 200, (3, 10, 20))
    orders = {
        "BAND_SEQUENTIAL": bands,
        "LINE_INTERLEAVED": bands.transpose(1, 0, 2),
        "SAMPLE_INTERLEAVED": bands.transpose(1, 2, 0),
    }
    for storage, pixels in orders.items():
        image = replace(small, pixels=pixels, bands=3, storage=storage)
        np.testing.assert_allclose(read(image)[0], bands.mean(axis=0), rtol=1e-6)


def test_prefix_and_suffix_of_the_lines_are_skipped(small):
    padded = np.pad(small.pixels, ((0, 0), (2, 3)), constant_values=7)
    image = replace(small, pixels=padded).but(
        "LINE_SAMPLES                   = 65",
        "LINE_SAMPLES = 60\n LINE_PREFIX_BYTES = 4\n LINE_SUFFIX_BYTES = 6",
    )
    np.testing.assert_array_equal(read(image)[0], small.pixels)


def test_a_block_of_zeros_is_lost_but_a_dark_pixel_is_not(small):
    pixels = small.pixels.copy()
    pixels[10:15, 20:40] = 0  # a lost packet
    pixels[14:16, 39:41] = 0  # its ragged corner
    pixels[30, 5:15] = 0  # a lost line
    pixels[35, 50] = pixels[3, 3] = 0  # dark
    _, mask = read(replace(small, pixels=pixels))
    assert mask[35, 50]
    assert mask[3, 3]
    lost = pixels == 0
    lost[35, 50] = lost[3, 3] = False
    np.testing.assert_array_equal(~mask, lost)


def test_a_wholly_lost_image_has_an_empty_mask(small):
    _, mask = read(replace(small, pixels=np.zeros((5, 2))))
    assert not mask.any()


def test_a_stated_missing_constant_is_used(small):
    pixels = small.pixels.copy()
    pixels[5, 5] = -32768
    image = replace(small, pixels=pixels).but("= 0.0\n", "= -32768\n INVALID_CONSTANT = N/A\n")
    values, mask = read(image)
    assert np.argwhere(~mask).tolist() == [[5, 5]]
    assert values[5, 5] == 0


def test_in_a_float_raster_zero_and_nan_are_missing(small):
    pixels = small.pixels.astype(float)
    pixels[1, 1], pixels[2, 2], pixels[3, 3] = 0.0, np.nan, np.inf
    values, mask = read(replace(small, pixels=pixels, stored=">f4", sample_type="IEEE_REAL"))
    assert np.argwhere(~mask).tolist() == [[1, 1], [2, 2], [3, 3]]
    assert np.isfinite(values).all()


def test_a_truncated_file_is_refused_with_its_size_and_the_required_one(small):
    data = small.data[:-100]
    with pytest.raises(PixelError, match=r"x.img: truncated: needs 8896 bytes .* has 8796"):
        read_pixels(data, parse_label(small.label, "x.img"), "x.img")


def test_the_pointer_may_count_bytes_or_name_a_file(small):
    head = 8 * 512
    for pointer in (f"{head + 1} <BYTES>", '("X.IMG", 9)', f'("X.IMG", {head + 1} <BYTES>)'):
        image = small.but("^IMAGE                           = 9", f"^IMAGE = {pointer}")
        assert pixel_layout(parse_label(image.label, "x")).offset == head
    image = small.but("^IMAGE                           = 9", '^IMAGE = "X.DAT"')
    assert pixel_layout(parse_label(image.label, "x")).offset == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("^IMAGE ", "^OTHER ", r"\^IMAGE, the position of the pixels, is missing from the label"),
        ("^IMAGE                           = 9", "^IMAGE = 0", r"\^IMAGE should be a record"),
        ("RECORD_BYTES                     = 512", "RECORD_BYTES = 0", "RECORD_BYTES should be"),
        ("= MSB_INTEGER", "= VAX_REAL", "SAMPLE_TYPE 'VAX_REAL' of 16 bits is not read"),
        ("SAMPLE_BITS                    = 16", "SAMPLE_BITS = 12", "of 12 bits is not read"),
        ("LINES                          = 40", "LINES = -1", "IMAGE/LINES should be above zero"),
        ("LINES                          = 40", "LINES = 99999999", "no rover image is that large"),
        ("LINES                          = 40", "LINE = 40", "IMAGE/LINES is missing"),
        ("BANDS                          = 1", "BANDS = 7", "expected 1 or 3 bands"),
    ],
)
def test_an_impossible_layout_is_refused(small, old, new, message):
    with pytest.raises((LabelError, PixelError), match=message):
        pixel_layout(parse_label(small.but(old, new).label, "x.img"))


def test_radiance_is_scaled_by_the_label(small):
    assert radiance_scale(parse_label(small.label, "x")) is None
    text = "GROUP=DERIVED_IMAGE_PARMS RADIANCE_SCALING_FACTOR=1e-5 <W> END_GROUP END"
    scale = radiance_scale(parse_label(text, "x"))
    assert scale is not None
    assert (scale.factor, scale.offset) == (1e-5, 0.0)


def test_smooth_colours_are_recovered_from_a_bayer_frame():
    line, sample = np.indices((12, 18))
    colours = np.stack([100 + 2 * sample, 200 + 3 * line, 300 + sample + line]).astype(np.float32)
    mosaic = np.take_along_axis(colours, (line % 2 + sample % 2)[None], 0)[0]
    mask = np.ones(mosaic.shape, bool)
    inside = np.s_[:, 1:-1, 1:-1]
    np.testing.assert_allclose(demosaiced(mosaic, mask)[inside], colours[inside], rtol=1e-6)
    mask[5, 7] = False  # what was lost there is no neighbour
    off = np.where(mask, demosaiced(np.where(mask, mosaic, 0), mask) - colours, 0)
    assert np.abs(off[inside]).max() <= 3
