"""Submit runs to Prefect's server: for the inbox, and for requests from the map."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import cast
from uuid import UUID

from prefect.client.orchestration import SyncPrefectClient, get_client
from prefect.client.schemas.filters import (
    FlowRunFilter,
    FlowRunFilterExpectedStartTime,
    FlowRunFilterState,
    FlowRunFilterStateName,
    FlowRunFilterStateType,
)
from prefect.client.schemas.objects import FlowRun, StateType
from prefect.client.schemas.responses import OrchestrationResult, SetStateStatus
from prefect.client.schemas.sorting import FlowRunSort
from prefect.deployments import run_deployment
from prefect.exceptions import ObjectNotFound, PrefectHTTPStatusError
from prefect.states import Cancelling, Crashed
from prefect.types import DateTime

from solmap.config.run_parameters import RUN_KINDS
from solmap.config.workspace import open_catalogue
from solmap.flows.runtime.engine import BY_COMMAND
from solmap.flows.service.deployments import DOWNLINK
from solmap.products.catalogue.edits import RequestKind, RequestState, RunRequest, RunRequests
from solmap.products.catalogue.events import REQUESTS_CHANGED

_NEED_INBOX = (RequestKind.DOWNLINK, RequestKind.FETCH)
_SERVER_FAILED = 500
_TAKEN = [StateType.RUNNING, StateType.PENDING, StateType.CANCELLING]


def submit_requests(store: Path, *, has_inbox: bool) -> list[str]:
    """Submit waiting requests; returns a line for each one taken or refused.

    A scheduler that has just started has no deployments yet: requests continue to wait.

    Raises:
        HTTPError: Prefect's server does not answer; the request continues to wait.
    """
    book, lines = RunRequests.of(store), []
    for request in book.waiting():
        with contextlib.suppress(ObjectNotFound):
            state, answer = _submit(request, has_inbox=has_inbox)
            book.answer(request.id, state, answer)
            document = {"request": request.id, "state": str(state), "answer": answer}
            open_catalogue(store).append_event(REQUESTS_CHANGED, document)
            lines.append(f"{request.author} requested {request.kind}: {state}, {answer}")
    return lines


def _submit(request: RunRequest, *, has_inbox: bool) -> tuple[RequestState, str]:
    try:
        match request.kind:
            case RequestKind.CANCEL:
                return cancel_run(UUID(request.parameters["run"]), request.author)
            case RequestKind.PAUSE | RequestKind.RESUME:
                is_paused = request.kind is RequestKind.PAUSE
                return pause(request.parameters["deployment"], is_paused=is_paused)
        if request.kind in _NEED_INBOX and not has_inbox:
            return RequestState.REFUSED, "no inbox is watched; start `solmap up --inbox`"
        mission = {"mission": request.mission} if request.mission else {}
        deployment = RUN_KINDS[request.kind].deployment
        return RequestState.TAKEN, submit(deployment, {**request.parameters, **mission})
    except (PrefectHTTPStatusError, ValueError) as error:
        status = error.response.status_code if isinstance(error, PrefectHTTPStatusError) else 422
        if status >= _SERVER_FAILED or isinstance(error, ObjectNotFound):
            raise
        return RequestState.REFUSED, f"the engine refuses it: {error}".splitlines()[0]


def cancel_run(run: UUID, author: str) -> tuple[RequestState, str]:
    """Have the engine end a run with its processes; one that has not begun will not begin."""
    with _client() as client:
        try:
            found = client.read_flow_run(run)
        except ObjectNotFound:
            return RequestState.REFUSED, "the engine has no such run"
        if found.state is not None and found.state.is_final():
            return RequestState.REFUSED, f"it has ended already: {found.state.type.value.lower()}"
        message = f"cancelled on the map by {author}"
        answer: OrchestrationResult[object] = client.set_flow_run_state(
            run, Cancelling(message=message)
        )
        if answer.status is SetStateStatus.ABORT:
            return RequestState.REFUSED, f"the engine refuses it: {answer.details}"
    return RequestState.TAKEN, f"{found.name} ends"


def pause(deployment: str, *, is_paused: bool) -> tuple[RequestState, str]:
    """Pause or resume the scheduled runs of a deployment."""
    with _client() as client:
        found = client.read_deployment_by_name(deployment)
        if is_paused:
            client.pause_deployment(found.id)
        else:
            client.resume_deployment(found.id)
    return RequestState.TAKEN, f"{deployment} {'is paused' if is_paused else 'goes on'}"


@dataclass(frozen=True, slots=True)
class SubmittedRun:
    """A submitted run, and the delivery that it processes."""

    run: UUID
    name: str
    delivery: str


def submit_inbox(delivery: str, settle_s: float) -> SubmittedRun | None:
    """Submit a run for the inbox; files that changed less than `settle_s` ago are left for later.

    None if the scheduler has just started and its deployments are not known yet.
    """
    try:
        answer = run_deployment(
            DOWNLINK, parameters={"settle_s": settle_s}, timeout=0, as_subflow=False
        )
    except ObjectNotFound:
        return None
    run = cast("FlowRun", answer)  # outside of an event loop it is not a coroutine
    return SubmittedRun(run.id, run.name, delivery)


def submit(deployment: str, parameters: Mapping[str, object]) -> str:
    """Submit a run of a deployment; returns its name."""
    answer = run_deployment(deployment, parameters=dict(parameters), timeout=0, as_subflow=False)
    return cast("FlowRun", answer).name


def final_state(submitted: SubmittedRun) -> str | None:
    """Final state of a run, like COMPLETED or CRASHED; None before its end."""
    with _client() as client:
        state = client.read_flow_run(submitted.run).state
    return state.type.value if state is not None and state.is_final() else None


def mark_crashed_runs(*, of_commands: bool) -> int:
    """Mark runs in the state "running" as crashed; returns their number.

    Called while no scheduler runs, so that none of its runs can be running.

    Args:
        of_commands: Whether runs that commands such as `solmap run` started are marked too: not
            while the server works, because they may be running.
    """
    number, kept, sort = 0, 0, FlowRunSort.START_TIME_ASC
    with _client() as client:
        while found := client.read_flow_runs(
            flow_run_filter=_of_types(_TAKEN), sort=sort, limit=50, offset=kept
        ):
            dead = [run for run in found if of_commands or BY_COMMAND not in run.tags]
            for run in dead:
                message = "solmap ended while this ran; the next run continues"
                client.set_flow_run_state(run.id, Crashed(message=message), force=True)
            number += len(dead)
            kept += len(found) - len(dead)
    return number


def is_stuck(late_s: float) -> bool:
    """Whether a run is this late while none is running, so that the scheduler does not work."""
    before = cast("DateTime", datetime.now(UTC) - timedelta(seconds=late_s))
    late = FlowRunFilter(
        state=FlowRunFilterState(name=FlowRunFilterStateName(any_=["Late"])),
        expected_start_time=FlowRunFilterExpectedStartTime(before_=before),
    )
    with _client() as client:
        return bool(client.count_flow_runs(flow_run_filter=late)) and not client.count_flow_runs(
            flow_run_filter=_of_types(_TAKEN)
        )


def _of_types(types: list[StateType]) -> FlowRunFilter:
    return FlowRunFilter(state=FlowRunFilterState(type=FlowRunFilterStateType(any_=types)))


def _client() -> SyncPrefectClient:
    return get_client(sync_client=True)
