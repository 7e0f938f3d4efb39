"""The server under load while a flow publishes: no failure, whole tiles only, and how fast.

`pytest tests/integration/test_load.py -m slow -s` prints its figures.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from solmap.products.store.product_store import ProductStore
from tests.support.live_server import running
from tests.support.live_server import serving as serve

CLIENTS = 8
MOST_S = 400.0
"""The load stops by itself, whatever the flow does."""
AT_LEAST_S = 15.0
_FILES = """
import sys, uvicorn
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
ready = Route("/healthz", lambda _request: PlainTextResponse("ok"))
app = Starlette(routes=[ready, Mount("/", StaticFiles(directory=sys.argv[1]))])
uvicorn.run(app, port=int(sys.argv[2]), log_level="error")
"""


@dataclass
class Answers:
    """What clients were answered."""

    tiles: list[float] = field(default_factory=list)
    features: list[float] = field(default_factory=list)
    files: list[float] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    digests: set[str] = field(default_factory=set)

    def figures(self) -> dict[str, dict[str, float]]:
        kinds = {"tiles": self.tiles, "features": self.features, "static files": self.files}
        return {
            name: {
                "answers": len(times),
                "p50 ms": round(1e3 * float(np.percentile(times, 50)), 1),
                "p95 ms": round(1e3 * float(np.percentile(times, 95)), 1),
            }
            for name, times in kinds.items()
        }


def test_publishing_disturbs_no_reader(tmp_path):
    """The small sister: products are made and published one by one while clients read."""
    root = tmp_path / "store"
    script = (
        "import pathlib, sys; from solmap.products.catalogue.workspace import Workspace; "
        "from tests.support.bowl_store import fill; fill(Workspace.open(pathlib.Path(sys.argv[1])))"
    )
    Workspace.open(root)
    command = [sys.executable, "-c", script, str(root)]
    reported = under_load(root, command, tmp_path, 2.0)
    print(json.dumps(reported.figures(), indent=1))  # noqa: T201 - for docs/reference/measurements/server.md
    assert not reported.wrong, reported.wrong[:5]
    assert len(reported.tiles) > 10
    assert reported.digests


@pytest.mark.slow
def test_a_second_downlink_is_published_under_tile_requests(tmp_path):
    root, first, second = tmp_path / "store", tmp_path / "first", tmp_path / "second"
    run = [sys.executable, "-m", "solmap.flows.cli"]
    subprocess.run([*run, "simulate", str(first), "--stops", "2", "--seed", "5"], check=True)
    split(first, second)
    subprocess.run([*run, "run", str(first), "--store", str(root)], check=True)
    before = len(list(ProductStore.open(root).refs()))
    command = [*run, "run", str(second), "--store", str(root)]
    reported = under_load(root, command, tmp_path, AT_LEAST_S)
    print(json.dumps(reported.figures(), indent=1))  # noqa: T201 - for docs/reference/measurements/server.md
    assert not reported.wrong, reported.wrong[:5]
    store = ProductStore.open(root)
    assert len(list(store.refs())) > before
    assert len(reported.tiles) > 100


def split(first: Path, second: Path) -> None:
    """Move the images of the later half to a downlink of their own."""
    names = sorted(path for path in first.rglob("*") if path.suffix.lower() == ".img")
    second.mkdir()
    for path in names[len(names) // 2 :]:
        path.rename(second / path.name)


def under_load(root: Path, command: list[str], folder: Path, at_least_s: float) -> Answers:
    """Request tiles, features and static files until `command` has ended."""
    drawn = folder / "drawn"
    drawn.mkdir()
    (drawn / "tile.png").write_bytes(np.random.default_rng(1).bytes(30_000))
    reported = Answers()
    with (
        serve(root) as ours,
        running([sys.executable, "-c", _FILES, str(drawn)]) as files,
        (folder / "flow.txt").open("w") as message,
    ):
        flow = subprocess.Popen(command, stdout=message, stderr=message)
        try:
            asyncio.run(_request(ours, files.address, flow, reported, at_least_s))
            assert flow.wait(MOST_S) == 0, (folder / "flow.txt").read_text()[-2000:]
        finally:
            flow.kill()
    return reported


async def _request(
    ours: str, files: str, flow: subprocess.Popen, reported: Answers, at_least_s: float
) -> None:
    started = time.monotonic()

    def goes_on() -> bool:
        spent = time.monotonic() - started
        return spent < at_least_s or (flow.poll() is None and spent < MOST_S)

    async with httpx.AsyncClient(timeout=60) as client:
        clients = [_client(client, ours, goes_on, reported, number) for number in range(CLIENTS)]
        await asyncio.gather(*clients, _static(client, files, goes_on, reported))


async def _client(client, ours, goes_on, reported: Answers, number: int) -> None:
    rng = np.random.default_rng(number)
    while goes_on():
        for mission in await _get(client, f"{ours}/api/missions", reported) or ():
            name = mission["mission"] if "mission" in mission else mission["id"]
            layers = await _get(client, f"{ours}/api/missions/{name}/layers", reported) or []
            for layer in rng.permutation(np.array(layers, dtype=object))[:4]:
                reported.digests.add(layer["digest"])
                if layer["type"] == "raster":
                    await _tile(client, ours, layer, rng, reported)
                else:
                    await _features(client, ours, layer, reported)
        await asyncio.sleep(0.05)


async def _tile(client, ours, layer, rng, reported: Answers) -> None:
    """A tile near the middle of the map: it must be a whole PNG."""
    column, row = 65535 + rng.integers(0, 2), 65535 + rng.integers(0, 2)
    path = layer["tiles"].format(z=17, x=column, y=row)
    answer = await _answer(client, ours + path, reported, reported.tiles)
    if answer is None or answer.status_code != 200:
        return
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[:2] != (256, 256):
        reported.wrong.append(f"{path} is not a whole tile")


async def _features(client, ours, layer, reported: Answers) -> None:
    scope, kind, digest = layer["scope"], layer["kind"], layer["digest"]
    path = f"/api/layers/{scope}/{kind}/{digest}/features.geojson"
    answer = await _answer(client, ours + path, reported, reported.features)
    if answer is not None and answer.status_code == 200:
        assert answer.json()["type"] == "FeatureCollection"


async def _static(client, files: str, goes_on, reported: Answers) -> None:
    while goes_on():
        await _answer(client, f"{files}/tile.png", reported, reported.files)
        await asyncio.sleep(0.05)


async def _get(client, url: str, reported: Answers):
    answer = await _answer(client, url, reported, [])
    return answer.json() if answer is not None and answer.status_code == 200 else None


async def _answer(client, url: str, reported: Answers, times: list[float]):
    started = time.perf_counter()
    try:
        answer = await client.get(url)
    except httpx.HTTPError as error:
        reported.wrong.append(f"{url}: {type(error).__name__}")
        return None
    times.append(time.perf_counter() - started)
    if answer.status_code >= 500 or answer.status_code in {404, 422}:
        reported.wrong.append(f"{url}: {answer.status_code}")
    return answer
