"""The viewer in a real browser, on the real server: what tests of it share."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import cv2
import numpy as np
import pytest
import uvicorn

from solmap.gis_server.app import create_app

ROOT = Path(__file__).resolve().parents[2]
DIST = Path(os.environ.get("SOLMAP_VIEWER", ROOT / "gis_server" / "viewer" / "dist"))
"""The built viewer; SOLMAP_VIEWER names another build of it."""
CHROMIUM = (
    "chromium-headless-shell",  # takes a third less processor than Chromium without a window
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"),
)
FIREFOX = ("firefox-esr", "firefox")
OLDEST_FIREFOX = 153
"""The first ESR with the commands by which Playwright records a page's answers; 140 has not."""
WITHOUT = (
    *("WebUIOmniboxPopup", "WebUIOmniboxFullPopup", "WebUIOmniboxAimPopup"),
    *("AimEnabled", "PreconnectToSearch", "OptimizationHints", "NetworkTimeServiceQuerying"),
    *("MediaRouter", "LensOverlay", "HttpsUpgrades", "HttpsFirstBalancedModeAutoEnable"),
    *("PaintHolding", "DestroyProfileOnBrowserClose", "AvoidUnnecessaryBeforeUnloadCheckSync"),
)
"""Features of Chromium that are off: two pages of its search box, which take 0.8 s of processor in
every browser context, and what Playwright names in the argument that this one replaces."""
ARGUMENTS = (
    "--no-sandbox",
    f"--disable-features={','.join(WITHOUT)}",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--renderer-process-limit=1",  # a page is open a fifth sooner than with a process of its own
    "--in-process-gpu",
)
WAIT_MS = 60_000
_FREE: WeakKeyDictionary[Any, dict[tuple, list[Any]]] = WeakKeyDictionary()
"""Of a browser: pages that no test uses, by width, height and pixels per CSS pixel."""
OPEN = """(address) => {
  const { dataset } = document.documentElement;
  for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
  for (const button of document.querySelectorAll("header > button[aria-expanded]"))
    if ((button.ariaExpanded === "true") !== matchMedia("(min-width: 1100px)").matches)
      button.click();
  delete dataset.theme;
  delete dataset.opened;
  document.querySelector(".toast").replaceChildren();
  document.activeElement.blur();
  new MutationObserver((_, observer) => {  // the mission's heading is new, and so is its session
    observer.disconnect();
    delete history.replaceState;
    delete history.pushState;
    Object.assign(dataset, { ready: "false", opened: "" });
  }).observe(document.querySelector(".mission"), { childList: true });
  history.replaceState({ view: 0 }, "", "#m=another");
  dispatchEvent(new PopStateEvent("popstate"));
  history.replaceState({ view: 0 }, "", address);  // read when the server has answered
  history.replaceState = history.pushState = () => undefined;  // the old session writes late
}"""
"""Open a link as after a choice of mission, by which the viewer disposes of all that it shows."""

DRAWN = """async (width) => {
  const frame = () => new Promise(requestAnimationFrame);
  while (innerWidth !== width) await frame();
  for (let frames = 0; frames < 3; frames += 1) await frame();
}"""
"""Wait for three frames of a page of a width: observers of sizes act in the first."""


class Server:
    """The real server on a free port, in a thread."""

    def __init__(self, store: Path, path: str = "", listener: socket.socket | None = None) -> None:
        """A server of a store, below a path as behind a reverse proxy, or where others listened."""
        self.socket = listener.dup() if listener else socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.socket.getsockname()[1]}{path}"
        self.uvicorn = uvicorn.Server(
            uvicorn.Config(
                create_app(store, DIST, public_url=self.url if path else None),
                log_level="warning",
                access_log=False,
                timeout_graceful_shutdown=1,  # pages that listen for events never hang up
            )
        )
        self.thread = threading.Thread(
            target=self.uvicorn.run, kwargs={"sockets": [self.socket]}, daemon=True
        )

    def __enter__(self) -> Server:
        self.thread.start()
        deadline = time.monotonic() + 120.0
        while not self.uvicorn.started and time.monotonic() < deadline:
            time.sleep(0.02)
        return self

    def __exit__(self, *_: object) -> None:
        self.uvicorn.should_exit = True
        self.thread.join(10.0)
        self.socket.close()


@contextmanager
def open_browser() -> Iterator:
    """A headless Chromium of its own."""
    with open_driver() as driver, launch_chromium(driver) as opened:
        yield opened


@contextmanager
def open_driver() -> Iterator:
    """Playwright, once per process; the test is skipped where it or the built viewer is missing."""
    playwright = pytest.importorskip("playwright.sync_api")
    if not (DIST / "index.html").is_file():
        pytest.skip("the viewer is not built: run `make viewer`")
    with playwright.sync_playwright() as driver:
        yield driver


@contextmanager
def launch_chromium(driver) -> Iterator:
    """A headless Chromium; the test is skipped where there is none."""
    opened = driver.chromium.launch(executable_path=_installed(CHROMIUM), args=list(ARGUMENTS))
    yield opened
    opened.close()


@contextmanager
def launch_firefox(driver) -> Iterator:
    """A headless Firefox as the machine has it; without one, or an old one, the test is skipped."""
    start, path = Path(__file__).with_name("firefox.py"), _installed(FIREFOX)
    version = subprocess.run([path, "--version"], capture_output=True, text=True, check=True).stdout
    if int(re.search(r"\d+", version)[0]) < OLDEST_FIREFOX:
        pytest.skip(
            f"Playwright needs Firefox {OLDEST_FIREFOX} or newer; here is {version.strip()}"
        )
    with tempfile.TemporaryDirectory() as folder:
        command = Path(folder) / "firefox"
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{start}" "{path}" "$@"\n')
        command.chmod(0o755)
        opened = driver.firefox.launch(channel="moz-firefox", executable_path=command)
        yield opened
        opened.close()


