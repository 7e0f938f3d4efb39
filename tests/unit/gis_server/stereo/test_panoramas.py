"""Panoramas over the server, against the truth of a simulated world."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import AngleGrid
from tests.support.panorama_store import publish_panoramas
from tests.unit.gis_server.stereo.test_projection import API, images, request, true_place

pytestmark = pytest.mark.slow  # a world is rendered first
PIXELS = ((40.0, 150.0), (128.0, 170.0), (200.0, 190.0), (90.0, 240.0))


@pytest.fixture(scope="module")
def panoramas(stereo, stereo_client):
    publish_panoramas(stereo.workspace)
    return stereo_client.get(f"{API}/panoramas").json()


def address(body, what):
    return f"panoramas/{body['scope']}/{body['digest']}/{what}"


def of_stop(panoramas, image, stereo):
    stop = next(entry.stop for entry in stereo.entries if entry.id == image)
    return next(body for body in panoramas if body["scope"] == stop)


def grid_of(body):
    fields = ("west_deg", "top_deg", "cell_deg", "rows", "cols")
    return AngleGrid(*(body[name] for name in fields))


def test_every_stop_has_a_panorama_whose_images_meet(panoramas):
    assert len(panoramas) == 2
    for body in panoramas:
        assert len(body["images"]) == 3
        assert body["registration_px"] < 0.3  # true orientations, images with noise
        assert body["cell_deg"] == pytest.approx(0.188, abs=0.004)  # Navcam, four pixels averaged


def test_a_true_place_lies_at_its_azimuth_and_elevation_to_a_pixel(
    stereo, stereo_client, panoramas
):
    """A patch of an image around a true place is found where the place's direction is."""
    apart = []
    for image in images(stereo):
        body = of_stop(panoramas, image, stereo)
        whole = png(stereo_client, body)
        grid, centre = grid_of(body), MAP_FROM_LSL.T @ np.array(body["centre"])
        for pixel in PIXELS:
            away = true_place(stereo, image, pixel) - centre
            (row,), (col,) = grid.pixels_of(away[None])
            seen = request(
                stereo_client,
                address(body, "direction"),
                azimuth=grid.west_deg + (col + 0.5) * grid.cell_deg,
                elevation=grid.top_deg - (row + 0.5) * grid.cell_deg,
            )
            if seen["shown"]["image"] != image:
                continue  # a neighbour shows it better
            apart.append(math.dist((seen["shown"]["sample"], seen["shown"]["line"]), pixel))
            assert whole[round(row), round(col)] > 0
    assert len(apart) >= 10
    assert max(apart) < 1.0


def test_a_direction_meets_the_ground_at_its_true_place(stereo, stereo_client, panoramas):
    for image in images(stereo):
        body = of_stop(panoramas, image, stereo)
        for pixel in PIXELS:
            truth = MAP_FROM_LSL @ true_place(stereo, image, pixel)
            at = dict(zip(("east", "north", "elevation"), truth.tolist(), strict=True))
            place = request(stereo_client, address(body, "place"), **at)
            assert place["inside"]
            assert place["hidden"] is False
            seen = request(
                stereo_client,
                address(body, "direction"),
                azimuth=place["azimuth_deg"],
                elevation=place["elevation_deg"],
            )
            ground = np.array([seen["ground"][name] for name in ("east", "north", "up")])
            across = np.linalg.norm(ground - truth) / place["distance_m"]
            assert across < 0.05  # two nodes of 0.75 degrees, seen at 10 degrees


def test_brightness_equals_that_of_the_named_image(stereo, stereo_client, panoramas):
    """Around a place the panorama looks as its source image does there."""
    image = images(stereo)[0]
    body = of_stop(panoramas, image, stereo)
    whole, grid = png(stereo_client, body), grid_of(body)
    raw = stereo_client.get(f"/images/{image}/raw.png").content
    flat = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_GRAYSCALE).astype(np.float32)
    centre = MAP_FROM_LSL.T @ np.array(body["centre"])
    rows, cols, grey = [], [], []
    for line in range(110, 160, 4):
        for sample in range(100, 150, 4):
            there = true_place(stereo, image, (float(sample), float(line)))
            if there is not None:
                (row,), (col,) = grid.pixels_of((there - centre)[None])
                rows.append(round(row))
                cols.append(round(col))
                grey.append(flat[line, sample])
    drawn = whole[np.array(rows), np.array(cols)].astype(float)
    assert len(grey) > 100
    assert np.corrcoef(drawn, grey)[0, 1] > 0.9


def test_ground_behind_nearer_ground_is_hidden(stereo, stereo_client, panoramas):
    image = images(stereo)[0]
    body = of_stop(panoramas, image, stereo)
    truth = MAP_FROM_LSL @ true_place(stereo, image, (128.0, 200.0))
    centre = np.array(body["centre"])
    beyond = centre + 1.5 * (truth - centre)
    at = dict(zip(("east", "north", "elevation"), beyond.tolist(), strict=True))
    assert request(stereo_client, address(body, "place"), **at)["hidden"] is True


def test_beyond_its_edges_a_panorama_shows_nothing(stereo_client, panoramas):
    path = f"{API}/{address(panoramas[0], 'direction')}"
    answer = stereo_client.get(path, params={"azimuth": 0.0, "elevation": 89.0})
    assert answer.status_code == 404
    assert "does not show" in answer.text


def png(client, body):
    """The whole panorama out of its tiles."""
    side = body["tile_size"]
    whole = np.zeros((body["rows"] + side, body["cols"] + side), np.uint8)
    for y in range(-(-body["rows"] // side)):
        for x in range(-(-body["cols"] // side)):
            path = body["tiles"].format(z=body["max_zoom"], x=x, y=y)
            answer = client.get(path)
            assert answer.status_code == 200
            tile = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
            whole[y * side : (y + 1) * side, x * side : (x + 1) * side] = tile[..., 0]
    return whole[: body["rows"], : body["cols"]]
