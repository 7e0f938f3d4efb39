import cv2
import numpy as np
import pytest

from solmap.photogrammetry.archive.images.pixels import (
    image_file_size,
    read_colour_image_file,
    read_image_file,
)
from solmap.photogrammetry.errors import PixelError


def encoded(values, suffix):
    return cv2.imencode(suffix, values)[1].tobytes()


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_an_image_file_is_read_with_its_missing_patch(rng, suffix):
    values = rng.integers(90, 200, (60, 80), dtype=np.uint8)
    values[10:40, 20:60] = 0
    pixels, mask = read_image_file(encoded(values, suffix), "x")
    assert image_file_size(encoded(values, suffix), "x") == (80, 60)
    if suffix == ".png":
        np.testing.assert_array_equal(pixels, values)
        np.testing.assert_array_equal(mask, values > 0)
    assert not mask[16:32, 24:56].any()  # whole blocks of a JPEG stay black


def test_colours_are_averaged(rng):
    values = rng.integers(1, 200, (6, 8, 3), dtype=np.uint8)
    pixels, mask = read_image_file(encoded(values, ".png"), "x")
    np.testing.assert_allclose(pixels, values.mean(axis=2), rtol=1e-6)
    assert mask.all()
    bands, _ = read_colour_image_file(encoded(values, ".png"), "x")
    np.testing.assert_array_equal(bands, values[:, :, ::-1].transpose(2, 0, 1))  # OpenCV: BGR
    grey = np.repeat(values[:, :, :1], 3, axis=2)
    assert read_colour_image_file(encoded(grey, ".png"), "x") is None


def test_a_small_file_cannot_request_much_memory(rng):
    data = bytearray(encoded(rng.integers(1, 200, (6, 8), dtype=np.uint8), ".png"))
    data[16:24] = (60_000).to_bytes(4, "big") * 2
    with pytest.raises(PixelError, match="60000 x 60000 pixels: no rover image"):
        read_image_file(bytes(data), "x")


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_cut_off_or_foreign_file_is_refused_or_read(rng, suffix):
    data = encoded(rng.integers(1, 200, (30, 40), dtype=np.uint8), suffix)
    for cut in (0, 3, 20, 30):
        with pytest.raises(PixelError, match=r"^x: "):
            read_image_file(data[:cut], "x")
    with pytest.raises(PixelError, match="neither a PNG nor a JPEG"):
        read_image_file(b"GIF89a" + data, "x")


def test_raw_images_of_curiosity_and_perseverance_are_read(shared_data):
    sizes = {
        "NLB_524534514EDR*.jpeg": (1024, 1024),
        "NRB_524534514EDR*.jpeg": (1024, 1024),
        "NLF_0670_*.png": (968, 1288),
    }
    for pattern, shape in sizes.items():
        path = next(shared_data.rglob(pattern))
        pixels, mask = read_image_file(path.read_bytes(), path.name)
        assert pixels.shape == shape
        assert mask.mean() > 0.98
        assert pixels.std() > 10


def test_image_files_that_unpack_to_more_than_declared_are_refused_unread(rng):
    deep = bytearray(encoded(rng.integers(1, 200, (6, 8), dtype=np.uint8), ".png"))
    deep[24] = 16
    scans = encoded(rng.integers(1, 200, (30, 40), dtype=np.uint8), ".jpg") + b"\xff\xda" * 40
    for data in (bytes(deep), scans):
        with pytest.raises(PixelError, match="not an image of 8 bits in at most 32 scans"):
            read_image_file(data, "x")
