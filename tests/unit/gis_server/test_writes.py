"""Writing takes a token and a role; what is written is checked, logged and can be taken back."""

import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.gis_server.middleware import MOST_BYTES
from solmap.products.catalogue.edits import EditLog, RunRequests
from solmap.products.catalogue.runs import Run, RunRecords, RunState
from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.formats.documents.edit_requests import COLUMNS
from tests.unit.gis_server.conftest import STOP

IMAGE = "2N140000000EFFA000P1600L0M1"
EDITS = "/api/missions/MER2/edits"
TIE = {
    "action": "veto",
    "first_image": IMAGE,
    "first_sample": 10.5,
    "first_line": 20.25,
    "note": "wrong rock",
}
NOTE = {
    "geometry": {"type": "LineString", "coordinates": [[1.0, 2.0], [3.0, 4.0, 0.5]]},
    "text": "layered rock",
}


@pytest.fixture
def client(own_world):
    with TestClient(create_app(own_world.root)) as opened:
        yield opened


@pytest.fixture
def token_of(own_world):
    def make(role: Role) -> dict[str, str]:
        _, text = Tokens.of(own_world.root).add(f"an {role}", role)
        return {"Authorization": f"Bearer {text}"}

    return make


WRITES = [
    (f"{EDITS}/ties", TIE),
    (f"{EDITS}/annotations", NOTE),
    (f"{EDITS}/1/undo", {}),
    ("/api/runs", {"kind": "region"}),
]


@pytest.mark.parametrize(("path", "body"), WRITES)
def test_a_server_without_tokens_writes_nothing_and_says_how_to_get_one(
    client, own_world, path, body
):
    answer = client.post(path, json=body, headers={"Authorization": "Bearer solmap_a_b"})
    assert answer.status_code == 403
    assert "solmap token add NAME --role analyst" in answer.json()["description"]
    assert EditLog.of(own_world.root).edits() == []
    assert RunRequests.of(own_world.root).requests() == []


@pytest.mark.parametrize(("path", "body"), WRITES)
def test_no_token_a_wrong_one_and_too_low_a_role_are_told_apart(client, token_of, path, body):
    viewer = token_of(Role.VIEWER)
    missing = client.post(path, json=body)
    assert (missing.status_code, missing.headers["www-authenticate"]) == (401, "Bearer")
    wrong = client.post(path, json=body, headers={"Authorization": "Bearer solmap_a_b"})
    assert wrong.status_code == 401
    assert "unknown, revoked or has ended" in wrong.json()["description"]
    low = client.post(path, json=body, headers=viewer)
    assert low.status_code == 403
    assert "takes the role" in low.json()["description"]


def test_an_analyst_edits_and_takes_back_and_everybody_reads_the_log(client, token_of, own_world):
    analyst = token_of(Role.ANALYST)
    made = client.post(f"{EDITS}/ties", json=TIE, headers=analyst)
    assert made.status_code == 201
    number = made.json()["id"]
    assert made.json()["author"] == "an analyst"
    assert [one["counts"] for one in client.get(EDITS).json()] == [True]
    assert client.post(f"{EDITS}/{number}/undo", json={}, headers=analyst).status_code == 201
    assert [one["counts"] for one in client.get(EDITS).json()] == [False, True]
    again = client.post(f"{EDITS}/{number}/undo", json={}, headers=analyst)
    assert again.status_code == 409
    assert client.get(EDITS, params={"kind": "tie", "counting": True}).json() == []
    told = [event.kind for event in own_world.catalogue.events_since(0)]
    assert told.count("edits.changed") == 2


def test_the_columns_of_an_edit_are_those_of_a_file_of_hand_ties():
    from solmap.gis_server.collaboration.edits import TieEdit  # noqa: PLC0415

    assert list(TieEdit.model_fields) == list(COLUMNS)


@pytest.mark.parametrize(
    "change",
    [
        {"action": "drop"},
        {"first_image": ""},
        {"first_image": "../../etc/passwd"},
        {"first_image": "2N999999999EFFA000P1600L0M1"},
        {"first_sample": None},
        {"first_line": 1e9},
        {"sigma_px": -1},
        {"colour": "red"},
        {"action": "add"},
        {"note": "x" * 3000},
    ],
)
def test_an_edit_that_could_not_be_carried_out_is_refused(client, token_of, own_world, change):
    answer = client.post(f"{EDITS}/ties", json={**TIE, **change}, headers=token_of(Role.ANALYST))
    assert answer.status_code in {404, 422}
    assert EditLog.of(own_world.root).edits() == []


def test_a_stop_is_vetoed_by_its_name(client, token_of):
    analyst = token_of(Role.ANALYST)
    whole = {"action": "veto", "first_image": STOP.name, "second_image": STOP.name}
    assert client.post(f"{EDITS}/ties", json=whole, headers=analyst).status_code == 201
    strange = {**whole, "second_image": "mer2-site0099-drive0000"}
    assert client.post(f"{EDITS}/ties", json=strange, headers=analyst).status_code == 422


