"""The adjusted network: solutions, traverses, graph, ties of an image, and manual tie points."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from solmap.gis_server.analysis.manual_ties import (
    RefineAnswer,
    RefineQuestion,
    TrialAnswer,
    TrialQuestion,
    preview_adjustment,
    refine_pick,
)
from solmap.gis_server.analysis.network import (
    ImageTies,
    NetworkGraph,
    PairGraph,
    image_ties,
    network_graph,
    pair_graph,
)
from solmap.gis_server.analysis.solutions import (
    LATEST,
    TELEMETRY,
    Solution,
    TraverseAnswer,
    compare_traverses,
    network_named,
    solutions,
)
from solmap.gis_server.parameters import REVALIDATE, ImageName, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError

router = APIRouter(prefix="/api/missions/{mission}")

_NAME = r"[a-z0-9][a-z0-9_.-]{0,127}/[0-9a-f]{16}"
SolutionName = Annotated[
    str,
    Query(pattern=rf"^({LATEST}|{_NAME})$", description=f"`{LATEST}`, or an id of /solutions"),
]
ReferenceName = Annotated[
    str,
    Query(pattern=rf"^({TELEMETRY}|{LATEST}|{_NAME})$", description=f"`{TELEMETRY}`, or an id"),
]


@router.get("/solutions", tags=["network"])
def all_solutions(mission: MissionName, services: ServicesOf, response: Response) -> list[Solution]:
    """Every adjustment that the store holds, newest sol first."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    return solutions(mission, services.catalogue, services.store)


@router.get("/traverse", tags=["network"])
def traverse(
    mission: MissionName,
    services: ServicesOf,
    response: Response,
    solution: SolutionName = LATEST,
    reference: ReferenceName = TELEMETRY,
) -> TraverseAnswer:
    """Accumulated differences of a solution from telemetry or from another one, stop by stop."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    catalogue, store = services.catalogue, services.store
    named = network_named(mission, solution, catalogue, store)
    other = None if reference == TELEMETRY else network_named(mission, reference, catalogue, store)
    return compare_traverses(named, other)


@router.get("/network", tags=["network"])
def network(
    mission: MissionName,
    services: ServicesOf,
    response: Response,
    solution: SolutionName = LATEST,
) -> NetworkGraph:
    """Stops and the tie points they share, with weaknesses."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    return network_graph(*network_named(mission, solution, services.catalogue, services.store))


@router.get("/network/pairs", tags=["network"])
def pairs(
    mission: MissionName,
    stop: Annotated[str, Query(max_length=128)],
    services: ServicesOf,
    response: Response,
    solution: SolutionName = LATEST,
) -> PairGraph:
    """The pairs of a stop and the tie points they share with any other pair."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    named = network_named(mission, solution, services.catalogue, services.store)
    if stop not in {str(one.stop) for one in named[1].adjusted.stops}:
        raise ProductNotFoundError(f"no stop {stop!r} is in that network; /network lists them")
    entries = {entry.id: entry for entry in services.catalogue.images(mission)}
    return pair_graph(*named, stop, entries)


@router.get("/images/{image}/ties", tags=["network"])
def ties(
    mission: MissionName, image: ImageName, services: ServicesOf, response: Response
) -> ImageTies:
    """The tie points of an image with their residuals, in pixels of the image as stored."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    workspace = Workspace(services.store, services.catalogue)
    oriented = OrientedMission.latest(mission, workspace)
    return image_ties(services.catalogue.image(image), oriented)


@router.post("/refine", tags=["manual ties"])
def refine(mission: MissionName, question: RefineQuestion, services: ServicesOf) -> RefineAnswer:
    """Measure a picked point to a fraction of a pixel, by least-squares matching."""
    return refine_pick(question, _oriented_mission(mission, services))


@router.post("/preview-adjustment", tags=["manual ties"])
def preview(mission: MissionName, question: TrialQuestion, services: ServicesOf) -> TrialAnswer:
    """Adjust two stops with and without manual ties; stores nothing."""
    return preview_adjustment(question, _oriented_mission(mission, services))


def _oriented_mission(mission: str, services: Services) -> OrientedMission:
    services.catalogue.mission(mission)
    return OrientedMission.latest(mission, Workspace(services.store, services.catalogue))
