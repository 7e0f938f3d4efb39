"""Heavy requests of many clients, among readers of tiles and features, while a run publishes.

The run has the priority that `solmap up` gives to runs. Clients, which would be on other machines,
have the same.

    python -m tests.support.heavy_load STORE --clients 50 --seconds 300

Each client has an address of its own (`X-Forwarded-For`), sends the requests of a person, waits a
little, and repeats them after `Retry-After`. Health is requested by a process of its own. The
store gains the sols of a simulated downlink; take a copy.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from solmap.flows.runtime.children import lower_priority
from solmap.photogrammetry.synthetic.downlink import simulate_downlink
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from tests.support.live_server import Server, running
from tests.support.small_downlink import write_coarse_pipeline

API = "/api/missions/MER2"
HEAVY_SHARE = 0.3
"""Of the requests of clients."""
PAUSE_S = 3.0
"""Mean time that a client looks at what it got."""
MOST_S = 0.2
"""That health is to take."""
SERVE = """
import os, sys, uvicorn
os.setsid()
os.environ["SOLMAP_STORE"] = sys.argv[1]
uvicorn.run(
    "solmap.gis_server.app:create_app_from_settings", factory=True, port=int(sys.argv[2]),
    log_level="error", forwarded_allow_ips="127.0.0.1", timeout_graceful_shutdown=1,
    timeout_keep_alive=75,
)
"""
Request = tuple[str, str, dict[str, Any] | None]
"""Method, address and body."""


@dataclass
class Record:
    """What clients were answered."""

    seconds: dict[str, list[float]] = field(default_factory=dict)
    """Of answers with status 200, by kind of request."""
    statuses: Counter[tuple[str, int]] = field(default_factory=Counter)
    refusals: Counter[str] = field(default_factory=Counter)
    """Reasons of 5xx."""
    wrong: list[str] = field(default_factory=list)

    def figures(self) -> dict[str, str]:
        """A line for each kind of request."""
        lines = {}
        for kind, times in sorted(self.seconds.items()):
            p50, p95 = np.percentile(times, [50, 95])
            others = {s: n for (k, s), n in sorted(self.statuses.items()) if k == kind and s != 200}
            lines[kind] = f"{len(times)} answers, p50 {p50:.3f} s, p95 {p95:.3f} s, other {others}"
        return lines


@dataclass
class Questions:
    """The requests that a store can answer."""

    heavy: list[tuple[str, Request]]
    light: list[tuple[str, Request]]

    @classmethod
    def of(cls, server: Server) -> Questions:
        """Read what there is."""

        def read(path: str) -> Any:
            with urllib.request.urlopen(server.address + path, timeout=30) as answer:
                return json.load(answer)

        layers, images = read(f"{API}/layers"), read(f"{API}/images")
        left = [one for one in images if one["partner"] and one["eye"] == "left"]
        return cls(list(_heavy(layers, left)), list(_light(layers, left)))


def _heavy(layers: list[dict[str, Any]], images: list[dict[str, Any]]) -> Any:
    def get(path: str) -> Request:
        return "GET", path, None

    square = [[-5, -5], [25, -5], [25, 25], [-5, 25]]
    for layer in layers:
        place = f"{layer['scope']}/{layer['kind']}/{layer['digest']}"
        west, south, east, north = layer["bounds"]
        if layer["kind"] == "dtm":
            yield "solid", get(f"/models/{place}/terrain.stl")
            yield "contours", get(f"/api/layers/{place}/contours.geojson?interval=0.05")
        if layer["kind"] in {"dtm", "orthophoto", "tie-points"}:
            yield "part", get(f"/download/{place}/clip?bbox={west},{south},{east},{north}")
        if layer["kind"] == "tie-points":
            yield "geopackage", get(f"/download/{place}.gpkg")
    for form in ("csv", "gpkg", "html", "json"):
        items = f"/ogc/MER2/collections/tie-points/items?f={form}&limit=10000"
        yield f"features {form}", get(items)
    yield "report", get(f"{API}/sols/{images[0]['sol']}/report")
    yield "viewshed", get(f"{API}/viewshed?east=14&north=16&radius_m=100")
    yield "reach", get(f"{API}/reach?east=14&north=16&farthest_m=500")
    yield "reach", get(f"{API}/reach.tif?east=14&north=16&farthest_m=50")
    yield "profile", ("POST", f"{API}/profile", {"line": [[-5, -5], [27, 34]]})
    yield "volume", ("POST", f"{API}/volume", {"polygon": square})
    yield "projection", get(f"{API}/ground-to-image?east=14&north=16")
    stops: dict[str, str] = {image["stop"]: image["id"] for image in reversed(images)}
    first, second = list(stops.values())[:2]
    ties = [
        {
            "first": {"image": first, "sample": 200 + k % 600, "line": 400 + 13 * k % 500},
            "second": {"image": second, "sample": 210 + k % 600, "line": 410 + 13 * k % 500},
            "sigma_px": 50,
        }
        for k in range(0, 3500, 7)
    ]
    yield "preview", ("POST", f"{API}/preview-adjustment", {"ties": ties})


def _light(layers: list[dict[str, Any]], images: list[dict[str, Any]]) -> Any:
    for layer in layers:
        if layer["tiles"]:
            for column, row in ((65535, 65535), (65536, 65535), (65535, 65536), (65536, 65536)):
                yield "tile", ("GET", layer["tiles"].format(z=17, x=column, y=row), None)
        elif layer["features"]:
            yield "features", ("GET", layer["features"], None)
    yield from (("start", ("GET", path, None)) for path in ("/api/start", f"{API}/layers"))
    for image in images[:8]:
        yield "picture", ("GET", f"/images/{image['id']}/stretched/1/0/0.png", None)


async def behave(
    number: int, server: Server, questions: Questions, record: Record, end: float
) -> None:
    """Be one client until the end."""
    rng = np.random.default_rng(number)
    headers = {"X-Forwarded-For": f"10.0.{number // 250}.{number % 250 + 1}"}
    async with httpx.AsyncClient(
        base_url=server.address, headers=headers, timeout=150, trust_env=False
    ) as client:
        while time.monotonic() < end:
            is_heavy = rng.random() < HEAVY_SHARE
            requested = questions.heavy if is_heavy else questions.light
            chosen = rng.choice(len(requested), 1 if is_heavy else min(6, len(requested)))
            waits = await asyncio.gather(*(_request(client, *requested[k], record) for k in chosen))
            await asyncio.sleep(max(*waits, rng.exponential(PAUSE_S)))


async def _request(client: httpx.AsyncClient, kind: str, request: Request, record: Record) -> float:
    """Send a request, record the answer, and return the time to wait."""
    method, path, body = request
    started = time.perf_counter()
    try:
        try:
            answer = await client.request(method, path, json=body)
        except httpx.RemoteProtocolError:  # idle connection closed: send it again
            answer = await client.request(method, path, json=body)
    except httpx.HTTPError as error:
        record.wrong.append(f"{path[:80]}: {error!r}")
        return 1.0
    record.statuses[kind, answer.status_code] += 1
    if answer.status_code == httpx.codes.OK:
        record.seconds.setdefault(kind, []).append(time.perf_counter() - started)
        return 0.0
    if answer.is_server_error:
        record.refusals[answer.json()["detail"]] += 1
    if "retry-after" not in answer.headers:
        record.wrong.append(f"{path[:80]}: {answer.status_code} {answer.text[:150]}")
    return float(answer.headers.get("retry-after", 1))


def request_health(address: str, seconds: float, reported: Any) -> None:
    """Latencies of health, requested twenty times a second on new connections.

    In a session of its own: who watches a server does so from another machine.
    """
    os.setsid()
    times, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        started = time.perf_counter()
        with urllib.request.urlopen(f"{address}/healthz", timeout=60) as answer:
            answer.read()
        times.append(time.perf_counter() - started)
        time.sleep(0.05)
    reported.put(times)


@dataclass
class MemoryUse:
    """Memory of a process and those it started, megabytes."""

    peak: dict[str, float] = field(
        default_factory=lambda: {"resident": 0.0, "shared counted once": 0.0}
    )
    each: dict[int, float] = field(default_factory=dict)
    """The most of each process."""
    last: float = 0.0

    def note(self, pids: Iterable[int]) -> None:
        """Look at what they have now."""
        totals = dict.fromkeys(self.peak, 0.0)
        for pid in pids:
            try:
                text = Path(f"/proc/{pid}/smaps_rollup").read_text().split()
            except OSError:
                continue
            resident = int(text[text.index("Rss:") + 1]) / 1024
            totals["resident"] += resident
            self.each[pid] = max(self.each.get(pid, 0.0), round(resident))
            totals["shared counted once"] += int(text[text.index("Pss:") + 1]) / 1024
        self.last = totals["resident"]
        self.peak = {name: max(most, totals[name]) for name, most in self.peak.items()}


def watch_memory(pid: int, ended: Any, reported: Any) -> None:
    """Look four times a second until the end.

    At the usual priority: who reads the table of a process's memory keeps it from taking more.
    """
    os.setsid()
    use = MemoryUse()
    while not ended.wait(0.25):
        use.note((pid, *children_of(pid)))
    reported.put(use)


def children_of(pid: int) -> list[int]:
    """The processes that a process started, and those that they did."""
    files = Path(f"/proc/{pid}/task").glob("*/children")
    found = [int(child) for file in files for child in file.read_text().split()]
    return [*found, *(later for child in found for later in children_of(child))]


def write_sols(folder: Path, count: int) -> Path:
    """Write a downlink of a number of sols with thumbnails of one stop each, far in the future."""
    traverse = TraverseParams(stops=count, first_sol=400, first_site=60, spacing_m=(2.0, 3.0))
    for file in simulate_downlink(WorldParams("hills", traverse, pairs=3, averaging=4), 7):
        path = folder / file.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.data)
    return folder


def load(clients: int, seconds: float, server: Server, record: Record) -> list[float]:
    """Send requests for a time; the latencies of health."""
    questions = Questions.of(server)
    reported: Any = multiprocessing.Queue()
    health = multiprocessing.Process(
        target=request_health, args=(server.address, seconds, reported)
    )
    health.start()
    lower_priority()

    async def request_all() -> None:
        end = time.monotonic() + seconds
        crowd = (behave(number, server, questions, record, end) for number in range(clients))
        await asyncio.gather(*crowd)

    asyncio.run(request_all())
    times: list[float] = reported.get()
    health.join()
    return times


def main() -> None:
    """Serve a copy of a store, run into it, and print what clients were answered."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=300.0)
    given = parser.parse_args()
    record = Record()
    with tempfile.TemporaryDirectory() as folder, Path(folder, "run.txt").open("w") as message:
        downlink = write_sols(Path(folder, "downlink"), max(2, round(given.seconds / 20)))
        pipeline = write_coarse_pipeline(Path(folder, "coarse.toml"))
        run = [sys.executable, "-m", "solmap.flows.cli", "run", str(downlink)]
        run += ["--store", str(given.store), "--pipeline", str(pipeline)]
        with running([sys.executable, "-c", SERVE, str(given.store)]) as server:
            flow = subprocess.Popen(
                run,
                stdout=message,
                stderr=message,
                start_new_session=True,
                preexec_fn=lower_priority,  # noqa: PLW1509 - no thread runs yet
            )
            ended, reported = multiprocessing.Event(), multiprocessing.Queue()
            watch = multiprocessing.Process(target=watch_memory, args=(server.pid, ended, reported))
            watch.start()
            times = load(given.clients, given.seconds, server, record)
            continued = flow.poll() is None
            flow.terminate()
            flow.wait()
            ended.set()
            memory = reported.get()
            watch.join()
            with urllib.request.urlopen(f"{server.address}/metrics", timeout=60) as answer:
                heavy = [line for line in answer.read().decode().splitlines() if "heavy" in line]
    lines = [f"{kind}: {line}" for kind, line in record.figures().items()]
    p50, p99 = np.percentile(times, [50, 99])
    lines += [
        f"health: {len(times)} answers, p50 {p50:.3f}, p99 {p99:.3f}, most {max(times):.3f} s, "
        f"{np.mean(np.array(times) > MOST_S):.3%} longer than {MOST_S} s",
        f"memory, MB: most {memory.peak}, each {memory.each}, last {memory.last:.0f}",
    ]
    statuses = Counter[int]()
    for (_, status), count in record.statuses.items():
        statuses[status] += count
    lines += [
        f"statuses: {dict(sorted(statuses.items()))}; the run continued to the end: {continued}",
        f"5xx: {dict(record.refusals)}",
        f"wrong: {len(record.wrong)} {record.wrong[:5]}",
        *(line for line in heavy if not line.startswith("#")),
    ]
    print("\n".join(lines))  # noqa: T201


if __name__ == "__main__":
    main()
