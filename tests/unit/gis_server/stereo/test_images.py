"""Images as served: raw, stretched, linearised, in stereo, whole and in tiles."""

import cv2
import numpy as np
import pytest

from solmap.gis_server.rendering.images import ArrayCache
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.resampling import resample
from solmap.products.catalogue.oriented_images import geometry_of, matched_record, matches_of

pytestmark = pytest.mark.slow  # a world is rendered first


def left_of(stereo):
    return next(entry for entry in stereo.entries if entry.eye == "left")


def png(client, address, **query):
    answer = client.get(address, params=query)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "image/png"
    return cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)


def stored(stereo, entry):
    path = stereo.workspace.store.path(entry.ref)
    return read_image(path.read_bytes(), f"{entry.id}.IMG")


def test_the_raw_image_is_the_delivered_one(stereo, stereo_client):
    entry = left_of(stereo)
    pixels = stored(stereo, entry).pixels
    shown = png(stereo_client, f"/images/{entry.id}/raw.png")
    assert shown.dtype == np.uint8
    assert np.abs(shown - pixels * (255 / 4095)).max() <= 0.51


def test_a_stretch_runs_between_its_percentiles(stereo, stereo_client):
    entry = left_of(stereo)
    pixels = stored(stereo, entry).pixels
    low, high = np.percentile(pixels, [5, 90])
    shown = png(stereo_client, f"/images/{entry.id}/stretched.png", low=5, high=90)
    assert np.abs(shown - np.clip((pixels - low) / (high - low), 0, 1) * 255).max() <= 0.51
    set_by_hand = png(
        stereo_client, f"/images/{entry.id}/stretched.png", black=100, white=2000, gamma=2
    )
    expected = np.clip((pixels - 100) / 1900, 0, 1) ** 0.5 * 255
    assert np.abs(set_by_hand - expected).max() <= 0.51


def test_the_linearised_image_is_the_one_used_for_matching(stereo, stereo_client):
    entry = left_of(stereo)
    read = stored(stereo, entry)
    geometry = geometry_of(matches_of(entry, stereo.workspace), stereo.workspace)
    camera = matched_record(entry, stereo.workspace).camera
    image, mask = resample(read.pixels, read.mask, camera, geometry, Eye.LEFT)
    low, high = np.percentile(image[mask], [1, 99])
    shown = png(stereo_client, f"/images/{entry.id}/linearised.png")
    assert shown.shape == image.shape
    expected = np.clip((image - low) / (high - low), 0, 1) * 255
    assert np.abs(shown[mask] - expected[mask]).max() <= 0.51


def test_an_anaglyph_is_left_in_red_and_right_in_cyan_shifted(stereo, stereo_client):
    entry = left_of(stereo)
    left = png(stereo_client, f"/images/{entry.id}/linearised.png")
    right = png(stereo_client, f"/images/{entry.partner}/linearised.png")
    for image in (entry.id, entry.partner):
        shown = png(stereo_client, f"/images/{image}/anaglyph.png", shift_px=7)
        assert (shown[:, :, 2] == left).all()
        assert (shown[:, :, 1] == shown[:, :, 0]).all()
        assert (shown[:, 7:, 0] == right[:, :-7]).all()
        assert not shown[:, :7, 0].any()


@pytest.mark.parametrize("style", ["raw", "stretched", "linearised", "anaglyph"])
def test_the_tiles_of_the_highest_zoom_are_the_image(stereo, stereo_client, style):
    entry = left_of(stereo)
    info = stereo_client.get(f"/images/{entry.id}/info").json()["styles"][style]
    whole = png(stereo_client, info["picture"], shift_px=3)
    assert whole.shape[:2] == (info["lines"], info["samples"])
    z, tile = info["max_zoom"], info["tile_px"]
    rows = []
    for y in range(-(-info["lines"] // tile)):
        row = [
            png(stereo_client, info["tiles"].format(z=z, x=x, y=y), shift_px=3)
            for x in range(-(-info["samples"] // tile))
        ]
        rows.append(np.concatenate(row, axis=1))
    assert (np.concatenate(rows) == whole).all()


def test_an_unchanged_image_is_not_sent_again(stereo, stereo_client):
    address = f"/images/{left_of(stereo).id}/stretched.png"
    tag = stereo_client.get(address).headers["etag"]
    assert stereo_client.get(address, headers={"if-none-match": tag}).status_code == 304
    other = stereo_client.get(f"{address}?gamma=2", headers={"if-none-match": tag})
    assert other.status_code == 200


def test_a_point_is_transformed_to_the_linearised_image_and_back(stereo, stereo_client):
    address = f"/images/{left_of(stereo).id}/point"
    there = stereo_client.get(address, params={"sample": 90.25, "line": 140.5}).json()
    back = stereo_client.get(
        address,
        params={
            "sample": there["linearised_sample"],
            "line": there["linearised_line"],
            "given": "linearised",
        },
    ).json()
    assert (back["stored_sample"], back["stored_line"]) == pytest.approx((90.25, 140.5), abs=5e-3)


@pytest.mark.parametrize(
    ("address", "status"),
    [
        ("NONE/raw.png", 404),
        ("{id}/painted.png", 422),
        ("{id}/stretched.png?low=50&high=50", 422),
        ("{id}/stretched.png?black=5&white=5", 422),
        ("{id}/stretched.png?gamma=0", 422),
        ("{id}/stretched.png?low=nan", 422),
        ("{id}/raw/9/0/0.png", 404),
        ("{id}/raw/0/5/0.png", 404),
        ("{id}/raw/99/0/0.png", 422),
        ("..%2F..%2Fetc/raw.png", 404),
        ("{id}/anaglyph.png?shift_px=1e9", 422),
    ],
)
def test_unknown_images_are_refused(stereo, stereo_client, address, status):
    answer = stereo_client.get("/images/" + address.format(id=left_of(stereo).id))
    assert answer.status_code == status


def test_an_image_without_partner_has_no_stereo(client):
    answer = client.get("/images/2N140000000EFFA000P1600L0M1/anaglyph.png")
    assert answer.status_code == 404
    assert "the right image was never sent" in answer.text


def test_the_cache_stays_within_its_bytes():
    kept, made = ArrayCache(1000), []

    def make(key):
        made.append(key)
        return np.zeros(400, np.uint8)

    for key in (1, 2, 1, 3, 1, 2):
        kept.get(key, lambda key=key: make(key))
    assert made == [1, 2, 3, 2]
    assert kept._bytes <= 1000
