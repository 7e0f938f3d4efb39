"""Hand ties before they are saved: a picked point measured, and ties tried on two stops."""

from __future__ import annotations

from fastapi import APIRouter

from solmap.gis_server.analysis.picks import RefineAnswer, RefineQuestion, refined_pick
from solmap.gis_server.analysis.trial import tried
from solmap.gis_server.analysis.trial_bodies import TrialAnswer, TrialQuestion
from solmap.gis_server.routes.parameters import MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace

router = APIRouter(prefix="/api/missions/{mission}", tags=["hand ties"])


@router.post("/refine")
def refine(mission: MissionName, question: RefineQuestion, services: ServicesOf) -> RefineAnswer:
    """Measure a picked point to a fraction of a pixel, by least-squares matching."""
    return refined_pick(question, _oriented(mission, services))


@router.post("/preview-adjustment")
def preview(mission: MissionName, question: TrialQuestion, services: ServicesOf) -> TrialAnswer:
    """Adjust two stops with hand ties and without; computes only, writes nothing."""
    return tried(question, _oriented(mission, services))


def _oriented(mission: str, services: Services) -> OrientedMission:
    services.catalogue.mission(mission)
    return OrientedMission.latest(mission, Workspace(services.store, services.catalogue))
