"""Links between the documents of OGC API, and the address that they start from."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request

from solmap.gis_server.routes.parameters import MissionName

Link = dict[str, str]
JSON, GEOJSON, HTML = "application/json", "application/geo+json", "text/html"


def link(rel: str, href: str, media_type: str, title: str = "") -> Link:
    """A link as OGC API has it."""
    named = {"title": title} if title else {}
    return {"rel": rel, "href": href, "type": media_type, **named}


def base_of(request: Request, mission: str) -> str:
    """The landing page of a mission, as the client wrote its host."""
    return f"{str(request.base_url).rstrip('/')}/ogc/{mission}"


def _base(request: Request, mission: MissionName) -> str:
    return base_of(request, mission)


BaseOf = Annotated[str, Depends(_base)]
"""The address of the mission's landing page, without a slash at its end."""
