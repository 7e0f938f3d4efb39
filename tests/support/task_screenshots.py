"""Screenshots of the main tasks: `python -m tests.support.task_screenshots STORE FOLDER`.

Every task is a link, and what a reader does next. Each is shown at the widths of phones to wall
screens, light and dark, as `FOLDER/TASK-WIDTH-THEME.png`. `--tasks 3d --widths 1440` takes
fewer.
"""

from __future__ import annotations

import argparse
import json
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.support.browsing import look, open_browser, ready
from tests.support.live_server import serving

HEIGHTS = {390: 844, 768: 1024, 1024: 768, 1440: 900, 1920: 1080, 2560: 1440}
"""Widths that pages are looked at, and the heights that go with them, pixels."""
THEMES = ("light", "dark")
SETTLED_MS = 60_000


@dataclass(frozen=True)
class Store:
    """What links name in a store."""

    mission: str
    layers: list[str]
    images: list[str]
    stops: list[str]

    def layer(self, kind: str) -> str:
        """The layer of a kind, of merged maps before those of stops."""
        kinds = (f"/region-{kind}", f"/{kind}")
        return next(each for end in kinds for each in self.layers if each.endswith(end))

    @classmethod
    def at(cls, address: str) -> Store:
        """The first mission of a server."""

        def get(path: str):
            with urllib.request.urlopen(address + path) as answer:
                return json.load(answer)

        start = get("/api/start")
        mission = start["missions"][0]["mission"]
        images = get(f"/api/missions/{mission}/images")
        layers = [layer["id"] for layer in start["layers"]]
        stops = list(dict.fromkeys(image["stop"] for image in images))
        return cls(mission, layers, [image["id"] for image in images], stops)


@dataclass(frozen=True)
class Task:
    """A link's fragment in a store, and what is done on the page that it opens."""

    link: Callable[[Store], str]
    act: Callable = lambda _: None


def _profile(page) -> None:
    page.get_by_role("button", name="vertical profile").click()
    page.wait_for_selector(".below .chart-line", timeout=SETTLED_MS)


def _table(page) -> None:
    page.locator("div.map").focus()
    page.keyboard.press("a")
    page.wait_for_selector(".below [role=row]", timeout=SETTLED_MS)


def _settled(page) -> None:
    page.wait_for_selector('.scene[data-settled="true"]', timeout=SETTLED_MS)


def _panorama(page) -> None:
    page.wait_for_selector(".panorama canvas, .panorama img", timeout=SETTLED_MS)


TASKS: dict[str, Task] = {
    "first": Task(lambda _: ""),
    "identify": Task(lambda _: "pt=-2,6"),
    "images": Task(lambda store: f"tab=images&image={store.images[0]}"),
    "traverse": Task(lambda _: "tab=stops", _profile),
    "measure": Task(lambda _: "tab=measure&measure=slope:-6,-4;6,8/area:0,-12;8,-12;8,-6"),
    "uncertainty": Task(
        lambda store: f"on={store.layer('dtm')}~sigma,{store.mission.lower()}/stops"
    ),
    "compare": Task(
        lambda store: f"tab=compare&compare=swipe,{store.layer('slope')},{store.layer('dtm')},0.5"
    ),
    "sun": Task(lambda _: "tab=sun&sun=sol:155,16&live=relief,shadow,slope:15"),
    "panorama": Task(lambda store: f"panorama={store.stops[0]}", _panorama),
    "3d": Task(lambda _: "view3d=4,-24,16,6,4,0", _settled),
    "table": Task(lambda _: "", _table),
    "network": Task(lambda _: "tab=network"),
    "download": Task(lambda _: "tab=downloads"),
    "notes": Task(lambda _: "tab=notes"),
    "runs": Task(lambda _: "tab=runs"),
}


def show(page, task: Task, link: str, width: int, themes: list[str]) -> Iterator[tuple[str, bytes]]:
    """PNGs of a task by theme, on a page of a width."""
    page.set_viewport_size({"width": width, "height": HEIGHTS[width]})
    look(page, link)
    task.act(page)
    ready(page)
    page.mouse.move(width / 2, 5)
    for theme in themes:
        page.emulate_media(color_scheme=theme)
        page.wait_for_timeout(300)  # what fades has faded
        yield theme, page.screenshot()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--widths", type=int, nargs="+", choices=HEIGHTS, default=list(HEIGHTS))
    parser.add_argument("--themes", nargs="+", choices=THEMES, default=list(THEMES))
    requested = parser.parse_args()
    requested.folder.mkdir(parents=True, exist_ok=True)
    with serving(requested.store) as address, open_browser() as browser:
        store, page = Store.at(address), browser.new_page()
        for name in requested.tasks:
            task = TASKS[name]
            link = f"{address}/#m={store.mission}&{task.link(store)}"
            for width in requested.widths:
                for theme, body in show(page, task, link, width, requested.themes):
                    (requested.folder / f"{name}-{width}-{theme}.png").write_bytes(body)


if __name__ == "__main__":
    main()
