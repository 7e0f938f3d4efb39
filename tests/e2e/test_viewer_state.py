"""A copied link restores every pane, filter and choice; undo takes back the last of them."""

from __future__ import annotations

from itertools import pairwise
from urllib.parse import unquote

import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.support.browsing import Server, at, keep_screenshot, look, open_page, ready, until
from tests.support.scene_store import fill_scene

SIZE = (1920, 1080)
SETTLED = {"image": ".image-view[data-scale]", "stereo": '.stereo[data-settled="true"]'}
WHOLE_S = 60_000


def fragment(page) -> str:
    return unquote(page.evaluate("location.hash"))


def settled(page) -> None:
    """Every pane has loaded what it shows, and the address is that of the state."""
    ready(page)
    for name, selector in SETTLED.items():
        if page.locator(f'section[data-pane="{name}"]').count():
            page.wait_for_selector(selector, timeout=WHOLE_S)
    if page.locator('section[data-pane="panorama"]').count():
        page.wait_for_selector('.panorama[data-settled="true"]', timeout=WHOLE_S)
    page.wait_for_timeout(500)
    ready(page)


def copied(page) -> str:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.locator("div.map").focus()
    page.keyboard.press("u")
    until(page, lambda: page.evaluate("navigator.clipboard.readText()").startswith("http"))
    return page.evaluate("navigator.clipboard.readText()")


def seen(page) -> dict[str, object]:
    """What a person sees of the state."""
    panes = page.locator("section.pane")
    return {
        "panes": panes.evaluate_all(
            "all => all.map((one) => [one.parentElement.className, one.dataset.pane])"
        ),
        "image": page.locator(".image-view").get_attribute("data-image"),
        "scale": page.locator(".image-view").get_attribute("data-scale"),
        "pair": page.locator('select[name="pair"]').input_value(),
        "way": page.locator('select[name="way"]').input_value(),
        "parallax": page.locator('input[name="nudge"]').input_value(),
        "panorama": page.locator('select[name="panorama"]').input_value(),
        "profile": page.locator('[aria-label="what the profile shows"]').input_value(),
        "table": page.get_by_label("table", exact=True).input_value(),
        "found": page.get_by_placeholder("filter rows").input_value(),
        "sorted": page.locator(".table-view [aria-sort]:not([aria-sort=none])").all_inner_texts(),
        "words": page.get_by_placeholder("filter layers").input_value(),
        "kind": page.get_by_label("kind of layers").input_value(),
        "instrument": page.get_by_label("instrument of layers").input_value(),
        "tab": page.locator('[role=tab][aria-selected="true"]').get_attribute("data-tab"),
        "stop": page.locator('#panel-images [aria-label="stop"]').input_value(),
        "against": page.locator("select.reference").evaluate("one => one.selectedIndex"),
        "layers": page.locator(".layers li.layer:visible").evaluate_all(
            "all => all.map((one) => one.dataset.layer)"
        ),
    }


def change_everything(page) -> None:
    page.get_by_placeholder("filter layers").fill("mer2")
    page.get_by_label("instrument of layers").focus()
    until(page, lambda: page.get_by_label("instrument of layers").locator("option").count() > 1)
    page.get_by_label("instrument of layers").select_option(index=1)
    page.get_by_label("kind of layers").select_option("Stops")
    page.locator('[data-tab="stops"]').click()
    page.locator("select.reference").wait_for()
    page.locator("select.reference").select_option(index=2)
    page.locator('[data-tab="images"]').click()
    page.locator('#panel-images [aria-label="stop"]').select_option(index=1)
    page.locator(".images button").first.click()
    settled(page)
    picture = page.locator(".image-view canvas.image-canvas")
    for key in ("+", "+", "ArrowRight", "ArrowDown"):
        picture.press(key)
    page.locator("div.map").focus()
    page.keyboard.press("2")
    settled(page)
    page.locator('select[name="way"]').select_option("parallel")
    for key in ("+", "ArrowLeft", "ArrowLeft"):
        page.locator(".stereo-view canvas").press(key)
    page.locator("div.map").focus()
    page.keyboard.press("p")
    settled(page)
    for key in ("+", "ArrowRight"):
        page.locator(".panorama-view").press(key)
    settled(page)
    page.locator("div.map").focus()
    page.keyboard.press("M")
    page.locator('[data-mode="profile"]').click()
    frame = page.locator("div.map").bounding_box()
    x, y = frame["x"] + frame["width"] / 2, frame["y"] + frame["height"] / 2
    page.mouse.click(x - 20, y)
    page.wait_for_timeout(350)
    page.mouse.click(x + 20, y + 10)
    page.keyboard.press("Enter")
    page.locator('[aria-label="what the profile shows"]').select_option("slope")
    page.locator("div.map").focus()
    page.keyboard.press("Escape")
    page.keyboard.press("a")
    page.get_by_label("table", exact=True).select_option("images")
    page.get_by_placeholder("filter rows").fill("left")
    page.locator(".table-head button").first.click()
    settled(page)


@pytest.mark.slow  # a world is rendered first
def test_a_copied_link_restores_all_that_is_shown(browser, images_url):
    with open_page(browser, *SIZE) as page:
        more = "&sol=155-156&sun=sol:155,14.5&live=relief*0.6,slope:20"
        look(page, images_url + at(0.05, "mer2/stops*0.5") + more)
        change_everything(page)
        expected = seen(page)
        assert len(expected["panes"]) == 5
        assert len({side for side, _ in expected["panes"]}) == 2
        link = copied(page)
        keep_screenshot(page, "state-made")
        with open_page(browser, *SIZE) as other:
            look(other, link)
            until(other, lambda: other.locator("section.pane").count() == 5)
            settled(other)
            keep_screenshot(other, "state-restored")
            assert fragment(other) == unquote(link[link.index("#") :])
            assert seen(other) == expected
            assert other.locator(".banner").is_hidden()


