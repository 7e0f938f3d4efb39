"""What is in deploy/ names settings, commands and files that there are."""

import re
from pathlib import Path

import yaml

from solmap.config.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
VARIABLES = {f"SOLMAP_{name.upper()}" for name in Settings.model_fields}


def test_every_variable_of_ours_is_a_setting():
    for file in DEPLOY.iterdir():
        named = set(re.findall(r"\bSOLMAP_[A-Z_]+", file.read_text()))
        assert named <= VARIABLES, f"{file.name}: {named - VARIABLES}"
        assert named, f"{file.name} sets nothing"


def test_the_parts_of_a_cluster_know_each_other():
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    services = compose["services"]
    for name, service in services.items():
        assert set(service.get("depends_on", [])) <= set(services), name
        for volume in service.get("volumes", []):
            assert volume.partition(":")[0] in compose["volumes"], name
        for value in service.get("environment", {}).values():
            hosts = re.findall(r"(?:@|//)([a-z]+)(?::\d+)?(?:/|$)", str(value))
            assert set(hosts) <= {*services, "solmap"}, f"{name}: {value}"  # s3://solmap/...
    shared = {"SOLMAP_STORE", "SOLMAP_STORE_URL", "SOLMAP_CATALOGUE_URL", "SOLMAP_DASK_ADDRESS"}
    for name in ("flows", "map", "worker"):
        assert shared <= set(services[name]["environment"]), name
    assert [name for name, service in services.items() if "ports" in service] == ["map"]


def test_a_container_is_built_from_the_repository_alone():
    ignored = {
        line.strip("/")
        for line in (ROOT / ".gitignore").read_text().splitlines()
        if line and "*" not in line
    }
    left_out = {line.removeprefix("**/") for line in (ROOT / ".dockerignore").read_text().split()}
    assert ignored <= left_out


def test_the_container_file_copies_and_runs_what_there_is():
    text = (DEPLOY / "Containerfile").read_text().replace("\\\n", " ")
    steps = [line.split(maxsplit=1) for line in text.splitlines() if line and line[0] != "#"]
    known = {"FROM", "RUN", "WORKDIR", "COPY", "USER", "ENV", "VOLUME", "EXPOSE", "CMD"}
    assert {word for word, _ in steps} <= known
    targets = re.findall(r"make (\w+)", " ".join(rest for word, rest in steps if word == "RUN"))
    makefile = (ROOT / "Makefile").read_text()
    for target in targets:
        if target != "git":  # `apt-get install make git`
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