def test_annotations_that_count_are_on_the_map(client, token_of):
    analyst = token_of(Role.ANALYST)
    made = client.post(f"{EDITS}/annotations", json=NOTE, headers=analyst).json()
    (feature,) = client.get("/api/missions/MER2/annotations").json()["features"]
    assert feature["geometry"]["coordinates"] == NOTE["geometry"]["coordinates"]
    assert feature["properties"]["text"] == "layered rock"
    client.post(f"{EDITS}/{made['id']}/undo", json={}, headers=analyst)
    assert client.get("/api/missions/MER2/annotations").json()["features"] == []


def test_an_annotation_is_replaced_and_both_forms_stay_in_the_log(client, token_of):
    analyst = token_of(Role.ANALYST)
    draft = {**NOTE, "category": "keep-out", "state": "draft"}
    first = client.post(f"{EDITS}/annotations", json=draft, headers=analyst).json()
    better = {**draft, "text": "loose sand", "state": "published", "replaces": first["id"]}
    second = client.post(f"{EDITS}/annotations", json=better, headers=analyst)
    assert second.status_code == 201
    (feature,) = client.get("/api/missions/MER2/annotations").json()["features"]
    told = feature["properties"]
    assert (told["text"], told["category"], told["state"]) == (
        "loose sand",
        "keep-out",
        "published",
    )
    log = client.get(EDITS).json()
    assert [row["kind"] for row in log] == ["annotation", "undo", "annotation"]
    assert [row["counts"] for row in log] == [False, True, True]
    again = client.post(f"{EDITS}/annotations", json=better, headers=analyst)
    assert again.status_code == 409
    assert len(client.get(EDITS).json()) == 3
    nothing = {**better, "replaces": 99}
    assert client.post(f"{EDITS}/annotations", json=nothing, headers=analyst).status_code == 404


def test_a_tie_is_not_replaced_by_an_annotation(client, token_of):
    analyst = token_of(Role.ANALYST)
    tie = client.post(f"{EDITS}/ties", json=TIE, headers=analyst).json()
    body = {**NOTE, "replaces": tie["id"]}
    assert client.post(f"{EDITS}/annotations", json=body, headers=analyst).status_code == 409


@pytest.mark.parametrize("wrong", [{"category": "crater"}, {"state": "secret"}, {"replaces": 0}])
def test_categories_and_states_are_those_that_are_known(client, token_of, wrong):
    body = {**NOTE, **wrong}
    answer = client.post(f"{EDITS}/annotations", json=body, headers=token_of(Role.ANALYST))
    assert answer.status_code == 422


@pytest.mark.parametrize(
    "geometry",
    [
        {"type": "Point", "coordinates": [1e9, 0.0]},
        {"type": "Point", "coordinates": []},
        {"type": "LineString", "coordinates": [[0.0, 0.0]]},
        {"type": "Polygon", "coordinates": [[[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]]]},
        {"type": "Circle", "coordinates": [0.0, 0.0]},
    ],
)
def test_an_annotation_without_a_place_is_refused(client, token_of, geometry):
    body = {**NOTE, "geometry": geometry}
    answer = client.post(f"{EDITS}/annotations", json=body, headers=token_of(Role.ANALYST))
    assert answer.status_code == 422


def test_an_operator_asks_for_a_run_and_an_analyst_may_not(client, token_of):
    wish = {"kind": "overall adjustment", "mission": "MER2"}
    assert client.post("/api/runs", json=wish, headers=token_of(Role.ANALYST)).status_code == 403
    asked = client.post("/api/runs", json=wish, headers=token_of(Role.OPERATOR))
    assert asked.status_code == 202
    assert client.get("/api/runs").json()["requests"] == [asked.json()]
    nowhere = {**wish, "mission": "MER9"}
    operator = token_of(Role.OPERATOR)
    assert client.post("/api/runs", json=nowhere, headers=operator).status_code == 404


def test_runs_are_listed_with_progress_and_one_tells_what_it_said(client, own_world):
    book = RunRecords(own_world.catalogue.engine)
    run = (
        Run.start("downlink", "sol156")
        .with_progress("match pairs", 3, 10)
        .with_lines(["one image is broken"])
    )
    book.write(run)
    (listed,) = client.get("/api/runs").json()["runs"]
    assert (listed["stage"], listed["done"], listed["total"]) == ("match pairs", 3, 10)
    assert listed["state"] == RunState.RUNNING
    assert client.get(f"/api/runs/{run.id}").json()["lines"] == ["one image is broken"]
    assert client.get("/api/runs/none").status_code == 404


def test_a_body_that_would_fill_the_memory_is_stopped(client, token_of):
    body = {**NOTE, "text": "x" * (MOST_BYTES + 1)}
    answer = client.post(f"{EDITS}/annotations", json=body, headers=token_of(Role.ANALYST))
    assert answer.status_code == 413

    def drip():
        for _ in range(20):
            yield b"x" * (MOST_BYTES // 10)

    unannounced = client.post(f"{EDITS}/annotations", content=drip())
    assert unannounced.status_code == 413