@pytest.mark.slow
def test_undo_takes_back_what_was_done_last_and_redo_does_it_again(browser, images_url):
    with open_page(browser, *SIZE) as page:
        look(page, images_url + at(0.05, "mer2/stops"))
        settled(page)
        links = [fragment(page)]
        for key, pane in (("2", "stereo"), ("p", "panorama"), ("a", "table")):
            page.locator("div.map").focus()
            page.keyboard.press(key)
            page.wait_for_selector(f'section[data-pane="{pane}"]')
            settled(page)
            links.append(fragment(page))
        page.locator(".stereo-view canvas").press("ArrowLeft")
        settled(page)
        links.append(fragment(page))
        assert len(set(links)) == len(links)
        for key, expected in (
            *(("Control+z", link) for link in reversed(links[:-1])),
            *(("Control+y", link) for link in links[1:]),
        ):
            page.locator("div.map").focus()
            page.keyboard.press(key)
            until(page, lambda link=expected: fragment(page) == link)
            settled(page)
            open_ = page.locator("section.pane").evaluate_all(
                "all => all.map((one) => one.dataset.pane)"
            )
            assert sorted(open_) == sorted(
                name for name in ("stereo", "panorama", "table") if f"&{name}=" in expected
            )


@pytest.mark.slow
def test_panes_are_moved_below_the_map_and_beside_it(browser, images_url):
    with open_page(browser, *SIZE) as page:
        look(page, images_url + at(0.05, "mer2/stops") + "&panorama=&stereo=")
        until(page, lambda: page.locator("section.pane").count() == 2)
        settled(page)
        panorama = page.locator('section[data-pane="panorama"]')
        assert panorama.locator("xpath=..").get_attribute("class") == "panes below"
        panorama.get_by_role("button", name="move beside the map").click()
        assert panorama.locator("xpath=..").get_attribute("class") == "panes beside"
        boxes = [page.locator(one).bounding_box() for one in ("div.map", ".stereo", ".panorama")]
        assert all(one["x"] + one["width"] <= other["x"] for one, other in pairwise(boxes))
        until(page, lambda: "panes=stereo,panorama" in fragment(page))
        keep_screenshot(page, "state-beside")
        link = page.url
        look(page, link)
        until(page, lambda: page.locator(".panes.beside section.pane").count() == 2)
        settled(page)
        assert fragment(page) == unquote(link[link.index("#") :])


@pytest.mark.slow
def test_one_cursor_is_in_all_panes(browser, images_url):
    """The pointer on the map, then in the stereo pair: the others follow."""
    with open_page(browser, *SIZE) as page:
        pair = next(
            one["id"]
            for one in page.request.get(f"{images_url}/api/missions/MER2/images").json()
            if one["partner"] and one["eye"] == "left"
        )
        look(page, f"{images_url}{at(0.05)}&image={pair}&stereo={pair}&panorama=")
        until(page, lambda: page.locator("section.pane").count() == 3)
        settled(page)
        canvas = page.locator(".stereo-view canvas")
        frame = canvas.bounding_box()
        page.mouse.move(frame["x"] + 0.5 * frame["width"], frame["y"] + 0.6 * frame["height"])
        page.mouse.move(frame["x"] + 0.5 * frame["width"], frame["y"] + 0.62 * frame["height"])
        stereo, image = page.locator(".stereo"), page.locator(".image-view")
        panorama = page.locator(".panorama")
        until(page, lambda: stereo.get_attribute("data-ground"))
        until(page, lambda: image.get_attribute("data-cross"))
        until(page, lambda: panorama.get_attribute("data-marked"))
        east, north = (float(one) for one in stereo.get_attribute("data-ground").split(","))
        keep_screenshot(page, "state-cursor-stereo")
        box = page.locator("div.map").bounding_box()
        middle = [float(one) for one in fragment(page).split("at=")[1].split("&")[0].split(",")]
        x = box["x"] + box["width"] / 2 + (east - middle[0]) / middle[2]
        y = box["y"] + box["height"] / 2 - (north - middle[1]) / middle[2]
        page.mouse.move(x + 2, y)
        page.mouse.move(x, y)
        until(page, lambda: (stereo.get_attribute("data-crosses") or "").count(",") == 2)
        keep_screenshot(page, "state-cursor-map")
        left, right = (
            [float(one) for one in cross.split(",")]
            for cross in stereo.get_attribute("data-crosses").split(";")
        )
        assert abs(left[1] - right[1]) < 0.5  # rows of an epipolar pair
        assert left[0] > right[0]


@pytest.mark.slow
def test_a_3d_view_opens_with_the_link_alone(browser, tmp_path):
    root = tmp_path / "store"
    fill_scene(Workspace.open(root))
    with Server(root) as server, open_page(browser) as page:
        look(page, server.url + at(0.1, "mer2/orthophoto") + "&view3d=")
        page.wait_for_selector('.scene[data-settled="true"]', timeout=WHOLE_S)
        until(page, lambda: "view3d=&" not in fragment(page) + "&")
        assert page.locator(".banner").is_hidden()
