"""The server held to its own description by schemathesis, and under hostile addresses and sizes.

Both talk to a process of its own that also notes every file it opens: what a URL names must not
lead out of the store.
"""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from tests.support import fuzz_store
from tests.support.live_server import running

ROOT = Path(__file__).parents[2]
CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_schema_conformance",
    "response_headers_conformance",
    "unsupported_method",
    "allow_header_conformance",
    "ignored_auth",
    "missing_required_header",
)
"""Left out are `positive_data_acceptance`, as a place that is well written may lie off the map, and
`negative_data_rejection`, as names in a query that mean nothing are passed over."""
SECRET = "the-secret-beside-the-store"  # noqa: S105 - a word to look for
_SERVE = """
import pathlib, sys
noted = open(sys.argv[2], "a", buffering=1)
def note(event, given):
    if event == "open" and isinstance(given[0], str | bytes):
        noted.write(repr(given[0]) + "\\n")
from solmap.gis_server.app import create_app
import uvicorn
app = create_app(pathlib.Path(sys.argv[1]))
sys.addaudithook(note)
uvicorn.run(app, port=int(sys.argv[3]), log_level="warning", timeout_graceful_shutdown=1)
"""


@dataclass(frozen=True)
class Target:
    """A server for unusual requests."""

    address: str
    port: int
    root: Path
    token: str
    opened: Path
    """File with the names of all files that its process opened."""


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    yield from _serve(tmp_path_factory.mktemp("fuzz"), images=False)


@pytest.fixture(scope="module")
def full_target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    yield from _serve(tmp_path_factory.mktemp("fuzz"), images=True)


def _serve(folder: Path, *, images: bool) -> Iterator[Target]:
    root, opened = folder / "store", folder / "opened.txt"
    token = fuzz_store.fill(root, images=images)
    (folder / "secret.txt").write_text(SECRET)
    with running([sys.executable, "-c", _SERVE, str(root), str(opened)]) as server:
        yield Target(server.address, server.port, root, token, opened)


WITHOUT_ENGINE = """
[[operations]]
include-path-regex = "^/api/(runs|engine)"
checks.not_a_server_error.expected-statuses = ["2xx", "3xx", "4xx", "503"]
"""
"""No engine runs beside the server: requests that need it are refused by 503 with Retry-After."""


def fuzz(target: Target, folder: Path, token: str | None, *bounds: str) -> str:
    """Final output of a run of schemathesis; with a token it may write."""
    names = folder / "names.json"
    names.write_text(json.dumps(fuzz_store.names(target.root)))
    config = folder / "schemathesis.toml"
    shown = f'Authorization = "Bearer {token}"' if token else ""
    config.write_text(f"[headers]\n{shown}\n{WITHOUT_ENGINE}")
    environment = {
        **os.environ,
        "SCHEMATHESIS_HOOKS": "tests.support.schema_hooks",
        "SOLMAP_NAMES": str(names),
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(config), "run"]
    command += [f"{target.address}/openapi.json", "--exclude-path", "/api/events"]
    command += ["--wait-for-schema", "60"]  # of a machine under load
    command += ["--checks", ",".join(CHECKS), "--seed", "20040104", "--continue-on-failure"]
    command += ["--generation-database", "none", "--no-color", "--suppress-health-check", "all"]
    command += bounds
    run = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    return run.stdout + run.stderr


def failures_in(message: str) -> list[str]:
    found = re.findall(r"(?m)^_{3,} (.*?) _{3,}$|^- (ST\d+.*)$|^    (curl .*)$", message)
    return ["".join(parts)[:400] for parts in found]


def questions_in(message: str) -> int:
    return int(re.search(r"(\d+) generated", message)[1])


def test_answers_conform_to_the_openapi_schema(target, tmp_path):
    few = ("--phases", "fuzzing", "--max-examples", "1")
    message = fuzz(target, tmp_path, target.token, *few)
    assert not failures_in(message), message[-6000:]
    assert questions_in(message) > 100, message[-3000:]


def test_requests_without_a_token_are_refused_as_documented(target, tmp_path):
    writes = ("--include-method", "POST", "--phases", "fuzzing", "--max-examples", "1")
    message = fuzz(target, tmp_path, None, *writes)
    assert not failures_in(message), message[-6000:]
    assert questions_in(message) > 10, message[-3000:]


