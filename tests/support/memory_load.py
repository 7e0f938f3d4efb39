"""The server's memory while it answers requests: `python -m tests.support.memory_load STORE`.

Four clients send the requests of `heavy_load`, a bounded number of requests, 5 % of them heavy,
with tiles of every layer at every zoom and in several styles. Beside the number of answers stands
what the server, its launcher and its workers hold, memory that they share counted once
(proportional set size), and how long the first answer took. `--plot FILE` draws it.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from solmap.gis_server.rendering.tiles import overlap
from solmap.products.formats.raster.tiling import TileAddress
from tests.support.heavy_load import API, SERVE, MemoryUse, Questions, children_of
from tests.support.live_server import Server, running
from tests.support.tile_at import tile_at

HEAVY_SHARE, CLIENTS, EVERY = 0.05, 4, 500
STYLES = ("", "?style=hillshade", "?style=slope&baseline=0.5", "?style=contours", "?colours=grey")


def tile_paths(layers: list[dict[str, Any]], rng: np.random.Generator) -> Iterator[str]:
    """Tiles of random layers, places, zooms and styles, for ever."""
    drawn = [layer for layer in layers if layer["tiles"]]
    while True:
        layer = drawn[rng.integers(len(drawn))]
        west, south, east, north = layer["bounds"]
        zoom = int(rng.integers(layer["minzoom"], layer["maxzoom"] + 1))
        tile: TileAddress = tile_at(rng.uniform(west, east), rng.uniform(south, north), zoom)
        assert overlap(tile.bounds, layer["bounds"])
        form = rng.choice(["tiles", "values"]) if layer["values"] else "tiles"
        path = layer[form].format(z=zoom, x=tile.column, y=tile.row)
        is_terrain = layer["kind"].endswith("dtm") and form == "tiles"
        yield path + (str(rng.choice(STYLES)) if is_terrain else "")


async def request_all(
    server: Server, requests: int
) -> tuple[list[tuple[int, float]], Counter[int]]:
    """Megabytes after so many answers, and how many answers had which status."""
    rng, questions = np.random.default_rng(5), Questions.of(server)
    async with httpx.AsyncClient(base_url=server.address, timeout=150, trust_env=False) as client:
        tiles = tile_paths((await client.get(f"{API}/layers")).json(), rng)
        statuses, held, left = Counter[int](), list[tuple[int, float]](), requests

        async def behave() -> None:
            nonlocal left
            while left > 0:
                left -= 1
                share = rng.random()
                if share < HEAVY_SHARE:
                    _, (method, path, body) = questions.heavy[rng.integers(len(questions.heavy))]
                elif share < 0.3:
                    _, (method, path, body) = questions.light[rng.integers(len(questions.light))]
                else:
                    method, path, body = "GET", next(tiles), None
                answer = await client.request(method, path, json=body)
                statuses[answer.status_code] += 1
                done = statuses.total()
                if done % EVERY == 0:
                    each = memory_of(server.pid)
                    held.append((done, sum(each)))
                    parts = ", ".join(f"{one:.0f}" for one in each)
                    sys.stdout.write(f"{done} answers: {sum(each):.0f} MB ({parts})\n")
                    sys.stdout.flush()

        held.append((0, sum(memory_of(server.pid))))
        await asyncio.gather(*(behave() for _ in range(CLIENTS)))
    return held, statuses


def memory_of(pid: int) -> list[float]:
    """Megabytes of a process and of those it started, shared memory counted once."""
    found = []
    for one in (pid, *children_of(pid)):
        use = MemoryUse()
        use.note([one])
        found.append(use.peak["shared counted once"])
    return found


def _plot(held: list[tuple[int, float]], file: Path) -> None:
    import matplotlib.pyplot as plt  # noqa: PLC0415 - only where a figure is wanted

    figure, axes = plt.subplots(figsize=(6, 3))
    axes.plot(*zip(*held, strict=True))
    axes.set(xlabel="requests answered", ylabel="MB, shared memory once", ylim=(0, None))
    figure.savefig(file, bbox_inches="tight")


def main() -> None:
    """Send requests to a server of a copied store and print its memory."""
    given = argparse.ArgumentParser()
    given.add_argument("store", type=Path)
    given.add_argument("--requests", type=int, default=10_000)
    given.add_argument("--plot", type=Path)
    requested = given.parse_args()
    with (
        httpx.Client() as client,
        running([sys.executable, "-c", SERVE, str(requested.store)]) as server,
    ):
        started = time.perf_counter()
        client.get(f"{server.address}/api/start").raise_for_status()
        sys.stdout.write(f"first request: {1000 * (time.perf_counter() - started):.0f} ms\n")
        held, statuses = asyncio.run(request_all(server, requested.requests))
    sys.stdout.write(
        f"statuses {dict(statuses)}; {held[0][1]:.0f} MB before, {held[-1][1]:.0f} after\n"
    )
    if requested.plot:
        _plot(held, requested.plot)


if __name__ == "__main__":
    main()
