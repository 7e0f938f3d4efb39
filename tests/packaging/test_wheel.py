"""The wheel is the product: installed in an empty environment it maps a downlink and serves it.

Run by `make test-wheel`, which builds the wheel first.
"""

import hashlib
import json
import os
import re
import socket
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("config", "flows", "gis_server", "photogrammetry", "products", "tasks")


@pytest.fixture(scope="module")
def wheel() -> Path:
    """The wheel that `make wheel` built."""
    wheels = sorted((ROOT / "dist").glob("solmap-*.whl"))
    if not wheels:
        pytest.skip("no wheel in dist/: run `make wheel` first")
    return wheels[-1]


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Programs of an empty environment that holds the wheel and its locked runtime packages."""
    folder = tmp_path_factory.mktemp("environment")
    programs = folder / "venv" / "bin"
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    install = [programs / "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*install, "--requirement", ROOT / "requirements.lock"], check=True)
    subprocess.run([*install, wheel], check=True)
    return programs


def run(programs: Path, *arguments: str | Path, folder: Path) -> str:
    """What a program of the environment printed; fails with it where it fails."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "PYTHON"))}
    done = subprocess.run(
        [programs / arguments[0], *arguments[1:]],
        cwd=folder,
        env=clean,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_wheel_contains_one_package_and_the_viewer(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"solmap"}
    for package in PACKAGES:
        sources = {
            f"solmap/{path.relative_to(ROOT)}"
            for path in (ROOT / package).rglob("*.py")
            if "node_modules" not in path.parts
        }
        assert sources <= set(names)
    assert "solmap/gis_server/viewer/dist/index.html" in names
    assert "solmap/config/landing_sites.toml" in names
    assert "solmap/py.typed" in names
    assert not [name for name in names if "node_modules" in name or "/tests/" in name]


def test_a_bill_of_materials_is_written_beside_the_wheel(wheel):
    (path,) = wheel.parent.glob("solmap-*.cdx.json")
    product = json.loads(path.read_text())["metadata"]["component"]
    assert f"-{product['version']}-" in wheel.name
    (digest,) = product["externalReferences"][0]["hashes"]
    assert digest["content"] == hashlib.sha256(wheel.read_bytes()).hexdigest()


def test_requirements_of_the_wheel_equal_the_lock(environment, tmp_path):
    run(environment, "pip", "check", folder=tmp_path)


def test_the_package_imports_and_has_its_version(environment, wheel, tmp_path):
    printed = run(
        environment, "python", "-c", "import solmap; print(solmap.__version__)", folder=tmp_path
    )
    assert f"solmap-{printed.strip()}-" in wheel.name
    assert printed.strip() in run(environment, "solmap", "--version", folder=tmp_path)


@pytest.fixture(scope="module")
def served(environment: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a server of the wheel over a downlink that the wheel simulated and mapped."""
    folder = tmp_path_factory.mktemp("mission")
    run(environment, "solmap", "simulate", "downlink", "--stops", "1", folder=folder)
    run(
        environment,
        *("solmap", "run", "downlink", "--store", "store", "--pipeline", "quicklook"),
        folder=folder,
    )
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    command = [environment / "solmap", "serve", "--store", "store", "--port", port]
    server = subprocess.Popen(command, cwd=folder)
    address = f"http://127.0.0.1:{port}"
    try:
        for _ in range(600):
            try:
                urlopen(f"{address}/healthz").close()
                break
            except URLError:
                assert server.poll() is None, "the server ended before it answered"
                time.sleep(0.1)
        yield address
    finally:
        server.terminate()
        server.wait(30)


def test_the_first_page_is_the_map(served):
    page = urlopen(f"{served}/").read().decode()
    assert 'id="app"' in page
    scripts = re.findall(r'(?:src|href)="(?:\./|/)?(assets/[^"]+\.js)"', page)
    assert scripts, page
    assert sum(len(urlopen(f"{served}/{script}").read()) for script in scripts) > 100_000


def test_the_map_has_the_layers_of_the_stop(served):
    start = json.load(urlopen(f"{served}/api/start"))
    assert start["mission"] == "MER2"
    kinds = {layer["kind"] for layer in start["layers"]}
    assert {"dtm", "orthophoto", "contours", "slope", "traverse"} <= kinds
