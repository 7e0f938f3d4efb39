import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.archive.images.reading import (
    describe_image,
    has_attached_label,
    read_image,
    read_image_record,
    read_label,
)
from solmap.photogrammetry.archive.labels.detached import (
    MAX_DETACHED_BYTES,
    LabelKind,
    decode_label,
    join_label,
    kind_of_label,
    split_label,
)
from solmap.photogrammetry.archive.labels.label import MAX_LABEL_BYTES
from solmap.photogrammetry.errors import LabelError, PixelError

NAME = "2n292280938effb100p0703l0m1.img"
XML = (Path(__file__).parent / "navcam_of_perseverance.xml").read_bytes()


@pytest.fixture
def pixel_file(small):
    """Pixels behind 1024 bytes of something else, without a label."""
    return bytes(1024) + small.pixels.astype(">i2").tobytes()


@given(label=st.binary(max_size=200), data=st.binary(max_size=200))
def test_label_and_data_are_split_without_change(label, data):
    assert split_label(join_label(label, data, NAME), NAME) == (label, data)


def test_an_attached_label_is_kept_unchanged(small):
    assert split_label(small.data, NAME) == (None, small.data)


@pytest.mark.parametrize(
    "pointer", ['("IMAGE.IMG", 3)', '("IMAGE.IMG", 1025 <BYTES>)', "3", "1025 <BYTES>"]
)
def test_an_image_joined_to_its_label_is_read_like_one_with_an_attached_label(
    small, pixel_file, pointer
):
    label = small.but("= 9\n", f"= {pointer}\n").label
    data = join_label(label.encode(), pixel_file, NAME)
    assert not has_attached_label(data)
    read = read_image(data, NAME)
    np.testing.assert_array_equal(read.pixels, small.pixels)
    assert read_image_record(data[:MAX_LABEL_BYTES], NAME).clock == read.image.clock
    assert read_label(data, NAME).groups == read_label(label.encode(), NAME).groups
    beside = read_image(pixel_file, NAME, detached_label=label)
    np.testing.assert_array_equal(beside.pixels, read.pixels)


def test_a_pointer_without_an_offset_means_the_first_byte(small):
    label = small.but("= 9\n", '= "IMAGE.IMG"\n').label
    data = join_label(label.encode(), small.pixels.astype(">i2").tobytes(), NAME)
    np.testing.assert_array_equal(read_image(data, NAME).pixels, small.pixels)


def test_a_pds4_label_may_be_joined_too(rng):
    pixels = rng.integers(1, 255, (3, 2, 3), dtype=np.uint8)
    name = "NLF_0629_0722782785_631ECM_N0301344NCAM00427_06_095J01.IMG"
    read = read_image(join_label(XML, bytes(16) + pixels.tobytes(), name), name)
    np.testing.assert_allclose(read.pixels, pixels.mean(axis=0), rtol=1e-6)
    assert read.image.sol == 629


def test_a_label_may_describe_a_png_or_jpeg(small):
    """Public raw images are eight-bit images; their sizes have to agree with the label."""
    grey = (small.pixels % 251 + 1).astype(np.uint8)
    label = small.but("= 9\n", '= "IMAGE.PNG"\n').label.encode()
    image = cv2.imencode(".png", grey)[1].tobytes()
    np.testing.assert_array_equal(read_image(join_label(label, image, NAME), NAME).pixels, grey)
    other = cv2.imencode(".jpg", grey[:20])[1].tobytes()
    with pytest.raises(PixelError, match="image is 60 x 20 pixels, its label has 60 x 40"):
        read_image(join_label(label, other, NAME), NAME)


def test_metadata_of_a_raw_image_replace_its_label(shared_data):
    path = next(shared_data.rglob("NLF_0670_*-metadata.json"))
    metadata = json.loads(path.read_text()) | {"attitude": "(0.8,0.0,0.0,0.6)"}
    image = path.with_name(path.name.replace("-metadata.json", ".png"))
    data = join_label(json.dumps(metadata).encode(), image.read_bytes(), image.name)
    read = read_image(data, image.name)
    assert read.pixels.shape == (read.image.lines, read.image.samples) == (968, 1288)
    assert read.notes == ()
    described = describe_image(data, image.name)
    assert described.label is None
    assert (described.state.code, described.state.darkened_by) == (None, None)
    with pytest.raises(LabelError, match="it has JSON metadata instead of a label"):
        read_label(data, image.name)


def test_data_that_are_too_short_or_a_label_that_is_broken_are_refused(small, pixel_file):
    label = small.but("= 9\n", '= ("IMAGE.IMG", 3)\n').label.encode()
    with pytest.raises(PixelError, match="truncated"):
        read_image(join_label(label, pixel_file[:-1], NAME), NAME)
    without = small.but("^IMAGE ", "^OTHER ").label.encode()
    with pytest.raises(LabelError, match=r"\^IMAGE, the position of the pixels, is missing"):
        read_image(join_label(without, pixel_file, NAME), NAME)
    with pytest.raises(LabelError, match="too many for a label"):
        join_label(label.ljust(MAX_DETACHED_BYTES + 1), pixel_file, NAME)
    with pytest.raises(LabelError, match=r"should be \d+ bytes, but the file ends after 1000"):
        split_label(
            join_label(label, pixel_file, NAME)[: len(join_label(b"", b"", NAME)) + 1000], NAME
        )


def test_the_first_character_identifies_the_label_format():
    assert kind_of_label("\ufeff <?xml") is LabelKind.PDS4
    assert kind_of_label("\n{") is LabelKind.METADATA
    assert kind_of_label("PDS_VERSION_ID = PDS3") is LabelKind.PDS3
    assert decode_label("\ufeffä".encode()) == "ä"
    assert decode_label(b"\xe4") == "ä"


def test_detached_labels_of_curiosity_agree_with_the_attached_ones(shared_data):
    for stem in ("NLB_517261274EDR_F0541610CCAM15900M1", "NRB_680874728RAD_F0900232NCAM00354M1"):
        path = next(shared_data.rglob(f"{stem}.IMG"))
        data, label = path.read_bytes(), path.with_suffix(".LBL").read_bytes()
        own = read_image(data, path.name)
        both = read_image(join_label(label, data, path.name), path.name)
        np.testing.assert_array_equal(both.pixels, own.pixels)
        np.testing.assert_array_equal(both.image.camera.centre, own.image.camera.centre)
        assert both.image.stop == own.image.stop
        parent = both.image.parent_from_site
        assert parent is not None
        assert parent.target.index[0] == own.image.stop.site - 1
