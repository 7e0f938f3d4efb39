"""Map to image, image to map and image to image, against the truth of a simulated world."""

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import range_to_ground

pytestmark = pytest.mark.slow  # a world is rendered first
API = "/api/missions/MER2"


def request(client, what, **query):
    answer = client.get(f"{API}/{what}", params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()


def camera_of(stereo, image):
    shot, eye = stereo.shot(image)
    return stereo.world.true_camera(shot, eye)


def true_place(stereo, image, pixel):
    """Where the ray of a pixel truly meets the ground, in the LSL."""
    camera = camera_of(stereo, image)
    ray = camera.rays(np.array([pixel]))[0]
    met = range_to_ground(camera.centre, ray, stereo.elevation, 30.0, 0.01)
    return None if met is None else camera.centre + met * ray


def images(stereo, eye="left"):
    return [entry.id for entry in stereo.entries if entry.eye == eye]


@pytest.mark.parametrize("eye", ["left", "right"])
def test_a_pixel_gives_its_true_ground(stereo, stereo_client, eye):
    for image in images(stereo, eye):
        for pixel in ((60.0, 180.0), (128.0, 230.0), (200.0, 200.0)):
            body = request(
                stereo_client, "image-to-ground", image=image, sample=pixel[0], line=pixel[1]
            )
            found, truth = body["ground"], MAP_FROM_LSL @ true_place(stereo, image, pixel)
            place = np.array([found["east"], found["north"], found["elevation_m"]])
            assert body["told_by"] == "parallax"
            assert np.linalg.norm(place - truth) < 4 * max(found["own_sigma_m"], 0.01)
            assert found["measured_from"] == next(
                entry.stop for entry in stereo.entries if entry.id == image
            )


def test_a_place_is_projected_to_its_true_pixel(stereo, stereo_client):
    seen = 0
    for image in images(stereo):
        truth = true_place(stereo, image, (128.0, 200.0))
        east, north, up = (MAP_FROM_LSL @ truth).tolist()
        body = request(stereo_client, "ground-to-image", east=east, north=north)
        assert body["ground"]["elevation_m"] == pytest.approx(up, abs=0.03)
        for found in body["images"]:
            camera = camera_of(stereo, found["image"])
            expected = camera.project(truth[None])[0]
            off = np.hypot(found["sample"] - expected[0], found["line"] - expected[1])
            focal_px = np.linalg.norm(np.cross(camera.a, camera.h))
            lowered = 0.03 * focal_px / found["range_m"]  # of the map's ground against the truth
            assert off < 0.05 + lowered
            assert found["range_m"] == pytest.approx(
                np.linalg.norm(truth - camera.centre), abs=0.05
            )
            seen += found["sight"] == "visible"
        (own,) = (found for found in body["images"] if found["image"] == image)
        assert own["sight"] == "visible"
    assert seen >= 2 * len(images(stereo))  # at least both eyes


def test_only_ground_behind_a_rise_is_hidden(stereo, stereo_client):
    """Places that random pixels show: answers compared with rays through the true ground."""
    rng, message = np.random.default_rng(1), []
    for image in images(stereo) * 2:
        truth = true_place(stereo, image, rng.uniform([10, 60], [245, 160]))
        if truth is None:
            continue
        east, north, up = (MAP_FROM_LSL @ truth).tolist()
        for below in (0.0, 0.6):
            place = {"east": east, "north": north, "elevation": up - below}
            for found in request(stereo_client, "ground-to-image", **place)["images"]:
                hidden = _hidden(stereo, found["image"], truth + np.array([0.0, 0.0, below]))
                if hidden is not None:
                    message.append((found["sight"], hidden))
    assert message.count(("visible", False)) >= 20
    assert message.count(("hidden", True)) >= 20
    assert message.count(("hidden", False)) + message.count(("visible", True)) <= 0.05 * len(
        message
    )


def _hidden(stereo, image, point):
    """Whether true ground lies before a point; None where it is a matter of centimetres."""
    centre = camera_of(stereo, image).centre
    distance = np.linalg.norm(point - centre)
    met = range_to_ground(centre, (point - centre) / distance, stereo.elevation, 40.0, 0.01)
    if met is None or met > distance - 0.05:
        return False
    return True if met < distance - 0.5 else None


def test_projecting_and_back_gives_the_same_pixel(stereo, stereo_client):
    image = images(stereo)[1]
    there = request(stereo_client, "image-to-ground", image=image, sample=100, line=190)["ground"]
    back = request(
        stereo_client,
        "ground-to-image",
        east=there["east"],
        north=there["north"],
        elevation=there["elevation_m"],
    )
    (own,) = (found for found in back["images"] if found["image"] == image)
    assert (own["sample"], own["line"]) == pytest.approx((100, 190), abs=0.02)


def test_a_point_is_predicted_in_the_images_of_the_other_stop(stereo, stereo_client):
    compared = 0
    for image in images(stereo):
        stop = next(entry.stop for entry in stereo.entries if entry.id == image)
        other = next(entry.stop for entry in stereo.entries if entry.stop != stop)
        for pixel in ((60.0, 120.0), (128.0, 150.0), (200.0, 120.0)):
            body = request(
                stereo_client,
                "image-to-image",
                image=image,
                sample=pixel[0],
                line=pixel[1],
                stop=other,
            )
            truth = true_place(stereo, image, pixel)
            for found in body["images"]:
                expected = camera_of(stereo, found["image"]).project(truth[None])[0]
                off = np.hypot(found["sample"] - expected[0], found["line"] - expected[1])
                assert off < 3.5 * max(found["ellipse"]["semi_major_px"], 0.1)
                places = np.array([[p["sample"], p["line"]] for p in found["epipolar"]])
                ahead = np.diff(places, axis=0)
                to = expected - places[:-1]
                area = ahead[:, 0] * to[:, 1] - ahead[:, 1] * to[:, 0]
                gaps = area / np.linalg.norm(ahead, axis=1)
                assert np.abs(gaps).min() < 0.3
                compared += 1
    assert compared >= 6


def test_the_linearised_place_equals_that_of_the_resampled_image(stereo, stereo_client):
    image = images(stereo)[0]
    truth = MAP_FROM_LSL @ true_place(stereo, image, (120.0, 200.0))
    body = request(stereo_client, "ground-to-image", east=truth[0], north=truth[1])
    for found in body["images"]:
        at = stereo_client.get(
            f"/images/{found['image']}/point",
            params={"sample": found["sample"], "line": found["line"]},
        ).json()
        assert (at["linearised_sample"], at["linearised_line"]) == pytest.approx(
            (found["linearised_sample"], found["linearised_line"]), abs=0.03
        )


@pytest.mark.parametrize(
    ("what", "query", "status", "reported"),
    [
        ("ground-to-image", {"east": 5000, "north": 0}, 422, "no elevation"),
        ("ground-to-image", {"east": "nan", "north": 0}, 422, "finite"),
        ("ground-to-image", {"east": 0, "north": 0, "within_m": 1e9}, 422, "500"),
        ("ground-to-image", {"east": 0, "north": 0, "layer": "x"}, 422, "not a terrain model"),
        ("image-to-ground", {"image": "NONE", "sample": 1, "line": 1}, 404, "no image"),
        ("image-to-ground", {"image": "../etc", "sample": 1, "line": 1}, 422, "pattern"),
        ("image-to-ground", {"image": "OWN", "sample": 5000, "line": 1}, 422, "not on it"),
        (
            "image-to-image",
            {"image": "OWN", "sample": 9, "line": 9, "stop": "x"},
            422,
            "not a stop",
        ),
    ],
)
def test_unanswerable_queries_are_refused(stereo, stereo_client, what, query, status, reported):
    query = {k: images(stereo)[0] if v == "OWN" else v for k, v in query.items()}
    answer = stereo_client.get(f"{API}/{what}", params=query)
    assert answer.status_code == status
    assert reported in answer.text


def test_a_pixel_of_the_sky_has_no_ground(stereo, stereo_client):
    body = request(stereo_client, "image-to-ground", image=images(stereo)[0], sample=5, line=0)
    if body["ground"] is None:
        assert body["told_by"] == "nothing"


def test_a_store_without_a_network_is_reported(client):
    answer = client.get(f"{API}/ground-to-image", params={"east": 0, "north": 0})
    assert answer.status_code == 404
    assert "no network" in answer.text
