"""Limits of heavy requests: number in progress, number waiting, and longest wait.

Heavy requests are recognised by their addresses (`KINDS`). Those of a lane are processed one after
the other, each lane by a worker process (`workers`) if there is one; light requests never wait for
them. A client with too many of them in progress gets 429, and so does one served recently while
others wait long; when all slots are taken, requests get 503. Both give the time of a retry
(`Retry-After`). A slot is held until the response is sent, so that slow readers use up their own
slots; the lane is free as soon as the response is computed.
"""

from __future__ import annotations

import ipaddress
import math
import re
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import anyio
from anyio import CapacityLimiter, WouldBlock
from cachetools import TTLCache
from starlette.types import ASGIApp, Receive, Scope, Send

from solmap.gis_server.errors import problem
from solmap.gis_server.workers import (
    LARGEST,
    Answer,
    AnswerStorageError,
    Worker,
    WorkerLostError,
    collect,
)

ROUTE = "solmap.route"
"""Key in the scope of a request that another process answered: the template of its route."""
_METHODS = {"GET", "POST"}
WAIT_S, WORK_S = 90.0, 120.0
"""Longest time that a request waits for its turn, and longest time of work."""
SHARE_S = 120.0
"""Time for which a busy lane refuses a client after its last answer."""
_LONGEST_RETRY_S = 60
_START_S = 30.0
"""Longest time that the server waits for its workers before it answers the first request."""
MOST_SPOOLED = 2 * LARGEST
"""Most bytes of answer files that are being sent to all clients; half of it for one client. Two
workers may each be writing another answer, so temporary files take at most twice as much."""
_CLIENTS = 10_000
"""Most clients whose recent answers are recorded."""
_LATEST = 10
"""Number of requests for estimating their usual time."""


@dataclass(frozen=True, slots=True)
class Lane:
    """Heavy requests that are answered one after the other."""

    name: str
    per_client: int
    """Slots that one client may have."""
    places: int
    """Slots of requests that wait, are being computed, or are being sent."""
    busy_s: float
    """The lane is busy when waiting requests are expected to take longer."""


QUESTIONS = Lane("questions", per_client=8, places=64, busy_s=15.0)
"""Requests of a person on the map."""
FILES = Lane("files", per_client=4, places=64, busy_s=15.0)
"""Files for downloads."""
IMAGES = Lane("images", per_client=64, places=512, busy_s=WAIT_S)
"""Many small ones at a time, drawn in the server's own process from its caches."""
LANES = (QUESTIONS, FILES, IMAGES)
KINDS: tuple[tuple[str, str, Lane], ...] = (
    ("solid", r"^/models/.*\.stl$", FILES),
    ("part", r"^/download/.*/clip$", FILES),
    ("features", r"^/download/.*\.gpkg$|^/ogc/.*/items$", FILES),
    ("report", r"^/api/.*/sols/[^/]+/report$", FILES),
    ("contours", r"^/api/.*/contours\.geojson$", QUESTIONS),
    ("measure", r"^/api/.*/(profile(\.csv)?|measure-\w+|volume|plane-fit|zonal)$", QUESTIONS),
    ("view", r"^/api/.*/(viewshed(\.png|\.tif)?|line-of-sight)$", QUESTIONS),
    ("drive", r"^/api/.*/(reach(\.png|\.tif)?|route)$", QUESTIONS),
    ("projection", r"^/api/.*/(ground-to-image|image-to-\w+|direction|place)$", QUESTIONS),
    ("adjustment", r"^/api/.*/(refine|preview-adjustment)$", QUESTIONS),
    ("network", r"^/api/.*/(solutions|traverse|network|pairs|images/[^/]+/ties)$", QUESTIONS),
    ("scene", r"^/api/.*/(scene/\w+|tileset\.json)$", QUESTIONS),
    ("image", r"^/(images|panoramas)/.*\.png$|^/api/.*/legend\.png$", IMAGES),
    ("map", r"^/ogc/.*(/map/tiles/[^/]+/[^/]+/|/wmts$|/WMTSCapabilities\.xml$)", IMAGES),
)
"""Kind, pattern of its URLs, and its lane. A tile of WMTS by its path
(`/ogc/{mission}/wmts/1.0.0/.../{column}.png`) is light: it costs as much as one of `/tiles`."""
_PATTERNS = [(re.compile(pattern), kind, lane) for kind, pattern, lane in KINDS]


