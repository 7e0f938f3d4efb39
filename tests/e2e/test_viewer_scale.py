"""A mission with many stops in a real browser: what is requested, and how smoothly the map moves.

No test asserts a time, because it depends on other users of the machine. What is printed (`pytest
-s`) is the rate of frames while the map is dragged and zoomed, and the processor time of the page's
main thread a frame, which does not depend on them. SOLMAP_LARGE=folder takes a store of 500 stops,
10,000 images and 150,000 tie points, made there if it is not; otherwise it is a tenth of that.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.support.browsing import Server
from tests.support.large_mission import write_mission

pytestmark = pytest.mark.slow  # fills a store of a long mission

STOPS, IMAGES, TIES = (
    (500, 10_000, 150_000) if os.environ.get("SOLMAP_LARGE") else (50, 1_000, 15_000)
)
READY_MS = 180_000
FRAMES = """() => {
  window.frames_ = [];
  const note = (time) => { window.frames_.push(time); window.on_ && requestAnimationFrame(note); };
  window.on_ = true;
  requestAnimationFrame(note);
}"""
STOP = "() => { window.on_ = false; return window.frames_; }"
MIDDLE_M = 4.5 * STOPS
"""East and north of the stop in the middle: stops are 9 m apart in both."""


@pytest.fixture(scope="module")
def large_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    kept = os.environ.get("SOLMAP_LARGE")
    root = Path(kept) if kept else tmp_path_factory.mktemp("large") / "store"
    if not root.is_dir():
        write_mission(root, STOPS, IMAGES, TIES)
    with Server(root) as server:
        yield server.url


def opened(page, address: str) -> list[str]:
    """Opens the map; the URLs that the page requested."""
    requested: list[str] = []
    page.goto("about:blank")
    page.on("request", lambda request: requested.append(request.url))
    page.goto(address)
    page.wait_for_selector('html[data-ready="true"]', state="attached", timeout=READY_MS)
    return requested


def view(resolution: float, on: str) -> str:
    return f"/#m=MER2&at={MIDDLE_M},{MIDDLE_M},{resolution}&on={on}"


def drag(page, x: float, y: float) -> None:
    page.mouse.down()
    for k in range(50):
        page.mouse.move(x + 140 * math.sin(k / 6), y + 90 * math.sin(k / 4))
        page.wait_for_timeout(16)
    page.mouse.up()


def zoom(page, x: float, y: float) -> None:
    page.mouse.move(x, y)
    for k in range(16):
        page.mouse.wheel(0, -120 if k < 8 else 120)
        page.wait_for_timeout(60)


def zoom_far_out(page, x: float, y: float) -> None:
    page.mouse.move(x, y)
    for k in range(32):
        page.mouse.wheel(0, 240 if k < 16 else -240)
        page.wait_for_timeout(60)


def hover(page, x: float, y: float) -> None:
    for k in range(50):
        page.mouse.move(x - 150 + 6 * k, y - 100 + 4 * k)
        page.wait_for_timeout(16)


def fluency(page, act: Callable[..., None]) -> str:
    """Frames a second while something is done, and processor time a frame."""
    box = page.locator("div.map").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    driver = page.context.new_cdp_session(page)
    driver.send("Performance.enable", {"timeDomain": "threadTicks"})

    def busy() -> float:
        metrics = driver.send("Performance.getMetrics")["metrics"]
        return next(m["value"] for m in metrics if m["name"] == "TaskDuration")

    page.evaluate(FRAMES)
    before = busy()
    act(page, x, y)
    spent = busy() - before
    times = page.evaluate(STOP)
    steps = sorted(b - a for a, b in pairwise(times))
    rate = 1000 * len(steps) / sum(steps)
    return (
        f"{rate:.0f} frames/s, longest 5 % from {steps[int(0.95 * len(steps))]:.0f} ms; "
        f"main thread {1000 * spent / len(steps):.1f} ms/frame"
    )


def report(text: str) -> None:
    sys.stdout.write(f"{text}\n")


def contours(stops: int) -> str:
    names = (f"mer2-site{k // 100:04d}-drive{k % 100:04d}/contours" for k in range(stops))
    return ",".join(names)


def test_a_zoomed_out_view_requests_few_features(page, large_url):
    requested = opened(page, large_url + view(8.0, f"mer2/stops,mer2/traverse,{contours(STOPS)}"))
    features = [address for address in requested if "features.geojson" in address]
    report(f"\n{STOPS} stops: {len(requested)} requests, {len(features)} of them features")
    # Every stop has contours; from afar none of them has a shape.
    assert not [address for address in features if "contours" in address]
    assert len(requested) < 40


def test_contours_load_for_the_current_view(page, large_url):
    requested = opened(page, large_url + f"/#m=MER2&at=90,90,0.1&on={contours(min(STOPS, 60))}")
    near = [address for address in requested if "contours" in address]
    assert 3 <= len(near) <= 20  # a view of 60 m of a traverse with a stop every 13 m


def test_tie_points_load_by_squares(page, large_url):
    requested = opened(page, large_url + view(0.2, "mer2/tie-points"))
    page.wait_for_timeout(1500)
    squares = [address for address in requested if "tie-points" in address]
    assert squares
    assert all("bbox=" in address for address in squares)
    assert len(squares) <= 16


@pytest.mark.parametrize(
    ("name", "resolution", "on"),
    [
        ("everything from afar", STOPS / 64, "traverse,stops,footprints,pointing,tie-points"),
        ("all of it, 0.45 m a pixel", 0.45, "traverse,stops,footprints,pointing,tie-points"),
        ("footprints and lines nearby", 0.2, "stops,footprints,pointing"),
        ("tie points nearby", 0.2, "stops,tie-points"),
    ],
)
def test_frame_times_of_panning_are_measured(page, large_url, name, resolution, on):
    opened(page, large_url + view(resolution, ",".join(f"mer2/{kind}" for kind in on.split(","))))
    page.wait_for_timeout(500)
    report(f"\n{name}, {resolution:.2g} m a pixel")
    for act in (drag, zoom, zoom_far_out, hover):
        report(f"  {act.__name__}: {fluency(page, act)}")
    assert page.locator("html").get_attribute("data-ready") is not None
