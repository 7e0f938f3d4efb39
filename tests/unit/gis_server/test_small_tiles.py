"""Tiles as WebP show what PNG shows: legend colours exactly, shades nearly, in fewer bytes."""

import cv2
import numpy as np
import pytest

from solmap.gis_server.rendering.png import colour_png, indexed_png
from solmap.gis_server.rendering.styles import palette_of
from solmap.gis_server.rendering.webp import colour_webp, indexed_webp
from solmap.products.formats.raster.styles import GREY, VIRIDIS
from solmap.products.formats.raster.tiling import zoom_of
from solmap.products.model import ProductKind
from tests.support.tile_at import tile_at
from tests.unit.gis_server.conftest import CELL_M, UNSEEN_WEST_OF_M, image_in, ref_of

OWN_ZOOM = zoom_of(CELL_M)
EDGE = tile_at(UNSEEN_WEST_OF_M, 0.1, OWN_ZOOM)
"""A tile of which the west was not seen."""
SHADES_RMS = 3.0


def requested(client, world, kind, address, form, **query):
    ref = ref_of(world, kind)
    place = f"{ref.scope.name}/{kind}/{ref.digest}"
    path = f"/tiles/{place}/{address.zoom}/{address.column}/{address.row}.{form}"
    return client.get(path, params=query)


def both(client, world, kind, **query):
    answers = [requested(client, world, kind, EDGE, form, **query) for form in ("png", "webp")]
    assert [answer.headers["content-type"] for answer in answers] == ["image/png", "image/webp"]
    return [image_in(answer.content).astype(int) for answer in answers]


@pytest.mark.parametrize(
    ("kind", "style"),
    [
        (ProductKind.DTM, "default"),
        (ProductKind.DTM, "contours"),
        (ProductKind.SLOPE, "default"),
        (ProductKind.HAZARD, "default"),
    ],
)
def test_colours_of_a_legend_and_their_opacity_are_exact(client, world, kind, style):
    png, webp = both(client, world, kind, style=style)
    seen = png[..., 3] > 0
    assert seen.any()
    np.testing.assert_array_equal(webp[..., 3], png[..., 3])
    np.testing.assert_array_equal(webp[seen], png[seen])


@pytest.mark.parametrize(
    ("kind", "style"), [(ProductKind.ORTHOPHOTO, "default"), (ProductKind.DTM, "shaded-relief")]
)
def test_shades_differ_invisibly_and_opacity_is_exact(client, world, kind, style):
    png, webp = both(client, world, kind, style=style)
    seen = png[..., 3] > 0
    assert seen.any()
    assert not seen.all()
    np.testing.assert_array_equal(webp[..., 3], png[..., 3])
    assert np.sqrt(np.mean((webp[seen] - png[seen]) ** 2)) < SHADES_RMS


def test_unmeasured_tiles_are_answered_without_content_each_time(client, world):
    far = tile_at(5_000.0, 0.1, OWN_ZOOM)
    for _ in range(2):
        answer = requested(client, world, ProductKind.DTM, far, "webp")
        assert (answer.status_code, answer.content) == (204, b"")
        assert "immutable" in answer.headers["cache-control"]


def test_a_tile_of_another_style_is_another_tile(client, world):
    plain, grey, again = (
        requested(client, world, ProductKind.DTM, EDGE, "webp", **query).content
        for query in ({}, {"colours": "grey"}, {})
    )
    assert plain == again
    assert plain != grey


def test_a_style_that_the_layer_lacks_is_refused_as_for_png(client, world):
    answers = [
        requested(client, world, ProductKind.SLOPE, EDGE, form, style="hillshade").json()
        for form in ("png", "webp")
    ]
    assert answers[0]["detail"] == answers[1]["detail"]
    assert {answer["status"] for answer in answers} == {422}


def test_noisy_ground_takes_fewer_bytes_than_png(rng):
    smooth = cv2.GaussianBlur(rng.normal(128.0, 60.0, (256, 256)), (0, 0), 3.0)
    noisy = np.clip(smooth + rng.normal(0.0, 4.0, smooth.shape), 1, 255).astype(np.uint8)
    photograph = np.stack([noisy, noisy // 2, noisy // 3], axis=-1)
    assert len(colour_webp(photograph)) < 0.7 * len(colour_png(photograph))
    for colours, share in ((GREY, 0.7), (VIRIDIS, 1.0)):
        palette = palette_of(colours)
        assert len(indexed_webp(noisy, palette)) < share * len(indexed_png(noisy, palette))
