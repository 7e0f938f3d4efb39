"""Runs: what is processed and was, how far it is, what it said; and requests for new ones."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field

from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.collaboration.accounts import Operator
from solmap.gis_server.parameters import AGAIN, FOREVER, Digest, ScopeName
from solmap.gis_server.services import ServicesOf
from solmap.products.catalogue.edits import RequestKind, RunRequest
from solmap.products.catalogue.events import REQUESTS_CHANGED
from solmap.products.catalogue.runs import Run, RunState
from solmap.products.errors import ProductNotFoundError
from solmap.products.model import ProductKind

router = APIRouter(prefix="/api", tags=["runs"])
RunName = Annotated[str, Path(pattern=r"^[A-Za-z0-9-]{1,64}$")]


class RunBody(BaseModel):
    """A run: its stage with so many of so many parts done."""

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
    """What it said; only of a single run, else empty."""


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


class Wish(BaseModel):
    """What is to be run."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["downlink", "overall adjustment", "region"]
    mission: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")] | None = None
    """Of one mission; of all where it is left out."""


@router.get("/runs")
def runs(
    services: ServicesOf, response: Response, limit: Annotated[int, Query(ge=1, le=500)] = 50
) -> Runs:
    """The newest runs with state and progress; requests that wait; reports."""
    response.headers.update(AGAIN)
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
    """One run with all that it said."""
    response.headers.update(AGAIN)
    return _run_body(services.runs.run(run))


@router.post("/runs", status_code=202)
def request_run(wish: Wish, services: ServicesOf, who: Operator) -> RunRequest:
    """Ask for a run. It waits until `solmap up` takes it; the same wish is not kept twice."""
    if wish.mission is not None:
        services.catalogue.mission(wish.mission)
    asked = services.requests.add(RequestKind(wish.kind), wish.mission, who.name)
    services.catalogue.append_event(
        REQUESTS_CHANGED, {"request": asked.id, "state": str(asked.state)}
    )
    return asked


@router.get("/reports/{scope}/{digest}.html", response_class=FileResponse)
def report(scope: ScopeName, digest: Digest, services: ServicesOf) -> FileResponse:
    """The quality report of an adjustment, for people."""
    for ref in services.catalogue.pointers(ProductKind.REPORT):
        if (ref.scope.name, ref.digest) == (scope, digest):
            return FileResponse(services.store.path(ref), media_type="text/html", headers=FOREVER)
    raise ProductNotFoundError(f"no report {digest} of {scope} is the latest")


def _run_body(found: Run) -> RunBody:
    return RunBody.model_validate(found, from_attributes=True)