@pytest.mark.slow
def test_answers_conform_to_the_openapi_schema_for_minutes(full_target, tmp_path):
    many = ("--phases", "coverage,fuzzing", "--max-examples", "100", "--max-time", "300")
    message = fuzz(full_target, tmp_path, full_target.token, *many)
    assert not failures_in(message), message[-6000:]
    assert questions_in(message) > 3000, message[-3000:]


UPWARDS = (
    "../secret.txt",
    "..%2fsecret.txt",
    "%2e%2e%2fsecret.txt",
    "%252e%252e%252fsecret.txt",
    "..%5csecret.txt",
    "....//secret.txt",
    "..;/secret.txt",
    "%c0%ae%c0%ae/secret.txt",
    "/etc/passwd",
    "%2fetc%2fpasswd",
    "C:%5cWindows%5cwin.ini",
    "file:%2f%2f%2fetc%2fpasswd",
    "secret.txt%00.png",
    "%00",
    "a" * 5000,
    "\u0301%f0%9f%92%a9",
    "%ff%fe",
    "vsicurl%2fhttp:%2f%2f127.0.0.1%2fx.tif",
)
"""Names that lead out of a folder where somebody joins them to one."""
PLACES = (
    "/{}",
    "/tiles/{}/dtm/0123456789abcdef/0/0/0.png",
    "/tiles/mer2/{}/0123456789abcdef/0/0/0.png",
    "/tiles/mer2/dtm/{}/0/0/0.png",
    "/images/{}/browse.png",
    "/images/{}/original",
    "/images/{}/info",
    "/panoramas/{}/0123456789abcdef/0/0/0.jpg",
    "/download/{}/dtm/0123456789abcdef",
    "/download/mer2/dtm/{}",
    "/products/dtm/{}/0123456789abcdef.tif",
    "/products/dtm/mer2/0123456789abcdef.{}",
    "/models/mer2/tileset/0123456789abcdef/{}",
    "/stac/{}/collection.json",
    "/stac/MER2/{}.json",
    "/api/missions/{}/layers",
    "/api/missions/{}/sols/155/report",
    "/api/reports/{}/0123456789abcdef.html",
    "/api/runs/{}",
    "/ogc/{}/collections",
    "/ogc/MER2/collections/{}/items",
    "/ogc/MER2/collections/stops/items/{}",
    "/ogc/MER2/wmts/1.0.0/{}/default/x/0/0/0.png",
    "/api/missions/MER2/images?stop={}",
    "/api/missions/MER2/ground-to-image?east=0&north=0&layer={}",
)


def raw(target: Target, request: bytes) -> bytes:
    """An answer to bytes as they are: clients of HTTP would tidy a path up first."""
    with socket.create_connection(("127.0.0.1", target.port), timeout=30) as connection:
        connection.sendall(request)
        parts = []
        while part := connection.recv(1 << 16):
            parts.append(part)
    return b"".join(parts)


