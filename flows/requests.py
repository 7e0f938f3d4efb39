"""Requests for runs that people made on the map, handed to the scheduler."""

from __future__ import annotations

import contextlib
from pathlib import Path

from prefect.exceptions import ObjectNotFound

from solmap.config.workspace import open_catalogue
from solmap.flows.deployments import DOWNLINK, OVERALL, REGION
from solmap.flows.submitted import submit
from solmap.products.catalogue.events import REQUESTS_CHANGED
from solmap.products.run_requests import RequestBook, RequestKind, RequestState, RunRequest

_DEPLOYMENT = {
    RequestKind.OVERALL: OVERALL,
    RequestKind.REGION: REGION,
}


def submit_requests(store: Path, *, has_inbox: bool) -> list[str]:
    """Submit what waits; a line for each request that was taken or refused.

    A scheduler that has just begun does not know its deployments yet: requests go on waiting.

    Raises:
        HTTPError: Prefect's server does not answer; the request goes on waiting.
    """
    book, lines = RequestBook.of(store), []
    for asked in book.waiting():
        with contextlib.suppress(ObjectNotFound):
            state, answer = _submitted(asked, has_inbox=has_inbox)
            book.answer(asked.id, state, answer)
            document = {"request": asked.id, "state": str(state), "answer": answer}
            open_catalogue(store).tell(REQUESTS_CHANGED, document)
            lines.append(f"{asked.author} asked for {asked.kind}: {state}, {answer}")
    return lines


def _submitted(asked: RunRequest, *, has_inbox: bool) -> tuple[RequestState, str]:
    if asked.kind is RequestKind.DOWNLINK:
        if not has_inbox:
            return RequestState.REFUSED, "no inbox is watched; start `solmap up --inbox`"
        return RequestState.TAKEN, submit(DOWNLINK, {})
    parameters = {"mission": asked.mission} if asked.mission else {}
    return RequestState.TAKEN, submit(_DEPLOYMENT[asked.kind], parameters)
