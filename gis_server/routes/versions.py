"""The versions of a layer: what was published before what is on the map now."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel

from solmap.gis_server.analysis.solutions import OVERALL
from solmap.gis_server.routes.bodies import MapLayer, layer_body
from solmap.gis_server.routes.parameters import AGAIN, LayerPath, ScopeName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.layer_versions import (
    solutions_behind,
    solutions_of_mission,
    versions_of,
)
from solmap.products.catalogue.runs import Run
from solmap.products.errors import ProductNotFoundError
from solmap.products.model import Layer, ProductKind

router = APIRouter(prefix="/api/layers", tags=["layers"])
_RUNS = 500


class SolutionBehind(BaseModel):
    """An adjustment that a version holds for."""

    id: str
    """As in `/solutions`."""
    scope: str
    is_overall: bool


class RunBehind(BaseModel):
    """The run that a version was made in."""

    id: str
    kind: str
    subject: str


class LayerVersion(BaseModel):
    """A layer as it was published once."""

    layer: MapLayer
    """Its `id` ends in `@` and the digest."""
    is_latest: bool
    solutions: list[SolutionBehind]
    """Those that the version holds for, the one it was made for first; none where unknown."""
    run: RunBehind | None
    """Null where no record of a run covers the time when it was made."""


class LayerVersions(BaseModel):
    """Some of the versions of a layer, newest first."""

    total: int
    versions: list[LayerVersion]


@router.get("/{scope}/{kind}/versions")
def versions(
    scope: ScopeName,
    kind: ProductKind,
    services: ServicesOf,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    offset: Annotated[int, Query(ge=0)] = 0,
) -> LayerVersions:
    """Every version of a layer that was ever published, with the solutions it holds for."""
    response.headers.update(AGAIN)
    found = versions_of(scope, kind, services.catalogue)
    if not found or found[0].type == "model":
        raise ProductNotFoundError(f"no {kind} of {scope} is a layer of the map")
    page = found[offset : offset + limit]
    return LayerVersions(total=len(found), versions=_bodies(page, services))


@router.get("/{scope}/{kind}/{digest}")
def version(layer: LayerPath, services: ServicesOf, response: Response) -> LayerVersion:
    """One version of a layer."""
    response.headers.update(AGAIN)
    if layer.type == "model":
        raise ProductNotFoundError(f"{layer.id} is a model and no layer of the map")
    return _bodies([layer], services)[0]


def _bodies(layers: list[Layer], services: Services) -> list[LayerVersion]:
    store, catalogue = services.store, services.catalogue
    runs = services.runs.runs(_RUNS)
    bodies = []
    for layer in layers:
        solutions = solutions_of_mission(layer.mission, catalogue, store)
        behind = solutions_behind(layer.ref, solutions, store)
        body = layer_body(layer)
        latest = catalogue.latest(layer.ref.scope.name, layer.ref.kind)
        body.id = f"{layer.id}@{layer.ref.digest}"
        bodies.append(
            LayerVersion(
                layer=body,
                is_latest=layer.ref.digest == latest,
                solutions=[
                    SolutionBehind(
                        id=f"{ref.scope.name}/{ref.digest}",
                        scope=ref.scope.name,
                        is_overall=ref.scope.name.endswith(OVERALL),
                    )
                    for ref in behind
                ],
                run=_run_at(layer.made_at, runs),
            )
        )
    return bodies


def _run_at(made_at: str, runs: list[Run]) -> RunBehind | None:
    """The newest run that was going on then; times of products are whole seconds."""
    second = made_at[:19]
    for run in runs:
        ended = run.ended_at or run.changed_at
        if run.started_at[:19] <= second <= ended[:19]:
            return RunBehind(id=run.id, kind=run.kind, subject=run.subject)
    return None