def kind_of(path: str) -> tuple[str, Lane] | None:
    """Kind and lane of the requests to an address, or to a template; None: they are light."""
    found = ((kind, lane) for pattern, kind, lane in _PATTERNS if pattern.search(path))
    return next(found, None)


def client_of(scope: Scope) -> str:
    """The client, by address: a network of 64 bits for IPv6."""
    host = (scope.get("client") or ("", 0))[0]
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return str(host)
    if isinstance(address, ipaddress.IPv6Address):
        of_four = address.ipv4_mapped  # a server that listens on both kinds gets these
        return str(of_four or ipaddress.ip_network((host, 64), strict=False))
    return host


class RefusedError(Exception):
    """A refused request: message with the reason, status by whether the client caused it."""

    def __init__(self, status: HTTPStatus, what: str, retry_s: int = 0) -> None:
        super().__init__(what)
        self.status, self.retry_s = status, retry_s


@dataclass(slots=True, eq=False)
class LaneState:
    """Requests in progress in a lane."""

    lane: Lane
    worker: Worker | None
    turn: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(1))
    places: Counter[str] = field(default_factory=Counter)
    """Slots in use, by client."""
    _usual_s: float = 1.0
    """Mean time that the latest requests took."""
    _answered: TTLCache[str, bool] = field(default_factory=lambda: TTLCache(_CLIENTS, SHARE_S))
    """Clients that were answered lately."""

    @property
    def ahead_s(self) -> float:
        """Expected time of the waiting requests."""
        return self.turn.statistics().tasks_waiting * self._usual_s

    @property
    def retry_s(self) -> int:
        """Time of a retry."""
        return max(1, min(_LONGEST_RETRY_S, math.ceil(self.ahead_s)))

    @contextmanager
    def place_of(self, client: str) -> Iterator[None]:
        """A slot for a request of a client.

        Raises:
            RefusedError: the client has used its share, or all slots are taken.
        """
        lane = self.lane
        if self.places[client] >= lane.per_client:
            what = f"{lane.per_client} {lane.name} of yours are in progress, which is the limit"
            raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, what)
        if client in self._answered and self.ahead_s > lane.busy_s:
            what = f"other clients wait for their {lane.name}, and you were served recently"
            raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, what)
        if self.places.total() >= lane.places:
            what = f"{lane.places} {lane.name} are in progress, which is the limit"
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, what)
        self.places[client] += 1
        try:
            yield
        finally:
            self.places -= Counter((client,))
            self._answered[client] = True

    @asynccontextmanager
    async def turn_of(self, receive: Receive) -> AsyncIterator[bool]:
        """Wait for the turn of a request; False if its client disconnects before.

        Raises:
            RefusedError: the turn does not come in time.
        """
        request = object()
        try:
            self.turn.acquire_on_behalf_of_nowait(request)
        except WouldBlock:
            has_left = await self._wait(request, receive)
        else:
            has_left = False
        if request not in self.turn.statistics().borrowers:
            if has_left:
                yield False
                return
            what = f"{self.lane.name} that came before took more than {WAIT_S:.0f} s"
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, what)
        started = time.monotonic()
        try:
            yield True
        finally:
            self.turn.release_on_behalf_of(request)
            self._usual_s += (time.monotonic() - started - self._usual_s) / _LATEST

    async def _wait(self, request: object, receive: Receive) -> bool:
        """Wait for the turn up to the limit; returns whether the client disconnected."""
        has_left = False
        async with anyio.create_task_group() as waiting:

            async def leave() -> None:
                nonlocal has_left
                while (await receive())["type"] != "http.disconnect":
                    pass
                has_left = True
                waiting.cancel_scope.cancel()

            waiting.start_soon(leave)
            with anyio.move_on_after(WAIT_S):
                await self.turn.acquire_on_behalf_of(request)
            waiting.cancel_scope.cancel()
        return has_left

    async def answer(self, app: ASGIApp, scope: Scope, body: bytes) -> Answer:
        """The answer of the lane's worker, or of this process.

        Raises:
            RefusedError: the worker gave up, or the answer is too large.
        """
        if self.worker is None:
            return await collect(app, scope, body, None)
        try:
            return await self.worker.answer(scope, body, WORK_S)
        except TimeoutError:
            what = f"this took longer than {WORK_S:.0f} s; request less at once"
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, what) from None
        except AnswerStorageError as error:
            raise RefusedError(error.status, error.what) from None
        except WorkerLostError:
            what = "the process that worked on this has ended; request less at once, or try again"
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, what) from None


