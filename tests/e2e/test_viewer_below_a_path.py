"""The viewer behind a reverse proxy that serves it below a path of its host."""

from __future__ import annotations

from tests.support.browsing import Server, look, open_page, until


def test_all_requests_and_links_of_the_page_are_below_the_path(browser, workspace):
    with Server(workspace.store.root, "/solmap") as server, open_page(browser, is_new=True) as page:
        requested = []
        page.on("request", lambda request: requested.append(request.url))
        look(page, f"{server.url}/")
        for part in ("/tiles/", "/api/events", "/images", "/api/start"):
            until(page, lambda part=part: any(part in url for url in requested))
        linked = page.evaluate(
            "() => [...document.querySelectorAll('a[href], img[src]')].map((e) => e.href ?? e.src)"
        )
        assert linked
        inside = (f"{server.url}/", "data:", f"blob:{server.url.removesuffix('/solmap')}")
        assert [url for url in [*requested, *linked] if not url.startswith(inside)] == []
