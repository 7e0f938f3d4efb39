"""Writing requires a token and a role; what is written is checked, logged and can be revoked."""

from datetime import UTC, datetime, timedelta

import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.gis_server.middleware import MOST_BYTES
from solmap.products.catalogue.edits import EditLog, RequestKind, RunRequests
from solmap.products.catalogue.engine_state import OLD_S, DeploymentState, EngineState, QueuedRun
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
    ("/api/runs/a/cancel", {}),
    ("/api/runs/a/restart", {}),
    ("/api/engine/deployments/downlink/inbox/pause", {}),
    ("/api/engine/deployments/downlink/inbox/resume", {}),
]


@pytest.mark.parametrize(("path", "body"), WRITES)
def test_a_server_without_tokens_accepts_no_writes_and_explains_how_to_get_one(
    client, own_world, path, body
):
    answer = client.post(path, json=body, headers={"Authorization": "Bearer solmap_a_b"})
    assert answer.status_code == 403
    assert "solmap token add NAME --role analyst" in answer.json()["description"]
    assert EditLog.of(own_world.root).edits() == []
    assert RunRequests.of(own_world.root).requests() == []


@pytest.mark.parametrize(("path", "body"), WRITES)
def test_a_missing_a_wrong_and_an_insufficient_token_are_distinguished(
    client, token_of, path, body
):
    viewer = token_of(Role.VIEWER)
    missing = client.post(path, json=body)
    assert (missing.status_code, missing.headers["www-authenticate"]) == (401, "Bearer")
    wrong = client.post(path, json=body, headers={"Authorization": "Bearer solmap_a_b"})
    assert wrong.status_code == 401
    assert "unknown, revoked or expired" in wrong.json()["description"]
    low = client.post(path, json=body, headers=viewer)
    assert low.status_code == 403
    assert "requires the role" in low.json()["description"]


def test_an_analyst_writes_and_revokes_edits_and_everybody_reads_the_log(
    client, token_of, own_world
):
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
    reported = [event.kind for event in own_world.catalogue.events_since(0)]
    assert reported.count("edits.changed") == 2


def test_the_columns_of_an_edit_are_those_of_a_manual_ties_file():
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
def test_an_edit_that_cannot_be_applied_is_refused(client, token_of, own_world, change):
    answer = client.post(f"{EDITS}/ties", json={**TIE, **change}, headers=token_of(Role.ANALYST))
    assert answer.status_code in {404, 422}
    assert EditLog.of(own_world.root).edits() == []


def test_a_stop_is_vetoed_by_its_name(client, token_of):
    analyst = token_of(Role.ANALYST)
    whole = {"action": "veto", "first_image": STOP.name, "second_image": STOP.name}
    assert client.post(f"{EDITS}/ties", json=whole, headers=analyst).status_code == 201
    strange = {**whole, "second_image": "mer2-site0099-drive0000"}
    assert client.post(f"{EDITS}/ties", json=strange, headers=analyst).status_code == 422


def test_published_annotations_are_on_the_map(client, token_of):
    analyst = token_of(Role.ANALYST)
    made = client.post(f"{EDITS}/annotations", json=NOTE, headers=analyst).json()
    (feature,) = client.get("/api/missions/MER2/annotations").json()["features"]
    assert feature["geometry"]["coordinates"] == NOTE["geometry"]["coordinates"]
    assert feature["properties"]["text"] == "layered rock"
    client.post(f"{EDITS}/{made['id']}/undo", json={}, headers=analyst)
    assert client.get("/api/missions/MER2/annotations").json()["features"] == []


