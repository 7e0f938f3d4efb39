"""What `make wheel` states of the packages that a wheel installs and carries."""

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The text of the bill of a wheel, and the wheel."""
    wheel = tmp_path_factory.mktemp("dist") / "solmap-1.2.3-py3-none-any.whl"
    wheel.write_bytes(b"a wheel")
    subprocess.run([sys.executable, ROOT / ".ci" / "bill-of-materials", wheel], check=True)
    return wheel.with_name("solmap-1.2.3.cdx.json").read_text(), wheel


@pytest.fixture(scope="module")
def components(written):
    return {one["purl"]: one for one in json.loads(written[0])["components"]}


def hashes_of(component):
    return {one["content"] for one in component["externalReferences"][0]["hashes"]}


def test_the_bill_of_materials_is_valid_and_names_the_wheel(written):
    text, wheel = written
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    product = json.loads(text)["metadata"]["component"]
    assert (product["name"], product["version"]) == ("solmap", "1.2.3")
    assert hashes_of(product) == {hashlib.sha256(wheel.read_bytes()).hexdigest()}
    assert not re.search(r"https?://(?!cyclonedx\.org)", text), "an address of some registry"


def test_it_lists_every_locked_package_with_its_hashes(components):
    lock = (ROOT / "requirements.lock").read_text()
    pins = re.findall(r"(?m)^([a-z0-9][\w.-]*)(?:\[.*\])?==([^\s;]+)", lock)
    python = {purl for purl in components if purl.startswith("pkg:pypi/")}
    assert python == {f"pkg:pypi/{name}@{version}" for name, version in pins}
    hashes = set().union(*(hashes_of(components[purl]) for purl in python))
    assert hashes == set(re.findall(r"--hash=sha256:([0-9a-f]{64})", lock))


def test_it_lists_viewer_dependencies_and_no_build_tool(components):
    package = json.loads((ROOT / "gis_server" / "viewer" / "package.json").read_text())
    bundled = {*package["dependencies"], "swagger-ui-dist"}  # imported, and copied
    node = {one["name"] for purl, one in components.items() if purl.startswith("pkg:npm/")}
    assert node >= bundled
    assert not node & {"vite", "vitest", "typescript", "prettier"}


def test_every_installed_package_has_a_known_licence(components):
    unknown = {purl for purl, one in components.items() if not one.get("licenses")}
    assert len(unknown) <= 5, unknown  # those of other platforms and Python versions
