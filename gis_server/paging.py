"""Pages of lists: `limit` and `offset` in the query, the next page and the total in the head.

The body of a page is the list itself. As in OGC API, `Link` (RFC 8288) names the pages before and
after, relative to the requested address, and `OGC-NumberMatched` gives their number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlencode

from fastapi import Depends, Query, Request

PAGE = 500
"""Default number of entries of a page."""
MOST = 1000
"""Entries of a page at most: the server writes them in 50 ms."""
TOTAL = "OGC-NumberMatched"


@dataclass(frozen=True, slots=True)
class Page:
    """The requested part of a list."""

    limit: int
    offset: int
    query: tuple[tuple[str, str], ...] = ()
    """Further parameters of the query."""

    def head(self, total: int) -> dict[str, str]:
        """URLs of the neighbouring pages, and the total number of entries."""
        offsets = {"prev": self.offset - self.limit, "next": self.offset + self.limit}
        if self.offset:
            offsets["prev"] = max(0, offsets["prev"])
        links = [
            f'<?{urlencode([*self.query, ("limit", self.limit), ("offset", offset)])}>; rel="{rel}"'
            for rel, offset in offsets.items()
            if 0 <= offset < total
        ]
        return {TOTAL: str(total), **({"Link": ", ".join(links)} if links else {})}


async def _page(
    request: Request,
    limit: Annotated[int, Query(ge=1, le=MOST, description="entries of a page")] = PAGE,
    offset: Annotated[int, Query(ge=0, le=2**31, description="entries before the page")] = 0,
) -> Page:
    others = request.query_params.multi_items()
    return Page(limit, offset, tuple(one for one in others if one[0] not in {"limit", "offset"}))


PageOf = Annotated[Page, Depends(_page)]
"""The page of a request."""
