"""What holds for every route: how it is described, and in which form it refuses."""

import re

import pytest

PROBLEM = "application/problem+json"
OWN_REPORTS = "/wmts"
"""WMTS prescribes an exception report in XML."""


@pytest.fixture
def operations(client):
    paths = client.get("/openapi.json").json()["paths"]
    return [
        (method.upper(), path, operation)
        for path, methods in paths.items()
        for method, operation in methods.items()
    ]


def assert_is_problem(answer, address):
    assert answer.headers["content-type"] == PROBLEM, address
    reported = answer.json()
    assert reported["status"] == answer.status_code
    assert reported.keys() >= {"type", "title", "status", "detail", "instance"}


def test_every_operation_has_a_summary_a_tag_and_documents_its_refusals(operations):
    for method, path, operation in operations:
        where = f"{method} {path}"
        assert operation["tags"], where
        assert 10 <= len(operation["summary"]) <= 120, where
        assert operation["description"].replace("\n", " ").startswith(operation["summary"]), where
        refusals = {code: one for code, one in operation["responses"].items() if code >= "400"}
        assert refusals, where
        for code, one in refusals.items():
            assert one["content"][PROBLEM]["schema"]["$ref"].endswith("/Problem"), (where, code)


@pytest.mark.parametrize("name", ["nothing", "~", "99999"])
def test_every_route_refuses_what_it_does_not_have_with_a_problem_document(
    client, operations, name
):
    refused = 0
    for method, path, _ in operations:
        if "{" not in path or path.endswith(OWN_REPORTS):
            continue
        address = re.sub(r"\{\w+\}", name, path)
        answer = client.request(method, address, json={} if method == "POST" else None)
        assert answer.status_code >= 400, address
        assert_is_problem(answer, address)
        refused += 1
    assert refused > 60


def is_checked(parameter):
    """Whether a parameter of a query has a form that `~` does not have."""
    schema = parameter["schema"]
    forms = schema.get("anyOf", [schema])
    free = [
        one for one in forms if one.get("type") == "string" and not {"pattern", "enum"} & set(one)
    ]
    return parameter["in"] == "query" and not free and any("$ref" not in one for one in forms)


def test_every_route_refuses_a_bad_question_with_a_problem_document(client, operations):
    refused = set()
    for method, path, operation in operations:
        if path.endswith(OWN_REPORTS):
            continue
        address = re.sub(r"\{\w+\}", "0", path.replace("{mission}", "MER2"))
        checked = [one["name"] for one in operation["parameters"] if is_checked(one)]
        for query in [{name: "~"} for name in checked]:
            answer = client.request(method, address, params=query)
            assert answer.status_code >= 400, (address, query)
            assert_is_problem(answer, address)
            refused.add((method, path))
        if "requestBody" in operation:
            head = {"content-type": "application/json"}
            answer = client.request(method, address, content=b"{", headers=head)
            assert answer.status_code >= 400, address
            assert_is_problem(answer, address)
            refused.add((method, path))
    assert len(refused) > 50


def test_every_route_refuses_other_methods_with_a_problem_document(client, operations):
    for _, path, _ in operations:
        address = re.sub(r"\{\w+\}", "0", path)
        answer = client.patch(address)
        assert answer.status_code == 405, address
        assert_is_problem(answer, address)


@pytest.mark.parametrize("address", ["/nothing", "/assets/none.js", "/swagger/none.css", "/api"])
def test_unknown_urls_are_refused_with_a_problem_document(client, address):
    answer = client.get(address)
    assert answer.status_code == 404
    assert_is_problem(answer, address)


def test_a_range_beyond_the_end_is_refused_with_a_problem_document(client):
    (dtm,) = (one for one in client.get("/api/missions/MER2/layers").json() if one["kind"] == "dtm")
    answer = client.get(dtm["download"], headers={"Range": "bytes=99999999999-"})
    assert answer.status_code == 416
    assert_is_problem(answer, dtm["download"])
    size = answer.headers["content-range"].removeprefix("bytes */")
    assert int(size) == len(client.get(dtm["download"]).content)


def test_the_entry_of_ogc_has_the_features_of_all_missions(client):
    listed = client.get("/ogc/collections").json()["collections"]
    names = [one["id"] for one in listed]
    missions = [one["mission"] for one in client.get("/api/missions").json()]
    own = {one: client.get(f"/ogc/{one}/collections").json()["collections"] for one in missions}
    assert names == [f"{one}:{each['id']}" for one in missions for each in own[one]]
    assert names
    for one in listed:
        address = f"/ogc/collections/{one['id']}"
        assert client.get(address).json() == one
        mission, _, name = one["id"].partition(":")
        for end in ("/items?limit=1", "/queryables"):
            answers = [
                client.get(each + end).json()
                for each in (address, f"/ogc/{mission}/collections/{name}")
            ]
            for each in answers:
                each.pop("timeStamp", None)
            assert answers[0] == answers[1]
    assert set(client.get("/ogc/conformance").json()["conformsTo"]) < set(
        client.get(f"/ogc/{missions[0]}/conformance").json()["conformsTo"]
    )


def test_the_ogc_landing_page_links_to_all_services(client):
    links = client.get("/ogc").json()["links"]
    addresses = [one["href"] for one in links]
    for end in ("/ogc/MER2", "/collections", "/maps", "/tileMatrixSets", "WMTSCapabilities.xml"):
        assert any(one.endswith(end) for one in addresses), end
    for one in links:
        if one["href"].endswith("/stac/catalog.json"):
            continue  # written when a flow publishes
        assert client.get(one["href"]).status_code == 200, one
