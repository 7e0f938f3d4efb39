"""Metrics of the server and of processing runs, for Prometheus.

Requests are counted by the template of their route, so that the number of series is bounded. Facts
about the store and the runs are read on request. Each process has its own figures; several are
distinguished by the scraper's `instance`.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections import Counter as Tally
from collections.abc import Iterable, Iterator
from datetime import datetime

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    Metric,
)
from prometheus_client.process_collector import ProcessCollector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from solmap.gis_server.budgets import KINDS, MOST_SPOOLED, ROUTE, Budgets
from solmap.gis_server.services import Services
from solmap.products.catalogue.runs import Run, RunState

FAST_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
SLOW_S, FAILED = 1.0, 500
"""Requests that took longer, that failed or that wrote are logged one by one; tiles are not."""
log = logging.getLogger(__name__)
NO_ROUTE = "other"
"""The viewer's files, and unknown URLs."""
_METHODS = {"GET", "HEAD", "POST", "OPTIONS", "PUT", "PATCH", "DELETE"}


class Metrics:
    """The figures of one server."""

    def __init__(self, services: Services, budgets: Budgets) -> None:
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "solmap_http_requests",
            "Requests by route, method and status",
            ("route", "method", "status"),
            registry=self.registry,
        )
        self.seconds = Histogram(
            "solmap_http_request_seconds",
            "Time from a request to the end of its answer; not of event streams",
            ("route",),
            buckets=FAST_S,
            registry=self.registry,
        )
        self.drawn = Histogram(
            "solmap_tile_render_seconds",
            "Time to draw a tile, waiting left out",
            ("form",),
            buckets=FAST_S,
            registry=self.registry,
        )
        ProcessCollector(registry=self.registry)
        self.registry.register(StoreCollector(services))
        self.registry.register(BudgetCollector(budgets))

    @contextlib.contextmanager
    def drawing(self, form: str) -> Iterator[None]:
        """Time a tile that is drawn inside the block."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.drawn.labels(form).observe(time.perf_counter() - started)

    def text(self) -> bytes:
        """All figures in Prometheus' text format."""
        return generate_latest(self.registry)


