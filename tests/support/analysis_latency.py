"""What the server's analysis endpoints take, on a store of `rendered_husband`.

    python -m tests.support.analysis_latency STORE [QUESTION]

Each question is sent six times to the application itself, without a network: the first answer
reads and unpacks what it needs, of the others the median counts. Processor time of the process, and
wall time. With the name of a question only that one is sent, 41 times: the first answer, then p50
and p95 of the others by the clock. Opening may change `STORE`: use a copy.
"""

import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app

API, IMAGE = "/api/missions/MER2", "2N151760231EFF1000P1500L0M1"
SQUARE = [[8, 10], [18, 10], [18, 20], [8, 20]]
LINE = [[-5, -5], [27, 34]]
SLOPE = "mer2-region-site0010-drive0000/region-slope"
TIES = [
    {
        "first": {"image": "2N151760814EFF1064P1501L0M1", "sample": 400, "line": 500},
        "second": {"image": "2N151761556EFF1100P1502L0M1", "sample": 500, "line": 500},
        "sigma_px": 50,
    }
]
Request = Callable[[], httpx.Response]


def questions(client: TestClient) -> Iterator[tuple[str, Request]]:
    """Name and call of every question."""

    def post(what: str, **body: object) -> Request:
        return lambda: client.post(f"{API}/{what}", json=body)

    def get(address: str, **query: object) -> Request:
        return lambda: client.get(address, params=query)  # type: ignore[arg-type]

    pixel = {"image": IMAGE, "sample": 300, "line": 300}
    near = {"image": "2N151760284EFF1000P1500L0M1", "sample": 100, "line": 300}
    yield "profile, 50 m", post("profile", line=LINE)
    yield "measure-line, 50 m", post("measure-line", line=LINE)
    yield "measure-area, 100 m2", post("measure-area", polygon=SQUARE)
    yield "volume, 100 m2", post("volume", polygon=SQUARE)
    yield "plane-fit, 100 m2", post("plane-fit", polygon=SQUARE)
    yield "zonal, 100 m2", post("zonal", polygon=SQUARE, layer=SLOPE)
    yield "viewshed, 50 m", get(f"{API}/viewshed", east=14, north=17, radius_m=50)
    yield "viewshed.png, 50 m", get(f"{API}/viewshed.png", east=14, north=17, radius_m=50)
    yield (
        "line-of-sight, 20 m",
        get(f"{API}/line-of-sight", east=5, north=5, to_east=18, to_north=20),
    )
    yield "identify", get(f"{API}/identify", east=14, north=16)
    yield "ground-to-image", get(f"{API}/ground-to-image", east=14, north=16)
    yield "image-to-ground", get(f"{API}/image-to-ground", **pixel)
    yield "image-to-image", get(f"{API}/image-to-image", **pixel)
    yield "refine", post("refine", first=pixel, second=near)
    yield "preview-adjustment", post("preview-adjustment", ties=TIES)
    for style in ("raw", "stretched", "linearised", "anaglyph"):
        yield f"{style}, whole", get(f"/images/{IMAGE}/{style}.png")
        yield f"{style}, tile", get(f"/images/{IMAGE}/{style}/2/1/2.png")


def timed(request: Request) -> tuple[httpx.Response, float, float, float]:
    """(answer, first wall, median CPU, median wall), milliseconds."""
    walls, used = [], []
    for _ in range(6):
        wall, cpu = time.perf_counter(), time.process_time()
        answer = request()
        walls.append(1e3 * (time.perf_counter() - wall))
        used.append(1e3 * (time.process_time() - cpu))
    return answer, walls[0], statistics.median(used[1:]), statistics.median(walls[1:])


def report_spread(name: str, request: Request) -> None:
    """Print how long 41 answers to one question took by the clock."""
    walls = []
    for _ in range(41):
        begin = time.perf_counter()
        assert request().status_code == httpx.codes.OK
        walls.append(1e3 * (time.perf_counter() - begin))
    first, *others = walls
    twentieths = statistics.quantiles(others, n=20)
    message = (
        f"{name}: first {first:.0f} ms, p50 {twentieths[9]:.0f} ms, p95 {twentieths[18]:.0f} ms"
    )
    print(message)  # noqa: T201


def main() -> None:
    """Print a row for every question."""
    with TestClient(create_app(Path(sys.argv[1]))) as client:
        if sys.argv[2:]:
            report_spread(sys.argv[2], dict(questions(client))[sys.argv[2]])
            return
        print("| question | answer kB | CPU ms | wall ms | first ms |")  # noqa: T201
        for name, request in questions(client):
            answer, first, cpu, wall = timed(request)
            size = len(answer.content) / 1000
            message = "" if answer.status_code == httpx.codes.OK else f" ({answer.text[:200]})"
            row = f"| {name}{message} | {size:.1f} | {cpu:.0f} | {wall:.0f} | {first:.0f} |"
            print(row)  # noqa: T201


if __name__ == "__main__":
    main()
