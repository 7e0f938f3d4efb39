"""What is in deploy/ names what there is and grants no more than is needed."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from solmap.config.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
UNIT = DEPLOY / "solmap.service"
VARIABLES = {f"SOLMAP_{name.upper()}" for name in Settings.model_fields}
MOST_EXPOSED = 1.2
"""By `systemd-analyze security`, from 0 to 10; the remainder is the network."""


def test_every_variable_of_the_deployment_is_a_setting():
    named: set[str] = set()
    for file in [*DEPLOY.iterdir(), *(ROOT / "docs" / "how-to").iterdir()]:
        named |= (found := set(re.findall(r"\bSOLMAP_[A-Z_]+", file.read_text())))
        assert found <= VARIABLES, f"{file.name}: {found - VARIABLES}"
    assert named


def compose():
    return yaml.safe_load((DEPLOY / "compose.yaml").read_text())


def test_the_parts_of_a_cluster_are_configured_for_each_other():
    document = compose()
    services = document["services"]
    for name, service in services.items():
        assert set(service.get("depends_on", [])) <= set(services), name
        for volume in service.get("volumes", []):
            assert volume.partition(":")[0] in document["volumes"], name
        for value in service.get("environment", {}).values():
            hosts = re.findall(r"(?:@|//)([a-z]+)(?::\d+)?(?:/|$)", str(value))
            assert set(hosts) <= {*services, "solmap"}, f"{name}: {value}"  # s3://solmap/...
    shared = {"SOLMAP_STORE", "SOLMAP_STORE_URL", "SOLMAP_CATALOGUE_URL", "SOLMAP_DASK_ADDRESS"}
    for name in ("flows", "map", "worker"):
        assert shared <= set(services[name]["environment"]), name


def test_only_the_map_is_open_and_the_engine_requires_a_password():
    services = compose()["services"]
    assert [name for name, service in services.items() if "ports" in service] == ["map"]
    requested = "solmap:${ENGINE_PASSWORD:?}"  # which compose refuses to leave out
    assert services["engine"]["environment"]["PREFECT_SERVER_API_AUTH_STRING"] == requested
    for name in ("flows", "worker"):
        assert services[name]["environment"]["PREFECT_API_AUTH_STRING"] == requested
    assert services["map"]["environment"]["PREFECT_API_AUTH_STRING"] == ""


def test_the_map_reaches_catalogue_and_products_and_no_worker():
    document = compose()
    networks = {name: set(one["networks"]) for name, one in document["services"].items()}
    assert set().union(*networks.values()) == set(document["networks"])
    reached = {name for name, those in networks.items() if those & networks["map"]}
    assert reached == {"map", "postgres", "objects"}
    for name, service in document["services"].items():
        for needed in service.get("depends_on", []):
            assert networks[name] & networks[needed], f"{name} does not reach {needed}"


def test_containers_have_no_rights_and_secrets_come_from_the_environment():
    for name, service in compose()["services"].items():
        assert service["security_opt"] == ["no-new-privileges:true"], name
        if service["image"] == "solmap":
            assert service["read_only"], name
            assert service["cap_drop"] == ["ALL"], name
        else:
            assert re.search(r":[\w.-]*\d", service["image"]), f"{name}: no version"
        for variable, value in service.get("environment", {}).items():
            if re.search(r"PASSWORD|SECRET|KEY|AUTH", variable) and value:
                assert re.search(r"\$\{\w+:\?\}", value), f"{name}: {variable}"


def test_a_container_is_built_from_the_repository_alone():
    ignored = {
        line.strip("/")
        for line in (ROOT / ".gitignore").read_text().splitlines()
        if line and "*" not in line
    }
    left_out = {line.removeprefix("**/") for line in (ROOT / ".dockerignore").read_text().split()}
    assert ignored <= left_out


def container_steps():
    text = (DEPLOY / "Containerfile").read_text().replace("\\\n", " ")
    lines = [line.split(maxsplit=1) for line in text.splitlines() if line and line[0] != "#"]
    return [(word, rest) for word, rest in lines]


def test_the_container_file_copies_and_runs_existing_files():
    steps = container_steps()
    known = {"FROM", "RUN", "WORKDIR", "COPY", "USER", "ENV", "VOLUME", "EXPOSE", "CMD"}
    assert {word for word, _ in steps} <= known
    commands = " ".join(rest for word, rest in steps if word == "RUN")
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"make (\w+)", commands.replace("recommends make", "")):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_the_container_has_a_pinned_base_and_no_rights():
    steps = container_steps()
    images = [rest for word, rest in steps if word == "FROM"]
    assert all(re.match(r"python:\d+\.\d+\.\d+-slim-\w+( AS build)?$", one) for one in images)
    assert [rest for word, rest in steps if word == "USER"] == ["solmap"]
    after_user = steps[steps.index(("USER", "solmap")) :]
    assert not {"RUN", "COPY"} & {word for word, _ in after_user}
    text = (DEPLOY / "Containerfile").read_text()
    assert not re.search(r"(?i)password|secret|token|\bADD\b|curl|--privileged", text)
    for command in (rest for word, rest in steps if word == "RUN" and "apt-get" in rest):
        assert "--no-install-recommends" in command
        assert "rm -rf /var/lib/apt/lists" in command


@pytest.mark.parametrize("script", ["deploy/try-container", ".ci/run"])
def test_scripts_pass_shellcheck(script):
    subprocess.run(["/bin/bash", "-n", script], cwd=ROOT, check=True)
    if shellcheck := shutil.which("shellcheck"):
        subprocess.run([shellcheck, script], cwd=ROOT, check=True)


def test_the_container_test_is_skipped_without_a_container_runtime(tmp_path):
    for tool in ("bash", "dirname", "env"):
        (tmp_path / tool).symlink_to(shutil.which(tool))
    done = subprocess.run(
        [DEPLOY / "try-container"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "try-container: neither podman nor docker works here; run it on a machine with one\n"
    )


def test_the_unit_stops_in_time_and_writes_only_in_its_own_folder():
    text = UNIT.read_text()
    options = dict(line.split("=", 1) for line in text.splitlines() if re.match(r"\w+=", line))
    assert 10 < int(options["TimeoutStopSec"]) <= 30
    assert options["ProtectSystem"] == "strict"
    assert "ReadWritePaths" not in options
    assert options["StateDirectory"] == "solmap"
    folders = re.findall(r"^Environment=SOLMAP_(?:STORE|INBOX)=(\S+)", text, re.MULTILINE)
    assert len(folders) == 2
    assert all(folder.startswith("/var/lib/solmap/") for folder in folders)


def test_the_exposure_of_the_unit_is_as_documented(tmp_path):
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    command = [analyze, "security", "--offline=true", "--no-pager", str(UNIT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = re.search(r"Overall exposure level for solmap.service: ([\d.]+)", done.stdout)
    if found is None:
        pytest.skip(f"systemd-analyze fails: {done.stderr.strip()[:200]}")
    assert float(found[1]) <= MOST_EXPOSED
    assert f"{MOST_EXPOSED} of 10" in (ROOT / "docs" / "how-to" / "deploy.md").read_text()
    installed = tmp_path / UNIT.name  # with a program that is there
    installed.write_text(re.sub(r"(?m)^ExecStart=\S+", "ExecStart=/bin/true", UNIT.read_text()))
    verified = subprocess.run(
        [analyze, "verify", str(installed)], capture_output=True, text=True, check=False
    )
    assert UNIT.name not in verified.stderr
