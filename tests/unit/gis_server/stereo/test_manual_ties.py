"""Picked points measured, and manual ties tried, where the true conjugates are known."""

import json

import numpy as np
import pytest

from solmap.gis_server.analysis.manual_ties import stored_point
from solmap.photogrammetry.terrain.measure.ground_point import range_to_ground
from solmap.products.catalogue.oriented_images import OrientedMission

pytestmark = pytest.mark.slow  # a world is rendered first
API = "/api/missions/MER2"


@pytest.fixture(scope="module")
def conjugates(stereo):
    """True ties of both stops in pixels of the images as stored: [(image, pixel), ...] each."""
    mission = OrientedMission.latest("MER2", stereo.workspace)
    seen = mission.network.adjusted.ties.observations
    stops = {entry.id: entry.stop for entry in stereo.entries}
    ties = []
    for point in range(int(seen.point.max()) + 1):
        rows = {seen.pair_ids[seen.pair[r]]: r for r in np.flatnonzero(seen.point == point)}
        first = next(iter(rows))
        other = next((name for name in rows if stops[name] != stops[first]), None)
        if other is not None:
            ties.append(
                [_stored(mission, stereo, name, seen.left[rows[name]]) for name in (first, other)]
            )
    return ties


def _stored(mission, stereo, name, left):
    entry = next(e for e in stereo.entries if e.id == name)
    eyes = mission.stereo_partners(entry)
    return name, stored_point(eyes.left, eyes.geometry, left[None])[0]


def picked(point, move=(0.0, 0.0)):
    name, place = point
    return {"image": name, "sample": float(place[0] + move[0]), "line": float(place[1] + move[1])}


def test_a_pick_within_a_stop_is_measured_to_a_tenth_of_a_pixel(stereo, stereo_client):
    """Neighbouring pairs of a panorama show the same ground: their true conjugates are known."""
    lefts = [entry for entry in stereo.entries if entry.eye == "left"][:2]
    cameras = [stereo.world.true_camera(*stereo.shot(entry.id)) for entry in lefts]
    rng, off = np.random.default_rng(3), []
    for _ in range(200):
        pixel = rng.uniform([20, 90], [236, 240])
        ray = cameras[0].rays(pixel[None])[0]
        met = range_to_ground(cameras[0].centre, ray, stereo.elevation, 20.0, 0.01)
        if met is None:
            continue
        truth = cameras[1].project((cameras[0].centre + met * ray)[None])[0]
        if not ((truth > 20) & (truth < 236)).all():
            continue
        move = rng.uniform(-3, 3, 2)
        question = {
            "first": picked((lefts[0].id, pixel)),
            "second": picked((lefts[1].id, truth), move),
        }
        body = stereo_client.post(f"{API}/refine", json=question).json()
        if body["found"]:
            off.append(np.hypot(body["sample"] - truth[0], body["line"] - truth[1]))
            assert body["moved_px"] < 6.5
    assert len(off) >= 5
    assert np.median(off) < 0.2


def test_a_pick_without_a_match_is_left_in_place(conjugates, stereo_client):
    first, second = conjugates[0]
    away = {"first": picked(first), "second": {"image": second[0], "sample": 30.0, "line": 30.0}}
    body = stereo_client.post(f"{API}/refine", json=away).json()
    if not body["found"]:
        assert (body["sample"], body["line"]) == (30.0, 30.0)
        assert body["said"]


def test_true_ties_fit_and_leave_the_stop_in_place(conjugates, stereo, stereo_client):
    ties = [{"first": picked(a), "second": picked(b), "sigma_px": 0.3} for a, b in conjugates[::12]]
    answer = stereo_client.post(f"{API}/preview-adjustment", json={"ties": ties})
    assert answer.status_code == 200, answer.text
    body = answer.json()
    stops = sorted({entry.stop for entry in stereo.entries})
    assert [body["held_stop"], body["moved_stop"]] == stops
    change = body["change"]
    for axis in ("east", "north", "up"):
        assert abs(change[f"{axis}_m"]) < 4 * change[f"sigma_{axis}_m"]
    assert body["after"]["is_usable"]
    residuals = [tie["residual_px"] for tie in body["ties"] if tie["status"] == "used"]
    assert len(residuals) >= 0.9 * len(ties)
    assert np.median(residuals) < 0.5


def test_a_wrong_tie_is_distinguished_from_correct_ones(conjugates, stereo_client):
    ties = [{"first": picked(a), "second": picked(b), "sigma_px": 0.3} for a, b in conjugates[::15]]
    ties[0]["second"] = picked(conjugates[0][1], (25.0, 0.0))
    body = stereo_client.post(f"{API}/preview-adjustment", json={"ties": ties}).json()
    assert body["ties"][0]["status"] == "blunder"
    assert sum(tie["status"] == "used" for tie in body["ties"][1:]) >= 0.8 * (len(ties) - 1)


def test_a_veto_drops_automatic_ties_and_unplaced_rows_are_named(conjugates, stereo_client):
    (a, b), good = conjugates[0], conjugates[20]
    ties = [
        {"action": "veto", "first": picked(a), "second": {"image": b[0]}},
        {"first": {"image": a[0], "sample": -1, "line": -1}, "second": picked(b)},
        {"first": picked(good[0]), "second": picked(good[1])},
    ]
    body = stereo_client.post(f"{API}/preview-adjustment", json={"ties": ties}).json()
    assert body["vetoed"] >= 1
    assert [tie["tie"] for tie in body["ties"]] == [2]
    assert len(body["notes"]) == 1


def test_a_preview_changes_nothing_in_the_store(conjugates, stereo, stereo_client):
    root = stereo.workspace.store.root

    def files():
        return sorted((str(p), p.stat().st_mtime_ns) for p in root.glob("products/**/*"))

    before = files()
    a, b = conjugates[0]
    tie = {"first": picked(a), "second": picked(b)}
    stereo_client.post(f"{API}/preview-adjustment", json={"ties": [tie]})
    assert files() == before


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"second": None}, "two stops"),
        ({"first": {"image": "NONE", "sample": 1, "line": 1}}, "no image"),
        ({"first": {"image": "RIGHT", "sample": 1, "line": 1}}, "left"),
        ({"sigma_px": 0}, "greater than 0"),
        ({"action": "paint"}, "'add', 'veto' or 'move'"),
        ({"first": {"image": "LEFT", "sample": 1}}, "go together"),
        ({"first": {"image": "LEFT"}}, "takes first_image"),
    ],
)
def test_invalid_ties_are_refused(conjugates, stereo, stereo_client, change, reported):
    a, b = conjugates[0]
    right = next(entry.partner for entry in stereo.entries if entry.id == a[0])
    tie = {"first": picked(a), "second": picked(b)} | change
    tie["second"] = tie["second"] or picked(a, (5, 5))
    text = json.dumps({"ties": [tie]}).replace('"RIGHT"', f'"{right}"')
    answer = stereo_client.post(
        f"{API}/preview-adjustment",
        content=text.replace('"LEFT"', f'"{a[0]}"'),
        headers={"content-type": "application/json"},
    )
    assert answer.status_code in (404, 422)
    assert reported in answer.text
