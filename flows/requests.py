"""Requests for runs that people made on the map, handed to the scheduler."""

from __future__ import annotations

from pathlib import Path

from httpx import HTTPError
from prefect.exceptions import ObjectNotFound

from flows.deployments import DOWNLINK, OVERALL, REGION
from flows.submitted import submit
from products.catalogue import Catalogue
from products.events import REQUESTS_CHANGED
from products.run_requests import RequestBook, RequestKind, RequestState, RunRequest

_DEPLOYMENT = {
    RequestKind.DOWNLINK: DOWNLINK,
    RequestKind.OVERALL: OVERALL,
    RequestKind.REGION: REGION,
}


def submit_requests(store: Path, *, has_inbox: bool) -> list[str]:
    """Submit what waits; a line for each request.

    Raises:
        HTTPError: Prefect's server does not answer; the request goes on waiting.
    """
    book = RequestBook.of(store)
    return [_submit(one, book, store, has_inbox=has_inbox) for one in book.waiting()]


def _submit(asked: RunRequest, book: RequestBook, store: Path, *, has_inbox: bool) -> str:
    if asked.kind is RequestKind.DOWNLINK and not has_inbox:
        state, answer = RequestState.REFUSED, "no inbox is watched; start `solmap up --inbox`"
    else:
        try:
            named = asked.kind is not RequestKind.DOWNLINK and asked.mission
            parameters = {"mission": asked.mission} if named else {}
            state, answer = RequestState.TAKEN, submit(_DEPLOYMENT[asked.kind], parameters)
        except HTTPError:
            raise
        except (ObjectNotFound, ValueError) as error:
            state, answer = RequestState.REFUSED, f"{type(error).__name__}: {error}"
    book.answer(asked.id, state, answer)
    document = {"request": asked.id, "state": str(state), "answer": answer}
    Catalogue.open(store).tell(REQUESTS_CHANGED, document)
    return f"{asked.author} asked for {asked.kind}: {state}, {answer}"
