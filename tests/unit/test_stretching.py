import numpy as np

from solmap.photogrammetry.stretching import stretch


def test_percentiles_of_usable_pixels_become_black_and_white(rng):
    image = rng.uniform(100, 900, (60, 80)).astype(np.float32)
    mask = np.ones(image.shape, dtype=bool)
    image[:5], mask[:5] = 1e6, False  # would take the whole range if it counted
    png = stretch(image, mask, 5.0, 90.0)
    black, white = np.percentile(image[mask], [5.0, 90.0])
    np.testing.assert_array_equal(png == 0, image < black + (white - black) / 255)
    np.testing.assert_array_equal(png[mask] == 255, image[mask] >= white)
    assert (png[:5] == 255).all()


def test_a_uniform_or_unusable_image_is_drawn_too():
    even = np.full((4, 5), 7.0, dtype=np.float32)
    assert not stretch(even, np.ones((4, 5), dtype=bool)).any()
    ramp = np.arange(20, dtype=np.float32).reshape(4, 5)
    np.testing.assert_array_equal(
        stretch(ramp, np.zeros((4, 5), dtype=bool)), stretch(ramp, np.ones((4, 5), dtype=bool))
    )
