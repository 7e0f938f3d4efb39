import numpy as np
import pytest

from solmap.photogrammetry.archive.images.pixels import (
    full_scale,
    read_pixels,
    received_mask,
    saturated_mask,
)
from solmap.photogrammetry.archive.images.radiometry import (
    Companding,
    InverseTable,
    RadialVignetting,
    Radiometry,
    companding_name,
    divide_by_flat_field,
    expand_codes,
    needs_flat_field,
    square_root_table,
)
from solmap.photogrammetry.archive.images.reading import read_image, read_label
from solmap.photogrammetry.errors import LabelError, PixelError

NAME = "2n292280938effb100p0703l0m1.img"
STATE = "GROUP                            = INSTRUMENT_STATE_PARMS\n"
SEGMENTS = """GROUP = COMPRESSION_PARMS
  INST_CMPRS_SEGMENT_STATUS = {status}
  INST_CMPRS_SEG_FIRST_LINE = (1,1,21)
  INST_CMPRS_SEG_FIRST_LINE_SAMP = (1,31,1)
  INST_CMPRS_SEG_LINES = (20,20,20)
  INST_CMPRS_SEG_SAMPLES = (30,30,60)
  INST_CMPRS_SEG_MISSING_PIXELS = {missing}
END_GROUP = COMPRESSION_PARMS
"""


def with_segments(small, status="(0,0,0)", missing='"N/A"'):
    return small.but(STATE, SEGMENTS.format(status=status, missing=missing) + STATE)


@pytest.mark.parametrize("quote", ["", '"'])
def test_an_incomplete_segment_is_masked(small, quote):
    status = f"({quote}0{quote},{quote}3{quote},{quote}0{quote})"
    read = read_image(with_segments(small, status).data, NAME)
    lost = np.zeros((40, 60), dtype=bool)
    lost[:20, 30:] = True
    np.testing.assert_array_equal(read.mask, ~lost)
    assert read.notes == ("600 pixels are masked: their segments are marked as lost in the label",)


def test_a_segment_without_a_single_pixel_is_masked_and_one_with_some_is_not(small):
    read = read_image(with_segments(small, missing="(0,599,1200)").data, NAME)
    assert read.mask[:20].all()
    assert not read.mask[20:].any()


def test_complete_segments_mask_nothing_and_need_no_place(small):
    assert read_image(with_segments(small).data, NAME).mask.all()
    unplaced = with_segments(small).but("(1,31,1)", '"N/A"')
    assert read_image(unplaced.data, NAME).notes == ()


def test_a_lost_segment_without_a_place_is_refused(small):
    broken = with_segments(small, "(0,0,5)").but("(1,31,1)", "(1,31)")
    with pytest.raises(LabelError, match=r"SEG_FIRST_LINE_SAMP should have .* for segment 3"):
        read_image(broken.data, NAME)


def test_segments_outside_the_image_are_ignored(small):
    far = with_segments(small, "(0,0,5)").but("(1,1,21)", "(1,1,99999999)")
    assert read_image(far.data, NAME).mask.all()


def test_segments_of_a_raw_frame_do_not_apply_to_its_linearised_image(small):
    label = read_label(with_segments(small, "(1,1,1)").but("RAW", "LINEARIZED").data, NAME)
    assert received_mask(label, 40, 60).all()


def test_every_real_segment_is_complete(shared_data):
    for path in sorted(shared_data.rglob("*.[iI][mM][gG]")):
        label = read_label(path.read_bytes(), path.name)
        assert received_mask(label, 64, 64).all()


def with_bits(small, mask):
    return small.but("  MISSING_CONSTANT", f"  SAMPLE_BIT_MASK = {mask}\n  MISSING_CONSTANT")


def test_a_pixel_at_the_converter_limit_is_saturated(small):
    small.pixels[3, 4:9] = 4095
    for mask in ("2#0000111111111111#", "4095", '"0000111111111111"'):
        read = read_image(with_bits(small, mask).data, NAME)
        assert read.saturated.sum() == (small.pixels == 4095).sum() >= 5
        assert read.mask[3, 4:9].all()
    assert not read_image(small.data, NAME).saturated.any()


@pytest.mark.parametrize("mask", ["2#1010#", "0", '"N/A"', '"many"', "2#1111111111111111#"])
def test_a_mask_that_is_not_a_row_of_bits_gives_no_full_scale(small, mask):
    label = read_label(with_bits(small, mask).data, NAME)
    assert full_scale(label) is None
    assert not saturated_mask(np.full((2, 2), 4095, np.float32), label).any()


def coded(small):
    """The image as 8-bit codes of LUT3."""
    state = (
        STATE
        + '  SAMPLE_BIT_MODE_ID = "LUT3"\n  SAMPLE_BIT_METHOD = SOFTWARE\n'
        + "  FLAT_FIELD_CORRECTION_FLAG = FALSE\n"
    )
    codes = small.pixels % 255 + 1
    return with_bits(type(small)(codes).but(STATE, state), "2#0000000011111111#")


