"""Figures of the server, its store and its runs, for Prometheus."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST

router = APIRouter(tags=["server"])


@router.get("/metrics", response_class=Response)
def metrics(request: Request) -> Response:
    """Requests, times, caches, what is published, and how the runs went."""
    body = request.app.state.metrics.text()
    return Response(body, media_type=CONTENT_TYPE_LATEST, headers={"Cache-Control": "no-store"})
