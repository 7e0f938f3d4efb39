"""Runs: past and present ones with progress and messages; and requests for new ones."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Path, Query, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from solmap.config.run_parameters import RUN_KINDS, DownlinkRun, RunKind, RunSpecification
from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.collaboration.accounts import Operator
from solmap.gis_server.collaboration.engine import add_request, require_engine
from solmap.gis_server.parameters import FOREVER, REVALIDATE, Digest, ScopeName
from solmap.gis_server.services import ServicesOf
from solmap.products.catalogue.edits import RequestKind, RunRequest
from solmap.products.catalogue.engine_state import read_engine_state
from solmap.products.catalogue.runs import RESTARTABLE, Run, RunState
from solmap.products.errors import ProductNotFoundError
from solmap.products.model import ProductKind

router = APIRouter(prefix="/api", tags=["runs"])
RunName = Annotated[str, Path(pattern=r"^[A-Za-z0-9-]{1,64}$")]


class RunBody(BaseModel):
    """A run: its stage, with the numbers of finished and all parts."""

    id: str
    kind: str
    subject: str
    state: RunState
    started_at: str
    changed_at: str
    ended_at: str | None
    stage: str | None
    done: int
    total: int
    lines: tuple[str, ...]
    """Its messages; only for a single run, else empty."""
    parameters: dict[str, Any]
    """Its parameters."""
    actions: tuple[Literal["cancel", "restart"], ...]
    """Actions that an operator may request."""


class ReportBody(BaseModel):
    """The quality report of an adjustment."""

    scope: str
    digest: str
    page: ServerPath
    """Address of the report for people."""


class Runs(BaseModel):
    """Runs and requests, the newest first, and the reports of the latest adjustments."""

    runs: list[RunBody]
    requests: list[RunRequest]
    reports: list[ReportBody]


class RunKindBody(BaseModel):
    """A kind of run that may be requested."""

    kind: str
    title: str
    effect: str
    """Description of its effects."""
    deployment: str
    parameters: dict[str, Any]
    """JSON schema of an object."""


Specification = Annotated[RunSpecification, Field(discriminator="kind")]
_SPECIFICATION: TypeAdapter[RunSpecification] = TypeAdapter(Specification)


@router.get("/runs")
def runs(
    services: ServicesOf, response: Response, limit: Annotated[int, Query(ge=1, le=500)] = 50
) -> Runs:
    """The newest runs with state and progress; requests that wait; reports."""
    response.headers.update(REVALIDATE)
    reports = services.catalogue.pointers(ProductKind.REPORT)
    return Runs(
        runs=[_run_body(run).model_copy(update={"lines": ()}) for run in services.runs.runs(limit)],
        requests=services.requests.requests(limit),
        reports=[
            ReportBody(
                scope=ref.scope.name,
                digest=ref.digest,
                page=f"/api/reports/{ref.scope.name}/{ref.digest}.html",
            )
            for ref in reports
        ],
    )


@router.get("/runs/{run}")
def run(run: RunName, services: ServicesOf, response: Response) -> RunBody:
    """One run with all its messages."""
    response.headers.update(REVALIDATE)
    return _run_body(services.runs.run(run))


@router.get("/run-kinds")
def run_kinds(response: Response) -> list[RunKindBody]:
    """Kinds of runs that may be requested: descriptions, and the schema of their parameters."""
    response.headers.update(REVALIDATE)
    return [
        RunKindBody(
            kind=name,
            title=kind.model.__doc__ or name,
            effect=kind.effect,
            deployment=kind.deployment,
            parameters=_fields(kind),
        )
        for name, kind in RUN_KINDS.items()
    ]


@router.post("/runs", status_code=202)
def request_run(specification: Specification, services: ServicesOf, who: Operator) -> RunRequest:
    """Request a run. It waits until `solmap up` takes it; equal requests are stored once."""
    if specification.mission is not None and specification.kind != "fetch":
        services.catalogue.mission(specification.mission)
    engine = read_engine_state(services.store.root)
    if engine.is_up and not engine.has_inbox and specification.kind in {"downlink", "fetch"}:
        raise HTTPException(409, "no inbox is watched: start `solmap up` with `--inbox FOLDER`")
    parameters = {
        name: value for name, value in specification.parameters.items() if name != "mission"
    }
    return add_request(
        services, RequestKind(specification.kind), specification.mission, who.name, parameters
    )


@router.post("/runs/{run}/cancel", status_code=202)
def cancel(run: RunName, services: ServicesOf, who: Operator) -> RunRequest:
    """Cancel a run that is in progress or waits in the engine.

    Its processes are ended; products that exist are kept, and another run continues from them.
    """
    engine = require_engine(services)
    if any(queued.flow_run == run for queued in engine.queued):
        flow_run: str | None = run
    else:
        found = services.runs.run(run)
        if found.state is not RunState.RUNNING:
            raise HTTPException(409, f"run {run} has ended already: {found.state}")
        flow_run = found.flow_run
    if flow_run is None:
        raise HTTPException(409, f"run {run} was started by a command: stop it there with Ctrl-C")
    return add_request(services, RequestKind.CANCEL, None, who.name, {"run": flow_run})


@router.post("/runs/{run}/restart", status_code=202)
def restart(run: RunName, services: ServicesOf, who: Operator) -> RunRequest:
    """Repeat a failed, cancelled or lost run with the same parameters.

    Existing products are looked up: only failed and remaining work is done.
    """
    require_engine(services)
    found = services.runs.run(run)
    if found.state not in RESTARTABLE:
        raise HTTPException(409, f"run {run} is {found.state}: it cannot be repeated")
    if found.flow_run is None:
        raise HTTPException(409, f"run {run} was started by a command: repeat that command")
    try:
        specification = _SPECIFICATION.validate_python({"kind": found.kind, **found.parameters})
    except ValidationError as error:
        raise HTTPException(
            409, f"the parameters of run {run} are no longer valid; start a new run"
        ) from error
    return request_run(specification, services, who)


@router.get("/reports/{scope}/{digest}.html", response_class=FileResponse)
def report(scope: ScopeName, digest: Digest, services: ServicesOf) -> FileResponse:
    """The quality report of an adjustment, for people."""
    for ref in services.catalogue.pointers(ProductKind.REPORT):
        if (ref.scope.name, ref.digest) == (scope, digest):
            return FileResponse(services.store.path(ref), media_type="text/html", headers=FOREVER)
    raise ProductNotFoundError(f"no report {digest} of {scope} is the latest")


def _run_body(found: Run) -> RunBody:
    named = {name: getattr(found, name) for name in RunBody.model_fields if name != "actions"}
    return RunBody(**named, actions=_actions(found))


def _actions(found: Run) -> tuple[Literal["cancel", "restart"], ...]:
    if found.flow_run is None:
        return ()
    if found.state is RunState.RUNNING:
        return ("cancel",)
    return ("restart",) if found.state in RESTARTABLE else ()


def _fields(kind: RunKind) -> dict[str, Any]:
    """The schema of the parameters of a kind, without those that it always has."""
    schema = kind.model.model_json_schema()
    fixed = ("kind", "mission") if kind.model is DownlinkRun else ("kind",)
    for name in fixed:
        schema["properties"].pop(name, None)
    schema["required"] = [name for name in schema.get("required", ()) if name not in fixed]
    return schema