class MeasureRequests:
    """Counts and times every request."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self.app, self.metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and record its status; without an answer as 500."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        status, started = 500, time.perf_counter()

        async def send_noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self.app(scope, receive, send_noted)
        finally:
            route = route_of(scope)
            method = scope["method"] if scope["method"] in _METHODS else NO_ROUTE
            self.metrics.requests.labels(route, method, str(status)).inc()
            if route != "/api/events":  # a stream lasts as long as the browser shows the map
                seconds = time.perf_counter() - started
                self.metrics.seconds.labels(route).observe(seconds)
                if seconds > SLOW_S or method == "POST" or status >= FAILED:
                    facts = {"route": route, "status": status, "seconds": round(seconds, 3)}
                    log.info("%s %s", method, scope["path"], extra=facts)


def route_of(scope: Scope) -> str:
    """Template of the route of a request."""
    path: str | None = scope.get(ROUTE) or getattr(scope.get("route"), "path", None)
    return path or NO_ROUTE


class StoreCollector:
    """Facts of store, runs and caches, looked up at every scrape."""

    def __init__(self, services: Services) -> None:
        self._services = services

    def collect(self) -> Iterable[Metric]:
        """Every family of figures."""
        yield from self._catalogue()
        yield from self._caches()
        yield from run_metrics(self._services.runs.runs(500))

    def _catalogue(self) -> Iterator[Metric]:
        catalogue = self._services.catalogue
        yield _one("solmap_catalogue_version", "Events so far", catalogue.version())
        yield _one("solmap_catalogue_published", "Last publication", catalogue.published_version())
        things = GaugeMetricFamily(
            "solmap_catalogue_things", "Published, by mission", labels=("mission", "thing")
        )
        for mission in catalogue.missions():
            images = catalogue.images(mission.mission)
            counts = {
                "images": len(images),
                "stops": len({image.stop for image in images}),
                "layers": catalogue.layer_count(mission.mission),
            }
            for thing, count in counts.items():
                things.add_metric((mission.mission, thing), count)
        yield things

    def _caches(self) -> Iterator[Metric]:
        pool, tail = self._services.pool, self._services.tail
        yield _one("solmap_open_rasters", "Rasters that wait to be read again", pool.waiting)
        yield _one("solmap_event_listeners", "Browsers that listen", tail.listeners)
        lookups = CounterMetricFamily(
            "solmap_cache_lookups", "Cache lookups, hits and misses", labels=("cache", "found")
        )
        info = getattr(self._services.layer, "cache_info", None)
        layers = (info().hits, info().misses) if info else (0, 0)
        for cache, (hits, misses) in {"layers": layers, "rasters": pool.lookups}.items():
            lookups.add_metric((cache, "yes"), hits)
            lookups.add_metric((cache, "no"), misses)
        yield lookups


class BudgetCollector:
    """Limits of heavy requests, and their current use."""

    def __init__(self, budgets: Budgets) -> None:
        self._budgets = budgets

    def collect(self) -> Iterable[Metric]:
        """Every family of figures."""
        lanes = self._budgets.lanes.values()
        limits = GaugeMetricFamily(
            "solmap_heavy_limit", "Places of heavy requests", labels=("lane", "whose")
        )
        held = GaugeMetricFamily(
            "solmap_heavy_requests_now", "Heavy requests under way", labels=("lane", "state")
        )
        memory = GaugeMetricFamily(
            "solmap_worker_memory_bytes", "Resident memory of a lane's process", labels=("lane",)
        )
        for state in lanes:
            name, turns = state.lane.name, state.turn.statistics()
            limits.add_metric((name, "client"), state.lane.per_client)
            limits.add_metric((name, "all"), state.lane.places)
            counts = {"waiting": turns.tasks_waiting, "working": turns.borrowed_tokens}
            counts["sending"] = max(0, state.places.total() - sum(counts.values()))
            for what, count in counts.items():
                held.add_metric((name, what), count)
            if state.worker is not None:
                memory.add_metric((name,), state.worker.memory_bytes)
        spooled = GaugeMetricFamily(
            "solmap_heavy_spooled_bytes", "Files of answers that are being sent", labels=("what",)
        )
        spooled.add_metric(("now",), self._budgets.spooled.total())
        spooled.add_metric(("limit",), MOST_SPOOLED)
        yield from (limits, held, memory, spooled)
        answered = CounterMetricFamily(
            "solmap_heavy_answered", "Heavy requests answered", labels=("kind",)
        )
        for kind, _, _ in KINDS:
            answered.add_metric((kind,), self._budgets.answered[kind])
        refused = CounterMetricFamily(
            "solmap_heavy_refused", "Heavy requests that were refused", labels=("kind", "status")
        )
        for (kind, status), count in sorted(self._budgets.refused.items()):
            refused.add_metric((kind, str(int(status))), count)
        yield from (answered, refused)


def run_metrics(runs: list[Run]) -> Iterator[Metric]:
    """States of the recorded runs, and the outcome of the last one of every kind."""
    states = GaugeMetricFamily("solmap_runs", "Runs on record", labels=("kind", "state"))
    counts = Tally((run.kind, run.state) for run in runs)
    for kind in sorted({run.kind for run in runs}):
        for state in RunState:
            states.add_metric((kind, str(state)), counts[kind, state])
    yield states
    ended = GaugeMetricFamily(
        "solmap_run_last_ended_timestamp_seconds", "End of the last run", labels=("kind", "state")
    )
    took = GaugeMetricFamily(
        "solmap_run_last_duration_seconds", "Of the last run", labels=("kind", "state")
    )
    last: dict[tuple[str, str], Run] = {}
    for run in runs:  # the newest first
        if run.ended_at is not None:
            last.setdefault((run.kind, str(run.state)), run)
    for labels, run in sorted(last.items()):
        started, end = (_moment(run.started_at), _moment(run.ended_at or run.changed_at))
        ended.add_metric(labels, end)
        took.add_metric(labels, end - started)
    yield from (ended, took)


def _one(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, value=value)


def _moment(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()