def status_of(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


def test_no_name_in_a_url_reaches_outside_the_store(target):
    target.opened.write_text("")
    reported = []
    for place in PLACES:
        for name in UPWARDS:
            path = place.format(name).encode()
            head = b"GET %s HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n" % path
            answer = raw(target, head)
            reported.append((status_of(answer), path[:120]))
            assert SECRET.encode() not in answer, path
            assert b"root:" not in answer, path
    assert not [one for one in reported if one[0] >= 500]
    allowed = (str(target.root), str(ROOT), sys.prefix, sys.base_prefix, "/dev/urandom")
    opened = {line.strip("b'\"") for line in target.opened.read_text().splitlines()}
    assert not [path for path in opened if path.startswith("/") and not path.startswith(allowed)]
    named = ("secret", "passwd", "win.ini")
    assert not [path for path in opened if any(name in path for name in named)]


def test_the_record_of_opened_files_contains_what_is_read(target):
    """Else the test before would hold whatever the server opens."""
    target.opened.write_text("")
    (layer,) = [row for row in fuzz_store.names(target.root) if row.get("kind") == "contours"]
    address = "/api/layers/{scope}/{kind}/{digest}/provenance".format(**layer)
    assert httpx.get(target.address + address).status_code == 200
    assert any(layer["digest"] in line for line in target.opened.read_text().splitlines())


HUGE = "9" * 400
SIZES = (
    "/api/missions/MER2/identify?east=1e308&north=-1e308",
    "/api/missions/MER2/identify?east=nan&north=inf",
    f"/api/missions/MER2/images?sol={HUGE}",
    f"/api/runs?limit={HUGE}",
    f"/ogc/MER2/collections/stops/items?limit={HUGE}&offset={HUGE}",
    "/ogc/MER2/collections/stops/items?bbox=-1e308,-1e308,1e308,1e308",
    "/ogc/MER2/collections/stops/items?bbox=nan,nan,nan,nan",
    "/ogc/MER2/collections/stops/items?bbox=" + ",".join("1" * 3000),
    "/ogc/MER2/collections/stops/items?datetime=" + "9" * 3000,
    "/ogc/MER2/collections/stops/items?" + "&".join(f"a{n}=1" for n in range(3000)),
    "{tiles}/99/1/1.png",
    f"{{tiles}}/17/{HUGE}/{HUGE}.png",
    "{tiles}/17/-1/-1.png",
    "{tiles}/17/65536/65535.png?low=nan&high=inf",
    "{tiles}/17/65536/65535.png?interval=1e-300&style=" + "a" * 3000,
    "{download}/clip?bbox=-1e308,-1e308,1e308,1e308",
    "{download}/clip?bbox=inf,inf,inf,inf",
    f"/api/missions/MER2/viewshed?east={HUGE}&north=0",
    "/api/missions/MER2/viewshed?east=0&north=0&radius_m=1e300",
    f"/api/events?since={HUGE}",
)


def test_huge_numbers_and_long_queries_are_refused_at_once(target):
    (dtm,) = [row for row in fuzz_store.names(target.root) if row.get("kind") == "dtm"]
    path = "{scope}/{kind}/{digest}".format(**dtm)
    filled = {"tiles": f"/tiles/{path}", "download": f"/download/{path}"}
    with httpx.Client(base_url=target.address, timeout=30) as client:
        reported = [(client.get(one.format(**filled)).status_code, one[:100]) for one in SIZES]
    assert not [one for one in reported if one[0] >= 500]
    assert all(code >= 400 for code, one in reported if "nan" in one or HUGE in one)


def test_large_and_malformed_bodies_are_refused(target):
    place = f"{target.address}/api/missions/MER2"
    writer = {"Authorization": f"Bearer {target.token}"}
    line = {"line": [[0.0, 0.0]] * 200_000, "layer": "best"}
    deep = b'{"line":' + b"[" * 100_000
    bodies = (
        json.dumps(line).encode(),
        deep,
        b"\x1f\x8b" + b"\0" * 1000,
        b'{"line": [[1e999, NaN], [0, 0]], "layer": "best"}',
        b'{"text": "\\ud800", "geometry": {"type": "Point", "coordinates": [0, 0]}}',
        b"\xff\xfe",
        b"",
    )
    codes = {
        (httpx.post(f"{place}/{end}", content=body, headers=writer, timeout=30).status_code, end)
        for body in bodies
        for end in ("profile", "measure-area", "edits/annotations", "edits/ties")
    }
    assert {code for code, _ in codes} <= {400, 413, 422}, codes


def test_an_endless_body_is_cut_off(target):
    head = (
        b"POST /api/missions/MER2/profile HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    chunk = b"100000\r\n" + b" " * 0x100000 + b"\r\n"
    with socket.create_connection(("127.0.0.1", target.port), timeout=30) as connection:
        connection.sendall(head + chunk + chunk + b"0\r\n\r\n")
        assert status_of(connection.recv(1 << 16)) == 413


def test_wrong_tokens_are_throttled_and_valid_ones_are_not(target):
    place = f"{target.address}/api/account"
    guess = {"Authorization": "Bearer solmap_00000000_x"}
    codes = [httpx.get(place, headers=guess).status_code for _ in range(25)]
    assert codes[0] in {200, 401}
    write = f"{target.address}/api/missions/MER2/edits/annotations"
    codes = [httpx.post(write, headers=guess, json={}).status_code for _ in range(25)]
    assert codes[-1] == 429
    note = {"geometry": {"type": "Point", "coordinates": [1.0, 2.0]}, "text": "seen"}
    right = {"Authorization": f"Bearer {target.token}"}
    assert httpx.post(write, headers=right, json=note).status_code == 201
