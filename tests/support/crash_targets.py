"""What is killed, a downlink's flow and a server, and the client that looks on.

Each is a process of its own, forked from one that has imported everything, so that a kill costs no
seconds of imports.
"""

from __future__ import annotations

import hashlib
import os
import random
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import cv2
import httpx
import numpy as np
import uvicorn

import solmap.flows.downlink  # noqa: F401 - before processes are forked
from solmap.gis_server.app import create_app
from tests.support.tile_at import tile_at


def process(downlink: Path, store: Path, pipeline: Path, log: Path) -> None:
    """Process a downlink; the exit code says whether it succeeded."""
    _write_to(log)
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - nothing to pickle

    report = process_downlink(downlink, store, str(pipeline))
    for line in report.failures:
        print("failed", line, flush=True)  # noqa: T201 - into the log
    os._exit(0 if report.succeeded else 1)


def serve(store: Path, port: int, log: Path) -> None:
    """Serve a store."""
    _write_to(log)
    uvicorn.run(create_app(store), port=port, log_level="error", timeout_graceful_shutdown=1)


def _write_to(log: Path) -> None:
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(file, sys.stdout.fileno())
    os.dup2(file, sys.stderr.fileno())


class Onlooker(threading.Thread):
    """Asks the server for layers, tiles, features and whole products until told to stop."""

    def __init__(self, port: int, every_s: float = 0.5) -> None:
        super().__init__(daemon=True)
        self.address = f"http://127.0.0.1:{port}"
        self.every_s = every_s
        self.answers: Counter[str] = Counter()
        self.faults: list[str] = []
        self._over = threading.Event()

    def run(self) -> None:
        """Ask and look."""
        with httpx.Client(base_url=self.address, timeout=20.0) as client:
            while not self._over.wait(self.every_s):
                try:
                    self._look(client)
                except httpx.TransportError:
                    self.answers["no server"] += 1

    def stop(self) -> None:
        """Ask nothing more."""
        self._over.set()
        self.join(30.0)

    def _look(self, client: httpx.Client) -> None:
        missions = self._asked(client, "/api/missions")
        if missions is None or not missions.json():
            return
        layers = self._asked(client, f"/api/missions/{missions.json()[0]['mission']}/layers")
        if layers is None or not layers.json():
            return
        layer = random.choice(layers.json())  # noqa: S311 - any will do
        self._look_at(client, layer)

    def _look_at(self, client: httpx.Client, layer: dict) -> None:
        whole = self._asked(client, layer["download"])
        told = self._asked(client, layer["provenance"])
        if whole is not None and told is not None:
            if hashlib.sha256(whole.content).hexdigest() != told.json()["sha256"]:
                self.faults.append(f"half of {layer['id']}: {len(whole.content)} bytes")
            self.answers["whole product"] += 1
        if layer["tiles"]:
            west, south, east, north = layer["bounds"]
            at = tile_at((west + east) / 2, (south + north) / 2, layer["maxzoom"])
            url = layer["tiles"].format(z=at.zoom, x=at.column, y=at.row)
            tile = self._asked(client, url)
            if tile is not None and tile.status_code == 200:
                picture = cv2.imdecode(np.frombuffer(tile.content, np.uint8), cv2.IMREAD_UNCHANGED)
                if picture is None:
                    self.faults.append(f"{url} is no picture")
                self.answers["tile"] += 1
        if layer["features"]:
            features = self._asked(client, layer["features"])
            if features is not None:
                features.json()
                self.answers["features"] += 1

    def _asked(self, client: httpx.Client, url: str) -> httpx.Response | None:
        answer = client.get(url)
        self.answers["requests"] += 1
        if answer.status_code >= 500:
            self.faults.append(f"{answer.status_code} of {url}: {answer.text[:200]}")
        if answer.status_code >= 400:
            self.answers[str(answer.status_code)] += 1
            return None
        return answer


def await_server(port: int, limit_s: float = 60.0) -> None:
    """Wait until a server answers."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        try:
            httpx.get(f"http://127.0.0.1:{port}/healthz", timeout=2.0)
        except httpx.TransportError:
            time.sleep(0.05)
        else:
            return
    raise TimeoutError(f"no server at port {port}")