class Budgets:
    """The limits of one server, and their current use."""

    def __init__(self, workers: Mapping[Lane, Worker]) -> None:
        """Lanes without a worker are answered in this process."""
        self.lanes = {lane: LaneState(lane, workers.get(lane)) for lane in LANES}
        self.answered: Counter[str] = Counter()
        """Answered requests by kind."""
        self.refused: Counter[tuple[str, int]] = Counter()
        """Refused requests by kind and status."""
        self.spooled: Counter[str] = Counter()
        """Bytes of the files of answers that are being sent, by client."""

    @contextmanager
    def file_of(self, client: str, answer: Answer) -> Iterator[None]:
        """Reserve space for the file of an answer, if it has one, while it is sent.

        Raises:
            RefusedError: there is no space; the file is removed.
        """
        size = answer.file_bytes
        has_share = self.spooled[client] + size <= MOST_SPOOLED // 2
        if not has_share or self.spooled.total() + size > MOST_SPOOLED:
            answer.remove()
            status = HTTPStatus.SERVICE_UNAVAILABLE if has_share else HTTPStatus.TOO_MANY_REQUESTS
            what = "large answers are being sent" if has_share else "yours are still being sent"
            raise RefusedError(status, f"{what}, up to the limit of bytes", _LONGEST_RETRY_S)
        self.spooled[client] += size
        try:
            yield
        finally:
            self.spooled -= Counter({client: size})

    @contextmanager
    def running_workers(self) -> Iterator[None]:
        """Run the workers during the block."""
        workers = [state.worker for state in self.lanes.values() if state.worker is not None]
        with TemporaryDirectory(prefix="solmap-answers-") as folder:
            try:
                for worker in workers:
                    worker.start(Path(mkdtemp(dir=folder)))
                for worker in workers:
                    worker.wait(_START_S)
                yield
            finally:
                for worker in workers:
                    worker.stop()
                    worker.launcher.close()


class HeavyRequests:
    """Answers heavy requests in their turn, and light ones at once."""

    def __init__(self, app: ASGIApp, budgets: Budgets) -> None:
        self.app, self.budgets = app, budgets

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a light request on; apply the limits to a heavy one."""
        found = None
        if scope["type"] == "http" and scope["method"] in _METHODS:
            found = kind_of(scope["path"].removeprefix(scope.get("root_path", "")))
        if found is None:
            await self.app(scope, receive, send)
            return
        kind, lane = found
        state = self.budgets.lanes[lane]
        try:
            await self._answer(state, scope, receive, send)
            self.budgets.answered[kind] += 1
        except RefusedError as error:
            self.budgets.refused[kind, error.status] += 1
            again = {"Retry-After": str(max(state.retry_s, error.retry_s))}
            if error.status == HTTPStatus.UNPROCESSABLE_ENTITY:
                again = {}  # the same request would always be refused
            await problem(error.status, str(error), scope["path"], again)(scope, receive, send)

    async def _answer(self, state: LaneState, scope: Scope, receive: Receive, send: Send) -> None:
        body = await _whole_body(receive) if scope["method"] == "POST" else b""
        if body is None:
            return
        client = client_of(scope)
        with state.place_of(client):
            async with state.turn_of(receive) as is_on:
                answer = await state.answer(self.app, scope, body) if is_on else None
            if answer is not None:
                scope[ROUTE] = answer.route
                with self.budgets.file_of(client, answer):
                    await answer.send(send)


async def _whole_body(receive: Receive) -> bytes | None:
    """The body of a request, read before it waits; None if the client disconnects."""
    body = bytearray()
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        body += message.get("body", b"")
        if not message.get("more_body", False):
            return bytes(body)
