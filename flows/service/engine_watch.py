"""State of the engine, written for the map: deployments, waiting runs, outcomes of runs."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime
from pathlib import Path
from uuid import UUID

from prefect.client.orchestration import SyncPrefectClient, get_client
from prefect.client.schemas.filters import (
    DeploymentFilter,
    DeploymentFilterId,
    DeploymentFilterTags,
    FlowRunFilter,
    FlowRunFilterId,
    FlowRunFilterState,
    FlowRunFilterStateType,
)
from prefect.client.schemas.objects import FlowRun, StateType
from prefect.client.schemas.responses import DeploymentResponse
from prefect.client.schemas.sorting import FlowRunSort

from solmap.config.workspace import open_catalogue
from solmap.products.catalogue.engine_state import (
    DeploymentState,
    EngineState,
    QueuedRun,
    read_engine_state,
)
from solmap.products.catalogue.events import ENGINE_CHANGED
from solmap.products.catalogue.runs import Run, RunRecords, RunState

_ENDED = [StateType.COMPLETED, StateType.FAILED, StateType.CRASHED, StateType.CANCELLED]
_MOST_QUEUED = 50


def write_state(root: Path, *, has_inbox: bool, is_scheduler_alive: bool) -> None:
    """Query the engine's state and write it; browsers are notified of changes.

    Raises:
        HTTPError: Prefect's server does not answer.
    """
    with get_client(sync_client=True) as client:
        selection = DeploymentFilter(tags=DeploymentFilterTags(all_=["solmap"]))
        found = client.read_deployments(deployment_filter=selection)
        names = {one.id: f"{client.read_flow(one.flow_id).name}/{one.name}" for one in found}
        states = [_deployment(one, names[one.id], client, is_scheduler_alive) for one in found]
        queued = [
            QueuedRun(
                str(run.id),
                names[run.deployment_id],
                run.name,
                _time(run.expected_start_time),
                run.parameters,
            )
            for run in _scheduled(client, FlowRunSort.EXPECTED_START_TIME_ASC)
            if run.deployment_id in names and not run.auto_scheduled
        ]
        _end_cancelled(root, client)
    ordered = tuple(sorted(states, key=lambda one: one.name))
    _write(root, EngineState(_now(), True, None, has_inbox, ordered, tuple(queued)))  # noqa: FBT003


def write_problem(root: Path, problem: str) -> None:
    """Write down that the engine does not answer."""
    known = read_engine_state(root).deployments
    _write(root, EngineState(_now(), is_up=False, trouble=problem, deployments=known))


def _write(root: Path, state: EngineState) -> None:
    before = read_engine_state(root)
    state.write(root)
    if dataclasses.replace(before, at=state.at) != state:
        open_catalogue(root).append_event(ENGINE_CHANGED, {"is_up": state.is_up})


def _deployment(
    found: DeploymentResponse,
    name: str,
    client: SyncPrefectClient,
    is_scheduler_alive: bool,  # noqa: FBT001 - a fact
) -> DeploymentState:
    of_it = DeploymentFilter(id=DeploymentFilterId(any_=[found.id]))
    coming = _scheduled(client, FlowRunSort.EXPECTED_START_TIME_ASC, of_it, 1)
    last = client.read_flow_runs(
        flow_run_filter=_of_types(_ENDED),
        deployment_filter=of_it,
        sort=FlowRunSort.END_TIME_DESC,
        limit=1,
    )
    ended = last[0] if last else None
    is_ready = getattr(found.status, "value", None) == "READY"
    return DeploymentState(
        name=name,
        description=found.description or "",
        is_paused=found.paused,
        schedules=tuple(
            str(getattr(one.schedule, "cron", one.schedule))
            for one in found.schedules
            if one.active
        ),
        next_run=_time(coming[0].expected_start_time) if coming else None,
        last_state=ended.state.type.value.lower() if ended and ended.state else None,
        last_ended_at=_time(ended.end_time) if ended else None,
        pool=found.work_pool_name,
        is_ready=is_ready if found.work_pool_name else is_scheduler_alive,
    )


def _end_cancelled(root: Path, client: SyncPrefectClient) -> None:
    """Mark runs that were killed by their cancellation as cancelled."""
    book = RunRecords(open_catalogue(root).engine)
    left: dict[UUID, list[Run]] = {}
    for run in book.runs():
        if run.flow_run and run.state in {RunState.RUNNING, RunState.LOST}:
            left.setdefault(UUID(run.flow_run), []).append(run)
    if not left:
        return
    selection = _of_types([StateType.CANCELLED])
    selection.id = FlowRunFilterId(any_=list(left))
    for cancelled in client.read_flow_runs(flow_run_filter=selection):
        why = cancelled.state.message if cancelled.state else None
        for run in left[cancelled.id]:
            book.write(run.with_lines([why or "cancelled"]).with_end(RunState.CANCELLED))


def _scheduled(
    client: SyncPrefectClient,
    sort: FlowRunSort,
    of: DeploymentFilter | None = None,
    limit: int = _MOST_QUEUED,
) -> list[FlowRun]:
    selection = _of_types([StateType.SCHEDULED])
    return client.read_flow_runs(
        flow_run_filter=selection, deployment_filter=of, sort=sort, limit=limit
    )


def _of_types(types: list[StateType]) -> FlowRunFilter:
    return FlowRunFilter(state=FlowRunFilterState(type=FlowRunFilterStateType(any_=types)))


def _time(at: datetime | None) -> str | None:
    return at.astimezone(UTC).isoformat(timespec="seconds") if at else None


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
