"""The guided tour: offered once, led by the keyboard, reached from Help."""

from __future__ import annotations

from tests.support.browsing import at, look, ready, until

PERSON = "Object.defineProperty(Navigator.prototype, 'webdriver', { get: () => false })"
STEPS = 7


def title(page) -> str:
    return page.locator(".driver-popover-title").inner_text()


def test_help_leads_through_the_page_by_keyboard_and_back_to_help(page, url):
    page.emulate_media(reduced_motion="reduce")
    look(page, url + at(0.1, "mer2/stops,mer2/traverse"))
    assert page.locator(".tour-offer").count() == 0
    page.get_by_role("button", name="Help").click()
    page.get_by_role("button", name="Take the tour").click()
    page.wait_for_selector(".driver-popover")
    reported = [title(page)]

    popover = page.locator(".driver-popover")

    def has_moved() -> bool:
        return popover.count() == 0 or title(page) != reported[-1]

    def has_ended() -> bool:
        """Press once a step, and again only where nothing follows: a moving tour takes no key."""
        page.keyboard.press("ArrowRight")
        for _ in range(20):
            if has_moved():
                break
            page.wait_for_timeout(100)
        if popover.count() == 0:
            return True
        if title(page) != reported[-1]:
            reported.append(title(page))
        return False

    until(page, has_ended)
    assert len(reported) == len(set(reported)) == STEPS
    assert page.locator(".help").evaluate("element => element === document.activeElement")


def test_escape_ends_the_tour(page, url):
    look(page, url + at(0.1, "mer2/stops"))
    page.keyboard.press("?")
    page.get_by_role("button", name="Take the tour").click()
    page.wait_for_selector(".driver-popover")
    page.keyboard.press("Escape")
    page.wait_for_selector(".driver-popover", state="detached")


def test_the_tour_is_offered_to_a_person_once(new_page, url):
    page = new_page
    page.add_init_script(PERSON)
    look(page, url + at(0.1, "mer2/stops"))
    page.locator(".tour-offer").get_by_role("button", name="No, thanks").click()
    assert page.locator(".tour-offer").count() == 0
    page.reload()
    ready(page)
    assert page.locator(".help").is_visible()
    assert page.locator(".tour-offer").count() == 0