def test_codes_without_a_table_stay_codes_and_are_marked(small):
    image = coded(small)
    read = read_image(image.data, NAME)
    np.testing.assert_array_equal(read.pixels, image.pixels)
    assert read.notes == ("pixels are 8-bit codes of LUT3, not counts: no inverse table was given",)


def test_a_table_decodes_codes_into_counts(small):
    image = coded(small)
    table = InverseTable("LUT3", np.arange(256, dtype=np.float32) * 16, "a test")
    read = read_image(
        image.data, NAME, radiometry=Radiometry(companding=Companding({"LUT3": table}))
    )
    np.testing.assert_array_equal(read.pixels, image.pixels * 16)
    assert read.notes == ()


def test_the_approximation_is_marked_as_one(small):
    image = coded(small)
    radiometry = Radiometry(companding=Companding(approximate=True))
    read = read_image(image.data, NAME, radiometry=radiometry)
    np.testing.assert_allclose(read.pixels, 4095 * (image.pixels / 255) ** 2, rtol=1e-6)
    assert read.notes == ("pixels are counts by the square root approximation of LUT3",)


def test_the_approximation_agrees_with_the_counts_of_an_archived_frame(shared_data):
    """Sol 4090's Pancam frame was inverted with the true LUT3, so its values are the table's.

    99.5 percent of the pixels have one of 59 values, the others were interpolated over bad pixels.
    The codes themselves are not in the file: the first is taken to be the one that fits best.
    """
    path = next(shared_data.rglob("1P491287702ILF*.IMG"))
    data = path.read_bytes()
    label = read_label(data, path.name)
    assert companding_name(label) is None  # it was inverted
    values, counts = np.unique(read_pixels(data, label, path.name)[0], return_counts=True)
    of_table = values[counts > 300]
    assert len(of_table) == 59
    table = square_root_table("LUT3").counts
    worst = min(
        np.abs(table[first : first + 59] - of_table).max() for first in range(len(table) - 58)
    )
    assert worst < 11
    assert np.diff(of_table).min() == 18  # so no value differs by as much as one code


def test_a_table_that_falls_or_is_short_is_refused():
    with pytest.raises(PixelError, match="expected 256 non-decreasing counts"):
        InverseTable("LUT1", np.arange(255, dtype=np.float32), "a test")
    with pytest.raises(PixelError, match="inverse table LUT1"):
        InverseTable("LUT1", np.arange(256, dtype=np.float32)[::-1].copy(), "a test")
    with pytest.raises(PixelError, match="up to 300 are not 8-bit codes of LUT1"):
        expand_codes(np.full((2, 2), 300, np.float32), square_root_table("LUT1"))


def not_flattened(small):
    return small.but(STATE, STATE + "  FLAT_FIELD_CORRECTION_FLAG = FALSE\n")


def test_a_flat_field_is_removed_only_if_the_label_states_that_it_was_not(small):
    model = RadialVignetting(k1=-0.3)
    flat = model.flat_field(40, 60)
    assert flat.max() <= 1
    assert flat[0, 0] < 0.75
    radiometry = Radiometry(flat_fields={"NAVCAM_LEFT": flat})
    read = read_image(not_flattened(small).data, NAME, radiometry=radiometry)
    np.testing.assert_allclose(read.pixels, small.pixels / flat, rtol=1e-6)
    for done in (
        not_flattened(small).but("FLAG = FALSE", "FLAG = TRUE"),
        not_flattened(small).but("RAW", "LINEARIZED"),
        small,
    ):
        assert not needs_flat_field(read_label(done.data, NAME))
        done_pixels = read_image(done.data, NAME, radiometry=radiometry).pixels
        np.testing.assert_array_equal(done_pixels, small.pixels)


def test_a_sub_frame_uses_its_part_of_the_flat_field(small):
    averaged = (
        not_flattened(small)
        .but("AVERAGING_HEIGHT         = 1", "AVERAGING_HEIGHT         = 2")
        .but("AVERAGING_WIDTH          = 1", "AVERAGING_WIDTH          = 2")
        .but("  MISSING", "  FIRST_LINE = 11\n  FIRST_LINE_SAMPLE = 21\n  MISSING")
    )
    label = read_label(averaged.data, NAME)
    flat = RadialVignetting(k1=-0.2, k2=-0.1, centre=(80.0, 50.0)).flat_field(128, 160)
    part = flat[10:90, 20:140].reshape(40, 2, 60, 2).mean(axis=(1, 3))
    pixels = small.pixels.astype(np.float32)
    np.testing.assert_allclose(divide_by_flat_field(pixels, label, flat), pixels / part, rtol=1e-5)
    with pytest.raises(PixelError, match="lines 11-90, samples 21-140 of the detector are not"):
        divide_by_flat_field(pixels, label, flat[:80])


def test_a_vignetting_model_that_reaches_zero_is_refused():
    with pytest.raises(PixelError, match=r"at the edge; expected more than 0.05"):
        RadialVignetting(k1=-0.6).flat_field(1024, 1024)
