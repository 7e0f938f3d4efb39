"""What is killed, a downlink's flow, maintenance and a server, and the client that looks on.

Each is a process of its own, forked from one that has imported everything, so that a kill costs no
seconds of imports.
"""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import sqlite3
import sys
import threading
import time
from collections import Counter
from contextlib import closing
from datetime import timedelta
from enum import StrEnum
from pathlib import Path

import cv2
import httpx
import numpy as np
import uvicorn

import solmap.flows.downlink  # noqa: F401 - before processes are forked
from solmap.gis_server.app import create_app
from solmap.products.catalogue import schema
from solmap.products.catalogue.maintenance.backups import back_up
from solmap.products.catalogue.maintenance.checking import check
from solmap.products.catalogue.maintenance.pruning import PruningParams, prune
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreBusyError
from tests.support.tile_at import tile_at


def process(downlink: Path, store: Path, pipeline: Path, log: Path) -> None:
    """Process a downlink; the exit code states whether it succeeded."""
    _write_to(log)
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - nothing to pickle

    report = process_downlink(downlink, store, str(pipeline))
    for line in report.failures:
        print("failed", line, flush=True)  # noqa: T201 - into the log
    os._exit(0 if report.succeeded else 1)


class Maintenance(StrEnum):
    """What is done to a store beside runs."""

    PRUNE = "prune"
    BACKUP = "backup"
    REPAIR = "check --repair"
    MIGRATION = "migration"


def maintain(what: Maintenance, store: Path, backups: Path, log: Path) -> None:
    """Maintain a store; the exit code states whether it succeeded, or was refused as expected."""
    _write_to(log)
    try:
        workspace = Workspace.open(store)
        if what is Maintenance.PRUNE:
            prune(workspace, PruningParams(versions=1, youngest=timedelta(0)))
        elif what is Maintenance.BACKUP:
            report = back_up(workspace, backups, keep=2)
            if report.broken:
                print("broken", report.broken, flush=True)  # noqa: T201 - into the log
                os._exit(3)
        elif what is Maintenance.REPAIR:
            found = [finding.text for finding in check(workspace, repair=True)]
            print(*found, sep="\n", flush=True)  # noqa: T201
            if not all(text.endswith(LEFT_BY_KILLS) for text in found):
                os._exit(4)
    except StoreBusyError as error:
        print(error, flush=True)  # noqa: T201
    os._exit(0)


LEFT_BY_KILLS = ("exists without its product", "was left by a process")
"""What `check --repair` may find of a process that was killed."""


def downgrade(store: Path) -> None:
    """Have a store look as those did that knew no version."""
    (store / schema.FILE).unlink(missing_ok=True)
    for folder in store.glob(f"{schema.SAFETY_COPIES}*"):
        shutil.rmtree(folder)
    with closing(sqlite3.connect(store / schema.CATALOGUE, timeout=30.0)) as database, database:
        database.execute(f"DROP TABLE IF EXISTS {schema.STEPS.name}")


def serve(store: Path, port: int, log: Path) -> None:
    """Serve a store."""
    _write_to(log)
    uvicorn.run(create_app(store), port=port, log_level="error", timeout_graceful_shutdown=1)


def _write_to(log: Path) -> None:
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(file, sys.stdout.fileno())
    os.dup2(file, sys.stderr.fileno())


class Onlooker(threading.Thread):
    """Requests layers, tiles, features and whole products from the server until stopped."""

    def __init__(self, port: int, every_s: float = 0.5) -> None:
        super().__init__(daemon=True)
        self.address = f"http://127.0.0.1:{port}"
        self.every_s = every_s
        self.answers: Counter[str] = Counter()
        self.faults: list[str] = []
        self._over = threading.Event()

    def run(self) -> None:
        """Send requests and check the answers."""
        with httpx.Client(base_url=self.address, timeout=20.0) as client:
            while not self._over.wait(self.every_s):
                try:
                    self._look(client)
                except httpx.TransportError:
                    self.answers["no server"] += 1

    def stop(self) -> None:
        """Send no more requests."""
        self._over.set()
        self.join(30.0)

    def _look(self, client: httpx.Client) -> None:
        missions = self._requested(client, "/api/missions")
        if missions is None or not missions.json():
            return
        layers = self._requested(client, f"/api/missions/{missions.json()[0]['mission']}/layers")
        if layers is None or not layers.json():
            return
        layer = random.choice(layers.json())  # noqa: S311 - any will do
        self._look_at(client, layer)

    def _look_at(self, client: httpx.Client, layer: dict) -> None:
        whole = self._requested(client, layer["download"])
        reported = self._requested(client, layer["provenance"])
        if whole is not None and reported is not None:
            if hashlib.sha256(whole.content).hexdigest() != reported.json()["sha256"]:
                self.faults.append(f"half of {layer['id']}: {len(whole.content)} bytes")
            self.answers["whole product"] += 1
        if layer["tiles"]:
            west, south, east, north = layer["bounds"]
            at = tile_at((west + east) / 2, (south + north) / 2, layer["maxzoom"])
            url = layer["tiles"].format(z=at.zoom, x=at.column, y=at.row)
            tile = self._requested(client, url)
            if tile is not None and tile.status_code == 200:
                image = cv2.imdecode(np.frombuffer(tile.content, np.uint8), cv2.IMREAD_UNCHANGED)
                if image is None:
                    self.faults.append(f"{url} is not an image")
                self.answers["tile"] += 1
        if layer["features"]:
            features = self._requested(client, layer["features"])
            if features is not None:
                features.json()
                self.answers["features"] += 1

    def _requested(self, client: httpx.Client, url: str) -> httpx.Response | None:
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
