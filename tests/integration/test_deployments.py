"""What the engine knows of the deployments: typed and documented parameters, tags, schedules."""

from pathlib import Path

import pytest
import yaml

from solmap.config.settings import Settings

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def deployed(engine, tmp_path_factory):  # noqa: ARG001 - deployed to it
    """All deployments, as the engine gives them back."""
    from prefect.client.orchestration import get_client  # noqa: PLC0415 - after its settings

    from solmap.flows.service.deployments import deployments  # noqa: PLC0415 - as above

    folder = tmp_path_factory.mktemp("up")
    made = deployments(Settings(inbox=folder / "inbox"), folder / "store")
    with get_client(sync_client=True) as client:
        return {made.flow_name: client.read_deployment(made.apply()) for made in made}


def test_every_parameter_of_every_deployment_has_a_type_and_a_description(deployed):
    assert set(deployed) == {"downlink", "overall-adjustment", "refresh-region", "fetch-archive"}
    for name, deployment in deployed.items():
        for parameter, schema in deployment.parameter_openapi_schema["properties"].items():
            assert schema.get("description"), f"{name}: {parameter} is not described"
            assert {"type", "anyOf", "format"} & set(schema), f"{name}: {parameter} has no type"


def test_deployments_have_descriptions_tags_and_the_schedules_of_the_settings(deployed):
    for deployment in deployed.values():
        assert deployment.description
        assert "solmap" in deployment.tags
    crons = {name: [s.schedule.cron for s in d.schedules] for name, d in deployed.items()}
    assert crons["downlink"] == [Settings().downlink_cron]
    assert crons["overall-adjustment"] == [Settings().overall_cron]
    assert crons["refresh-region"] == crons["fetch-archive"] == []


def test_the_file_of_deployments_says_the_same_as_what_is_served(deployed):
    from prefect.flows import load_flow_from_entrypoint  # noqa: PLC0415 - after the engine is set

    written = yaml.safe_load((ROOT / "prefect.yaml").read_text())["deployments"]
    assert len(written) == len(deployed)
    for told in written:
        flow = load_flow_from_entrypoint(told["entrypoint"])
        served = deployed[flow.name]
        assert told["name"] == served.name
        assert told["tags"] == served.tags
        assert told["description"] == served.description
        crons = [schedule["cron"] for schedule in told.get("schedules", [])]
        assert crons == [schedule.schedule.cron for schedule in served.schedules]
        flow.validate_parameters({**told["parameters"], **_asked(flow)})


def _asked(flow):
    """What a fetch asks of whoever starts it."""
    return {"mission": "MER2", "sols": "155"} if flow.name == "fetch-archive" else {}


def test_a_run_is_named_by_what_it_does():
    from solmap.flows.runtime.run_page import format_sols  # noqa: PLC0415 - imports Prefect

    assert format_sols([158, 156, 157]) == "156-158"
    assert format_sols([156, 158, 159, 163]) == "156,158-159,163"
    assert format_sols(range(1, 500, 2)) == "1-499 (250 sols)"
