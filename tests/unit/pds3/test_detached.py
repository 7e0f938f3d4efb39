import numpy as np
import pytest

from photogrammetry.errors import LabelError, PixelError
from photogrammetry.pds3.detached import file_of_label, with_attached_label
from photogrammetry.pds3.reading import has_attached_label, read_image, read_image_record

NAME = "2n292280938effb100p0703l0m1.img"


@pytest.fixture
def pixel_file(small):
    """Pixels behind 1024 bytes of something else, without a label."""
    return bytes(1024) + small.pixels.astype(">i2").tobytes()


@pytest.mark.parametrize(
    "pointer", ['("IMAGE.IMG", 3)', '("IMAGE.IMG", 1025 <BYTES>)', "3", "1025 <BYTES>"]
)
def test_a_detached_label_is_put_before_its_data(small, pixel_file, pointer):
    label = small.but("= 9\n", f"= {pointer}\n").label
    data = with_attached_label(pixel_file, label, NAME)
    assert has_attached_label(data)
    assert not has_attached_label(pixel_file)
    read = read_image(data, NAME)
    np.testing.assert_array_equal(read.pixels, small.pixels)
    assert data.endswith(pixel_file)
    assert label.encode() in data
    assert read_image_record(data, NAME).clock == read.image.clock
    apart = read_image(pixel_file, NAME, detached_label=label)
    np.testing.assert_array_equal(apart.pixels, read.pixels)


def test_a_pointer_to_a_whole_file_means_its_first_byte(small):
    label = small.but("= 9\n", '= "IMAGE.IMG"\n').label
    data = with_attached_label(small.pixels.astype(">i2").tobytes(), label, NAME)
    np.testing.assert_array_equal(read_image(data, NAME).pixels, small.pixels)
    assert file_of_label(label, NAME) == "IMAGE.IMG"
    assert file_of_label(small.label, NAME) is None


def test_data_that_are_too_short_or_a_label_that_is_broken_are_refused(small, pixel_file):
    label = small.but("= 9\n", '= ("IMAGE.IMG", 3)\n').label
    with pytest.raises(PixelError, match="truncated"):
        read_image(with_attached_label(pixel_file[:-1], label, NAME), NAME)
    with pytest.raises(LabelError, match=r"\^IMAGE is missing"):
        with_attached_label(pixel_file, small.but("^IMAGE ", "^OTHER ").label, NAME)
    with pytest.raises(LabelError, match="too long to be one"):
        with_attached_label(pixel_file, label + " " * (1 << 20), NAME)


def test_the_detached_labels_of_curiosity_say_what_the_attached_ones_do(shared_data):
    for stem in ("NLB_517261274EDR_F0541610CCAM15900M1", "NRB_680874728RAD_F0900232NCAM00354M1"):
        path = next(shared_data.rglob(f"{stem}.IMG"))
        data, label = path.read_bytes(), path.with_suffix(".LBL").read_text("latin-1")
        assert file_of_label(label, path.name) == path.name
        own = read_image(data, path.name)
        joined = read_image(with_attached_label(data, label, path.name), path.name)
        np.testing.assert_array_equal(joined.pixels, own.pixels)
        np.testing.assert_array_equal(joined.image.camera.centre, own.image.camera.centre)
        assert joined.image.stop == own.image.stop
        parent = joined.image.parent_from_site
        assert parent is not None
        assert parent.target.index[0] == own.image.stop.site - 1
