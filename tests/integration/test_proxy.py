"""The map behind a reverse proxy, at a path of its host: addresses, live events, trusted proxies.

nginx and Caddy run as docs/how-to/reverse-proxy.md configures them, where they are installed.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import ssl
import subprocess
import sys
import threading
import time
from html import unescape
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import httpx
import pytest
import uvicorn
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from solmap.flows.cli import app as command_line
from solmap.flows.runtime.engine import free_port
from solmap.gis_server.app import create_app
from solmap.products.catalogue.workspace import Workspace
from solmap.tasks.mission.publish import update_stac
from tests.support.bowl_store import fill
from tests.support.live_server import running

ROOT = Path(__file__).resolve().parents[2]
HOW_TO = ROOT / "docs" / "how-to" / "reverse-proxy.md"
PUBLIC = "https://maps.example.org/solmap"
DOCUMENTS = (
    "/api/start",
    "/api/runs",
    "/api/missions/MER2/images",
    "/api/missions/MER2/addresses",
    "/api/missions/MER2/models",
    "/ogc/MER2",
    "/ogc/MER2/collections",
    "/ogc/MER2/collections?f=html",
    "/ogc/MER2/collections/stops/items",
    "/ogc/MER2/tileMatrixSets",
    "/ogc/MER2/wmts/1.0.0/WMTSCapabilities.xml",
    "/stac/catalog.json",
    "/docs",
    "/",
)
_PATHS = r"api|tiles|images|download|models|panoramas|products|ogc|stac|docs|openapi\.json"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("proxy") / "store"
    workspace = Workspace.open(folder)
    fill(workspace)
    mission = workspace.catalogue.mission("MER2")
    update_stac(mission, workspace.catalogue.layers("MER2"), workspace)
    return folder


def addresses_in(text: str) -> set[str]:
    """What a document names of this server: absolute addresses, and paths of the server."""
    text = unescape(text)
    absolute = re.findall(
        r"https?://[a-z0-9.:-]*(?:example\.org|127\.0\.0\.1|testserver)[^\s\"'<>]*", text
    )
    paths = re.findall(rf"[\"'](/(?:solmap/)?(?:{_PATHS})[^\s\"'<>]*)[\"']", text)
    return {*absolute, *paths}


@pytest.mark.parametrize("handed_on", ["", "/solmap"], ids=["path taken off", "path left on"])
def test_every_url_in_documents_is_below_the_public_path_and_answers(root, handed_on):
    seen: set[str] = set()
    with TestClient(create_app(root, public_url=f"{PUBLIC}/")) as client:
        for document in DOCUMENTS:
            answer = client.get(handed_on + document)
            assert answer.status_code == 200, document
            seen |= addresses_in(answer.text)
        assert len(seen) > 50
        places = {urljoin(PUBLIC, address) for address in seen}
        assert all(place.startswith(f"{PUBLIC}/") for place in places), places
        whole = (place for place in places if not re.search(r"[{?]|/crs/lon-lat$|/wmts$", place))
        paths = [handed_on + place.removeprefix(PUBLIC) for place in whole]
        unanswered = [path for path in paths if client.get(path).status_code != 200]
        assert not unanswered
        assert client.get(f"{handed_on}/openapi.json").json()["servers"] == [{"url": "/solmap"}]


def test_routes_see_the_path_without_the_proxy_prefix(root):
    with TestClient(create_app(root, public_url=PUBLIC), follow_redirects=False) as client:
        assert client.get("/solmap").headers["location"] == f"{PUBLIC}/"
        layers = client.get("/solmap/api/missions/MER2/layers").json()
        download = next(one["download"] for one in layers if one["type"] == "raster")
        assert download.startswith("/solmap/download/")
        assert "content-encoding" not in client.get(download).headers
        refused = client.delete("/solmap/api/missions")
        assert refused.status_code == 405
        assert refused.headers["allow"] == "GET"


@pytest.mark.parametrize(
    ("trusted", "scheme"),
    [("", "http"), ("10.0.0.0/8", "http"), ("127.0.0.1", "https"), ("127.0.0.0/8", "https")],
)
def test_only_trusted_proxies_set_the_scheme(root, trusted, scheme, monkeypatch):
    monkeypatch.setenv("SOLMAP_TRUSTED_PROXIES", trusted)
    monkeypatch.setenv("FORWARDED_ALLOW_IPS", "*")
    command = ["serve", "--store", str(root), "--port", str(free_port())]
    given = {}
    monkeypatch.setattr(uvicorn, "run", lambda _app, **options: given.update(options))
    assert CliRunner().invoke(command_line, command).exit_code == 0
    del given["factory"]
    config = uvicorn.Config(create_app(root), **given)
    config.load()
    forwarded = {"X-Forwarded-Proto": "https", "X-Forwarded-For": "192.0.2.7"}
    with TestClient(config.loaded_app, client=("127.0.0.1", 50000)) as client:
        document = client.get("/ogc/MER2", headers=forwarded).json()
    assert document["links"][0]["href"] == f"{scheme}://testserver/ogc/MER2"


@pytest.fixture(scope="module")
def served(root):
    """Port of the map, served as behind a proxy."""
    environment = {"SOLMAP_PUBLIC_URL": f"{PUBLIC}/", "SOLMAP_TRUSTED_PROXIES": "127.0.0.1"}
    command = [sys.executable, "-m", "solmap.flows.cli", "serve", "--store", str(root), "--port"]
    with running(command, environment) as server:
        yield server.port


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """A certificate of maps.example.org, signed by itself, and its key."""
    folder = tmp_path_factory.mktemp("certificate")
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2"
    names = ["-subj", "/CN=maps.example.org", "-addext", "subjectAltName=DNS:maps.example.org"]
    files = ["-out", "maps.pem", "-keyout", "maps.key"]
    if not shutil.which("openssl"):
        pytest.skip("openssl is not installed")
    subprocess.run([*command.split(), *names, *files], cwd=folder, check=True, capture_output=True)
    return folder / "maps.pem", folder / "maps.key"


@pytest.fixture(scope="module", params=["nginx", "caddy"])
def proxy(request, served, certificate, tmp_path_factory):
    """A client of the map over TLS, through a proxy configured as documented."""
    program = shutil.which(request.param)
    if program is None:
        pytest.skip(f"{request.param} is not installed")
    folder = tmp_path_factory.mktemp(request.param)
    port = free_port()
    text = re.search(rf"```{request.param}\n(.*?)```", HOW_TO.read_text(), re.DOTALL)[1]
    text = text.replace("127.0.0.1:8765", f"127.0.0.1:{served}")
    command = (_nginx if request.param == "nginx" else _caddy)(
        program, text, folder, port, certificate
    )
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            command, cwd=folder, stdout=log, stderr=log, env={"HOME": str(folder)}
        )
    trusted = ssl.create_default_context(cafile=str(certificate[0]))
    # the public name leads to the proxy of this test, as a name server would have it
    extensions = {"sni_hostname": "maps.example.org"}
    with httpx.Client(base_url=f"https://127.0.0.1:{port}", verify=trusted, timeout=30) as client:
        client.headers["Host"] = "maps.example.org"
        client.event_hooks["request"] = [lambda requested: requested.extensions.update(extensions)]
        try:
            deadline = time.monotonic() + 30
            while not _is_ready(client):
                assert process.poll() is None, (folder / "log").read_text()
                assert time.monotonic() < deadline, (folder / "log").read_text()
                time.sleep(0.1)
            yield client
        finally:
            process.terminate()
            process.wait(timeout=30)


def _nginx(program, text, folder, port, certificate):
    text = text.replace("listen 443 ssl", f"listen 127.0.0.1:{port} ssl")
    text = text.replace("/etc/ssl/maps.example.org.pem", str(certificate[0]))
    text = text.replace("/etc/ssl/maps.example.org.key", str(certificate[1]))
    paths = "".join(
        f"{name}_temp_path {folder}/{name};"
        for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    main = f"pid {folder}/pid; error_log stderr; daemon off; events {{}}"
    (folder / "nginx.conf").write_text(f"{main} http {{ access_log off; {paths}\n{text}}}\n")
    command = [program, "-p", str(folder), "-e", "stderr", "-c", str(folder / "nginx.conf")]
    subprocess.run([*command, "-t"], check=True, capture_output=True)
    return command


def _caddy(program, text, folder, port, certificate):
    site = f"maps.example.org:{port} {{\n    tls {certificate[0]} {certificate[1]}"
    text = text.replace("maps.example.org {", site, 1)
    (folder / "Caddyfile").write_text("{\n    admin off\n    auto_https off\n}\n" + text)
    command = [program, "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]
    subprocess.run(
        [program, "validate", *command[2:]],
        check=True,
        capture_output=True,
        env={"HOME": str(folder)},
    )
    return command


def _is_ready(client):
    with contextlib.suppress(httpx.TransportError):
        return client.get("/solmap/healthz").status_code == 200
    return False


def test_documents_contain_urls_that_the_proxy_answers(proxy):
    links = proxy.get("/solmap/ogc/MER2").json()["links"]
    assert len(links) > 5
    for link in links:
        parts = urlsplit(link["href"])
        assert f"{parts.scheme}://{parts.netloc}" == "https://maps.example.org"
        assert proxy.get(f"{parts.path}?{parts.query}").status_code == 200, link
    layers = proxy.get("/solmap/api/missions/MER2/layers").json()
    download = next(one["download"] for one in layers if one["type"] == "raster")
    part = proxy.get(download, headers={"Range": "bytes=0-99"})
    assert (part.status_code, len(part.content)) == (206, 100)


def test_the_page_and_all_its_files_load_through_the_proxy(proxy):
    moved = proxy.get("/solmap", headers={"Accept": "text/html"})
    assert moved.is_redirect
    assert urlsplit(moved.headers["location"]).path == "/solmap/"
    page = proxy.get("/solmap/")
    assert page.status_code == 200
    loaded = re.findall(r"(?:src|href)=\"([^\"#]+)\"", page.text)
    ours = [address for address in loaded if not address.startswith("data:")]
    if not (ROOT / "gis_server" / "viewer" / "dist" / "index.html").is_file():
        pytest.skip("the viewer is not built")
    assert "api/start" in ours
    for address in ours:
        assert proxy.get(urljoin("/solmap/", address)).status_code == 200, address


def test_events_arrive_through_the_proxy_immediately(proxy, root):
    catalogue = Workspace.open(root).catalogue
    published = "layers.published"

    def publish() -> None:
        catalogue.append_event(published, {"mission": "MER2", "layers": []})

    with proxy.stream("GET", "/solmap/api/events", timeout=10) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        lines = answer.iter_lines()
        assert any("hello" in line for line in lines)  # before anything else happens
        threading.Timer(0.2, publish).start()
        assert any(published in line for line in lines)
