"""Which filters make a colour orthophoto, and the orthophoto itself."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, build_dtm
from solmap.photogrammetry.terrain.orthophoto.colour import colour_filters
from solmap.photogrammetry.terrain.orthophoto.rendering import (
    OrthophotoParams,
    prepare_orthophoto,
)
from tests.support.terrain.orthophotos import render_orthophoto


@pytest.mark.parametrize(
    ("there", "shown"),
    [
        ({2, 3, 4, 5, 6, 7}, (4, 5, 6)),
        ({2, 5, 7}, (2, 5, 7)),
        ({2, 5, 6}, (2, 5, 6)),
        ({3, 5, 7}, (3, 5, 7)),
        ({2, 4, 6, 7}, None),
        ({2}, None),
        ((), None),
    ],
)
def test_the_filters_nearest_to_screen_primaries_are_used(there, shown):
    assert colour_filters(there) == shown


def stripes(width_m):
    return lambda east, north: 100 + 50 * np.sin(2 * np.pi * (east + north) / width_m)


@pytest.fixture(scope="module")
def coloured(scenes):
    """Two views of level ground through three filters, each of another exposure."""
    views, bands = [], []
    for number, azimuth in enumerate((-15, 15)):
        images = [
            scenes.view_of(scenes.level, azimuth_deg=azimuth, pair=number, albedo=stripes(width))
            for width in (0.8, 1.2, 1.6)
        ]
        views.append(images[0])
        bands.append([view.image * np.float32(1 + 0.1 * number) for view in images])
    return build_dtm(views, DtmParams(max_relative_sigma=0.05)), views, bands


def test_every_band_is_registered_and_balanced_by_itself(coloured):
    made = prepare_orthophoto(*coloured[:2], OrthophotoParams(), coloured[2])
    east, north = np.meshgrid(*made.grid.centres())
    assert made.balance.shape == (2, 3, 2)
    checked = 0
    for block in made.blocks():
        rows, cols = block.brightness.shape[1:]
        here = (slice(block.row, block.row + rows), slice(block.col, block.col + cols))
        near = np.hypot(east[here], north[here]) < 4.0
        for band, width in enumerate((0.8, 1.2, 1.6)):
            cells = near & np.isfinite(block.brightness[band])
            error = (
                block.brightness[band][cells]
                - 1.05 * stripes(width)(east[here], north[here])[cells]
            )
            if cells.sum() > 1000:
                assert np.percentile(np.abs(error), 90) < 8.0
                checked += 1
    assert checked >= 3


def test_one_band_equals_the_image_itself(coloured):
    dtm, views, bands = coloured
    plain = [replace(view, image=images[0]) for view, images in zip(views, bands, strict=True)]
    grey = render_orthophoto(dtm, plain, OrthophotoParams())
    for block in prepare_orthophoto(dtm, views, OrthophotoParams(), bands).blocks():
        rows, cols = block.brightness.shape[1:]
        whole = grey.brightness[block.row : block.row + rows, block.col : block.col + cols]
        np.testing.assert_array_equal(block.brightness[0], whole)