def _installed(names: tuple[str, ...]) -> str:
    """Path of a browser."""
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip(f"no browser on this machine: none of {', '.join(names)} is installed")
    return path


@contextmanager
def open_page(
    browser, width: int = 1280, height: int = 800, scale: float = 1.0, *, is_new: bool = False
) -> Iterator:
    """A page that must raise no error, get none from the server, and contact no other host.

    An earlier test may have used it, and nothing is stored or permitted there: what `look` opens in
    its viewer takes half as long as loading the viewer. A new page is closed at the end.
    """
    free = _FREE.setdefault(browser, {}).setdefault((width, height, scale), [])
    opened = free.pop() if free and not is_new else _new_page(browser, scale)
    opened.set_viewport_size({"width": width, "height": height})
    opened.faults.clear()
    opened.elsewhere.clear()
    yield opened
    assert opened.faults == []
    assert opened.elsewhere == []
    context = opened.context
    if is_new:
        context.close()
        return
    context.set_offline(offline=False)
    context.clear_permissions()
    opened.unroute_all()
    opened.emulate_media(color_scheme="null", reduced_motion="null")
    opened.mouse.move(0, 0)
    if opened.url.startswith("http"):
        opened.evaluate("localStorage.clear(); sessionStorage.clear()")
    for page in context.pages:
        if page is not opened:
            page.close()
    free.append(opened)


def _new_page(browser, scale: float):
    """A page in a browser context of its own, which keeps what goes wrong."""
    opened = browser.new_context(device_scale_factor=scale).new_page()
    opened.faults = []
    opened.on("pageerror", lambda error: opened.faults.append(str(error)))
    opened.on(
        "response",
        lambda answer: (
            opened.faults.append(f"{answer.status} {answer.url}") if answer.status == 500 else None
        ),
    )
    opened.elsewhere = []
    opened.on(
        "request",
        lambda request: (
            None
            if request.url.startswith(("http://127.0.0.1", "data:", "blob:"))
            else opened.elsewhere.append(request.url)
        ),
    )
    return opened


def look(page, address: str) -> None:
    """Open a link in the viewer, which is loaded where the page does not show it yet."""
    if page.url.partition("#")[0].rstrip("/") == address.partition("#")[0].rstrip("/"):
        page.evaluate(OPEN, address)
        page.wait_for_selector("html[data-opened]", state="attached", timeout=WAIT_MS)
    else:
        page.goto(address)
    ready(page)


def load(page, address: str) -> None:
    """Load the viewer: it follows a link that differs only in its fragment without that."""
    page.goto("about:blank")
    page.goto(address)
    ready(page)


def resize(page, width: int, height: int) -> None:
    """Give the page another size, and wait until its parts have followed and are drawn."""
    page.set_viewport_size({"width": width, "height": height})
    page.evaluate(DRAWN, width)


def ready(page) -> None:
    page.wait_for_selector('html[data-ready="true"]', state="attached", timeout=WAIT_MS)


def until(page, holds) -> None:
    """Wait until `holds()`; the page's security policy forbids to wait inside the page."""
    deadline = time.monotonic() + WAIT_MS / 1000
    while not holds():
        assert time.monotonic() < deadline, "the page did not get there"
        page.wait_for_timeout(50)


def turn_of_arrow(page) -> str:
    return page.locator(".arrow").evaluate("element => element.style.transform")


def at(resolution: float, on: str = "", east: float = 0.0, north: float = 0.0) -> str:
    return f"/#m=MER2&at={east},{north},{resolution}&on={on}"


def resolution_of(page) -> float:
    return float(page.url.split("at=")[1].split("&")[0].split(",")[2])


def pixel_of(page, east, north, resolution: float) -> tuple:
    """Where on the page a place is, or many in arrays, the map centred on the landing point."""
    box = page.locator("div.map").bounding_box()
    x = box["x"] + box["width"] / 2 + east / resolution
    return x, box["y"] + box["height"] / 2 - north / resolution


def screenshot(page, name: str, clip: dict[str, float] | None = None) -> np.ndarray:
    """Red, green, blue of the page or of a part; kept in the folder of SOLMAP_SCREENSHOTS."""
    body = page.screenshot(caret="initial", clip=clip)
    if folder := os.environ.get("SOLMAP_SCREENSHOTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / f"{name}.png").write_bytes(body)
    return cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def keep_screenshot(page, name: str) -> None:
    """Draw the page for people, only where SOLMAP_SCREENSHOTS names a folder."""
    if os.environ.get("SOLMAP_SCREENSHOTS"):
        screenshot(page, name)


def colour_at(image: np.ndarray, place: tuple[float, float]) -> np.ndarray:
    x, y = (round(value) for value in place)
    return image[y, x].astype(int)


def colour_now(page, place: tuple[float, float]) -> np.ndarray:
    """Red, green, blue of one place of the page, at a quarter of the cost of the whole."""
    x, y = (round(value) for value in place)
    return screenshot(page, "pixel", {"x": x, "y": y, "width": 1, "height": 1})[0, 0].astype(int)


def field(page, key: str) -> str:
    return page.locator(f'[data-field="{key}"] b').inner_text().replace("\u2212", "-")
