"""The screenshots of the viewer in the documentation, made from the demo.

python -m tests.support.screenshots docs/figures STORE [SPIRIT_STORE]

STORE is what `make demo` makes (`.demo/store`), SPIRIT_STORE that of the tutorial of Spirit.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from tests.support.browsing import Server, open_browser

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SIZE = {"width": 1280, "height": 760}
QUALITY = [cv2.IMWRITE_WEBP_QUALITY, 70]


def open_page(browser: Browser, address: str) -> Page:
    """The map at an address, drawn completely."""
    page = browser.new_page(viewport=SIZE)
    page.goto(address)
    page.wait_for_selector("html[data-ready=true]")
    page.wait_for_load_state("networkidle")
    return page


def keep(page: Page, file: Path, rows: int = SIZE["height"]) -> None:
    """Write the upper rows of the page as a WebP image."""
    page.wait_for_load_state("networkidle")
    page.wait_for_timeout(3_000)  # tiles fade in
    pixels = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    cv2.imwrite(str(file), pixels[:rows], QUALITY)


def demo(browser: Browser, url: str, folder: Path) -> None:
    """Map with values at a place, profile, traverse, and the terrain in three dimensions."""
    at, near = "m=MER2&at=4,8,0.11", "m=MER2&at=4,8,0.06"
    keep(open_page(browser, f"{url}/#{at}&pt=6,9"), folder / "viewer-map.webp")
    page = open_page(browser, f"{url}/#{near}&tab=measure&measure=profile:-8,-5;14,22")
    page.get_by_role("button", name="profile", exact=True).last.click()
    keep(page, folder / "viewer-profile.webp")
    page = open_page(browser, f"{url}/#{near}")
    page.get_by_role("tab", name="Traverse").click()
    keep(page, folder / "viewer-traverse.webp")
    page = open_page(browser, f"{url}/#{near}&view3d=-14,-12,7,9,13,0")
    page.get_by_role("button", name="full screen").click()
    page.wait_for_timeout(10_000)  # tiles are refined while nothing is requested
    keep(page, folder / "viewer-3d.webp", rows=555)


def spirit(browser: Browser, url: str, folder: Path) -> None:
    """Stops, footprints and a panorama of archived frames."""
    page = open_page(browser, url)
    page.keyboard.press("p")
    page.get_by_text("images meet to").wait_for()
    keep(page, folder / "viewer-spirit.webp")


if __name__ == "__main__":
    for _store, _draw in zip(sys.argv[2:], (demo, spirit), strict=False):
        with Server(Path(_store)) as _server, open_browser() as _browser:
            _draw(_browser, _server.url, Path(sys.argv[1]))