def test_an_annotation_is_replaced_and_both_versions_stay_in_the_log(client, token_of):
    analyst = token_of(Role.ANALYST)
    draft = {**NOTE, "category": "keep-out", "state": "draft"}
    first = client.post(f"{EDITS}/annotations", json=draft, headers=analyst).json()
    better = {**draft, "text": "loose sand", "state": "published", "replaces": first["id"]}
    second = client.post(f"{EDITS}/annotations", json=better, headers=analyst)
    assert second.status_code == 201
    (feature,) = client.get("/api/missions/MER2/annotations").json()["features"]
    reported = feature["properties"]
    assert (reported["text"], reported["category"], reported["state"]) == (
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
def test_unknown_categories_and_states_are_refused(client, token_of, wrong):
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


def test_an_operator_requests_a_run_and_an_analyst_may_not(client, token_of):
    edit = {"kind": "overall adjustment", "mission": "MER2"}
    assert client.post("/api/runs", json=edit, headers=token_of(Role.ANALYST)).status_code == 403
    requested = client.post("/api/runs", json=edit, headers=token_of(Role.OPERATOR))
    assert requested.status_code == 202
    assert client.get("/api/runs").json()["requests"] == [requested.json()]
    nowhere = {**edit, "mission": "MER9"}
    operator = token_of(Role.OPERATOR)
    assert client.post("/api/runs", json=nowhere, headers=operator).status_code == 404


def test_an_annotation_without_a_text_is_refused(client, token_of):
    sent = client.post(
        f"{EDITS}/annotations", json={**NOTE, "text": ""}, headers=token_of(Role.ANALYST)
    )
    assert sent.status_code == 422


def test_the_mission_is_not_among_the_parameters_of_a_run(client, token_of):
    kept = client.post("/api/runs", json=FETCH, headers=token_of(Role.OPERATOR)).json()
    assert kept["mission"] == "MER2"
    assert kept["parameters"]["sols"] == "155-157"
    assert "mission" not in kept["parameters"]


FETCH = {"kind": "fetch", "mission": "MER2", "sols": "155-157"}


@pytest.mark.parametrize(
    ("edit", "reported"),
    [
        ({"kind": "fetch", "mission": "MER2"}, "sols: Field required"),
        ({**FETCH, "sols": "yesterday"}, "sols: String should match"),
        ({**FETCH, "instruments": ["radar"]}, "instruments.0: Input should be"),
        ({"kind": "downlink", "settle_s": -1}, "settle_s: Input should be greater"),
        ({"kind": "downlink", "mission": "MER2"}, "leave the mission out"),
        ({"kind": "downlink", "store": "/etc"}, "store: Extra inputs"),
        ({"kind": "cancel"}, "kind"),
    ],
)
def test_parameters_of_a_run_are_validated_before_the_request(
    client, token_of, own_world, edit, reported
):
    answer = client.post("/api/runs", json=edit, headers=token_of(Role.OPERATOR))
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert reported in answer.json()["detail"]
    assert RunRequests.of(own_world.root).requests() == []


def test_the_kinds_of_runs_have_schemas_and_descriptions(client):
    kinds = {one["kind"]: one for one in client.get("/api/run-kinds").json()}
    assert set(kinds) == {"downlink", "overall adjustment", "region", "fetch"}
    assert set(kinds["downlink"]["parameters"]["properties"]) == {"settle_s"}
    assert kinds["fetch"]["parameters"]["required"] == ["mission", "sols"]
    assert all(one["effect"] for one in kinds.values())


DEPLOYMENT = DeploymentState(
    name="downlink/inbox",
    description="",
    is_paused=False,
    schedules=("0 3 * * 0",),
    next_run=None,
    last_state=None,
    last_ended_at=None,
    pool=None,
    is_ready=True,
)


def write_engine(own_world, age_s=0.0, **more):
    at = datetime.now(UTC) - timedelta(seconds=age_s)
    known = {"is_up": True, "has_inbox": True, "deployments": (DEPLOYMENT,), **more}
    EngineState(at.isoformat(timespec="milliseconds"), **known).write(own_world.root)


def write_run(own_world, state=None, flow_run="f-1", kind="downlink", parameters=None):
    run = Run.start(kind, "inbox", flow_run, parameters or {"settle_s": 2.0})
    RunRecords(own_world.catalogue.engine).write(run.with_end(state) if state else run)
    return run.id


def test_a_running_run_is_cancelled_once_and_an_ended_one_is_not(client, token_of, own_world):
    operator = token_of(Role.OPERATOR)
    write_engine(own_world)
    going, ended = write_run(own_world), write_run(own_world, RunState.SUCCEEDED)
    listed = {one["id"]: one for one in client.get("/api/runs").json()["runs"]}
    assert (listed[going]["actions"], listed[ended]["actions"]) == (["cancel"], [])
    for _ in range(2):
        requested = client.post(f"/api/runs/{going}/cancel", headers=operator)
        assert requested.status_code == 202
    (kept,) = RunRequests.of(own_world.root).waiting()
    assert (kept.kind, kept.parameters) == (RequestKind.CANCEL, {"run": "f-1"})
    refused = client.post(f"/api/runs/{ended}/cancel", headers=operator)
    assert refused.status_code == 409
    assert refused.json()["detail"] == f"run {ended} has ended already: succeeded"
    own = write_run(own_world, flow_run=None)
    by_hand = client.post(f"/api/runs/{own}/cancel", headers=operator)
    assert by_hand.status_code == 409
    assert "Ctrl-C" in by_hand.json()["detail"]
    assert client.post("/api/runs/none/cancel", headers=operator).status_code == 404


def test_a_run_that_waits_in_the_engine_is_cancelled_by_its_name(client, token_of, own_world):
    write_engine(own_world, queued=(QueuedRun("f-9", "downlink/inbox", "wise-lynx", None),))
    requested = client.post("/api/runs/f-9/cancel", headers=token_of(Role.OPERATOR))
    assert requested.json()["parameters"] == {"run": "f-9"}


@pytest.mark.parametrize("state", [RunState.FAILED, RunState.CANCELLED])
def test_a_failed_run_is_requested_again_with_its_parameters(client, token_of, own_world, state):
    write_engine(own_world)
    run = write_run(own_world, state)
    requested = client.post(f"/api/runs/{run}/restart", headers=token_of(Role.OPERATOR)).json()
    assert (requested["kind"], requested["parameters"]) == ("downlink", {"settle_s": 2.0})
    done = write_run(own_world, RunState.SUCCEEDED)
    again = client.post(f"/api/runs/{done}/restart", headers=token_of(Role.OPERATOR))
    assert again.status_code == 409


def test_deployments_are_paused_and_resumed_only_if_that_changes_them(client, token_of, own_world):
    operator = token_of(Role.OPERATOR)
    write_engine(own_world)
    address = "/api/engine/deployments/downlink/inbox"
    assert client.get("/api/engine").json()["deployments"][0]["schedules"] == ["0 3 * * 0"]
    assert client.post(f"{address}/pause", headers=operator).json()["parameters"] == {
        "deployment": "downlink/inbox"
    }
    assert client.post(f"{address}/resume", headers=operator).status_code == 409
    other = client.post("/api/engine/deployments/downlink/none/pause", headers=operator)
    assert other.status_code == 404


@pytest.mark.parametrize("age_s", [None, OLD_S + 1.0])
def test_without_an_engine_nothing_is_cancelled_or_paused_and_a_run_waits(
    client, token_of, own_world, age_s
):
    operator = token_of(Role.OPERATOR)
    if age_s is not None:
        write_engine(own_world, age_s)
    run = write_run(own_world)
    paths = [f"runs/{run}/cancel", f"runs/{run}/restart", "engine/deployments/downlink/inbox/pause"]
    for path in paths:
        answer = client.post(f"/api/{path}", headers=operator)
        assert answer.status_code == 503
        assert answer.headers["content-type"] == "application/problem+json"
        assert "the engine is down: `solmap up`" in answer.json()["detail"]
    assert client.get("/api/engine").json()["is_up"] is False
    edit = {"kind": "downlink"}
    assert client.post("/api/runs", json=edit, headers=operator).status_code == 202


def test_a_downlink_is_refused_at_once_without_a_watched_inbox(client, token_of, own_world):
    write_engine(own_world, has_inbox=False)
    answer = client.post("/api/runs", json={"kind": "downlink"}, headers=token_of(Role.OPERATOR))
    assert answer.status_code == 409
    assert "no inbox is watched" in answer.json()["detail"]


def test_runs_are_listed_with_progress_and_one_run_has_its_log(client, own_world):
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


def test_a_body_that_would_fill_the_memory_is_cut_off(client, token_of):
    body = {**NOTE, "text": "x" * (MOST_BYTES + 1)}
    answer = client.post(f"{EDITS}/annotations", json=body, headers=token_of(Role.ANALYST))
    assert answer.status_code == 413

    def drip():
        for _ in range(20):
            yield b"x" * (MOST_BYTES // 10)

    unannounced = client.post(f"{EDITS}/annotations", content=drip())
    assert unannounced.status_code == 413
