"""How long the first view of the map takes: `python -m tests.support.first_view STORE`.

In headless Chromium, from the start of the navigation, with an empty cache of the browser and a
server that has answered once, to the mark "map painted": every tile and every feature that the view
shows has been drawn. Beside it stand the time to the page with all its parts, the processor time of
the page's main thread (`threadTicks`) and of the server, requests and bytes. Where others use the
machine, `chrt -r 1` before the command lets them wait.
"""

from __future__ import annotations

import statistics
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from tests.support.browsing import ready
from tests.support.live_server import serving

WATCH = """
  const observer = new MutationObserver(() => {
    if (document.documentElement.dataset.ready === "true") {
      performance.mark("page ready");
      observer.disconnect();
    }
  });
  addEventListener("DOMContentLoaded",
    () => observer.observe(document.documentElement, { attributes: true }));
"""
READ = """() => ({
  marks: Object.fromEntries(performance.getEntriesByType("mark").map((m) => [m.name, m.startTime])),
  requests: performance.getEntriesByType("resource").map((r) =>
    ({ path: r.name.replace(location.origin, ""), start: r.startTime, bytes: r.transferSize })),
})"""


@dataclass(frozen=True)
class FirstView:
    """One opening of the page."""

    painted_ms: float
    """The map is drawn with all that it shows."""
    ready_ms: float
    """All parts of the page have what they show at first."""
    main_thread_ms: float
    """Processor time of the page, to `ready_ms`."""
    requested: list[dict]
    """Requests: path, start, bytes."""

    @property
    def first_requested(self) -> list[str]:
        """Requests sent before the map was drawn."""
        return [one["path"] for one in self.requested if one["start"] < self.painted_ms]


def first_view(browser, address: str) -> FirstView:
    """Open an address with an empty cache."""
    with _fresh_page(browser) as page:
        page.add_init_script(WATCH)
        driver = page.context.new_cdp_session(page)
        driver.send("Performance.enable", {"timeDomain": "threadTicks"})
        page.goto(address, wait_until="commit")
        ready(page)
        metrics = driver.send("Performance.getMetrics")["metrics"]
        busy = next(m["value"] for m in metrics if m["name"] == "TaskDuration")
        found = page.evaluate(READ)
    marks = found["marks"]
    return FirstView(marks["map painted"], marks["page ready"], 1000 * busy, found["requests"])


@contextmanager
def _fresh_page(browser):
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    yield context.new_page()
    context.close()


def _report(store: Path, times: int) -> None:
    from tests.support.browsing import open_browser  # noqa: PLC0415 - skips where there is none

    with serving(store) as address, open_browser() as browser:
        first_view(browser, address)  # the server is warm from here on
        server = next(p for p in psutil.Process().children() if str(store) in p.cmdline())
        before = server.cpu_times()
        views = [first_view(browser, address) for _ in range(times)]
        after = server.cpu_times()
    spent = after.user + after.system - before.user - before.system
    for name in ("painted_ms", "ready_ms", "main_thread_ms"):
        values = sorted(getattr(view, name) for view in views)
        sys.stdout.write(
            f"{name}: median {statistics.median(values):.0f}, {values[0]:.0f} to {values[-1]:.0f}\n"
        )
    last = views[-1]
    sys.stdout.write(
        f"server: {1000 * spent / times:.0f} ms of processor a view\n"
        f"requests: {len(last.first_requested)} before the map is drawn, "
        f"{len(last.requested)} in all; "
        f"{sum(one['bytes'] for one in last.requested) / 1e3:.0f} kB\n"
    )


if __name__ == "__main__":
    _report(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 9)
