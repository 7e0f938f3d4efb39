"""How soon a hundred browsers hear of an event, and whether places of those that left are freed.

    python -m tests.support.event_load STORE

The store gains events that mean nothing; take a copy.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path

import httpx
import numpy as np

from solmap.gis_server.live import MOST_LISTENERS
from solmap.products.catalogue.catalogue import Catalogue
from tests.support.live_server import serving

LISTENERS, EVENTS = 100, 20


async def listen(client: httpx.AsyncClient, address: str, ready: asyncio.Semaphore) -> list[float]:
    """The delays of all events, seconds."""
    delays: list[float] = []
    async with client.stream("GET", address) as response:
        async for line in response.aiter_lines():
            if line.startswith("event: hello"):
                ready.release()
            elif line.startswith("data: ") and '"sent"' in line:
                delays.append(time.time() - json.loads(line.removeprefix("data: "))["sent"])
                if len(delays) == EVENTS:
                    break
    return delays


async def come_and_go(client: httpx.AsyncClient, address: str, times: int) -> int:
    """How many of a number of listeners, one after the other, were refused."""
    refused = 0
    for _ in range(times):
        async with client.stream("GET", address) as response:
            refused += response.status_code != httpx.codes.OK
            await anext(response.aiter_lines())
    return refused


async def measure(address: str, catalogue: Catalogue) -> None:
    """Print what was found."""
    limits = httpx.Limits(max_connections=2 * LISTENERS)
    async with httpx.AsyncClient(timeout=60, limits=limits) as client:
        times = MOST_LISTENERS + 20
        refused = await come_and_go(client, address, times)
        print(f"{times} listeners one after the other: {refused} refused")  # noqa: T201
        ready = asyncio.Semaphore(0)
        tasks = [asyncio.create_task(listen(client, address, ready)) for _ in range(LISTENERS)]
        for _ in range(LISTENERS):
            await ready.acquire()
        for _ in range(EVENTS):
            await asyncio.to_thread(catalogue.append_event, "run.changed", {"sent": time.time()})
            await asyncio.sleep(0.13)
        delays = np.concatenate(await asyncio.gather(*tasks))
    median, most = np.percentile(delays, [50, 95])
    print(f"{len(delays)} deliveries: median {median:.3f} s, 95 % {most:.3f} s")  # noqa: T201


def main() -> None:
    """Serve a store and listen to it."""
    root = Path(sys.argv[1])
    with serving(root) as server:
        asyncio.run(measure(f"{server}/api/events", Catalogue.open(root)))


if __name__ == "__main__":
    main()
