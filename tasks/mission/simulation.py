"""A simulated mission as products: labels without pixels, their entries, and the adjusted network.

Layers, traverse and report are then made by the tasks for real missions.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode, AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.synthetic.edr import Exposure, label_bytes
from solmap.photogrammetry.synthetic.mission import (
    MISSION,
    MissionPlan,
    SimulatedMission,
    exposures,
    mission_names,
    simulate_mission,
)
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.adjusted_network import report_document
from solmap.products.formats.documents.archives import pose_document
from solmap.products.formats.documents.network import NetworkProduct, product_document
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.tasks.images.files import ContentDigest, write_bytes
from solmap.tasks.scopes import image_scope, network_scope, region_scope
from solmap.tasks.stage import stage

NO_PIXELS = "simulated: there are no pixels"


@dataclass(frozen=True, slots=True)
class SimulationParams:
    """All parameters of a simulated mission."""

    plan: MissionPlan
    seed: int
    adjustment: AdjustmentParams


def simulate(params: SimulationParams) -> SimulatedMission:
    """The mission, with the names of an archive."""
    names = mission_names(params.plan)
    return simulate_mission(np.random.default_rng(params.seed), params.plan, names=names)


@stage(task_run_name="labels")
def keep_labels(
    mission: SimulatedMission,
    plan: MissionPlan,
    workspace: Workspace,
    progress: Callable[[int, int], None],
) -> None:
    """Store the labels of all images, and catalogue them; `progress` receives counts."""
    browse = _placeholder_image(workspace)
    entries: list[ImageEntry] = []
    count = len(mission.network.pairs)
    for number, (left, right) in enumerate(exposures(mission, plan), 1):
        entries.append(_entry(left, right.product_id, browse, workspace))
        entries.append(_entry(right, left.product_id, browse, workspace))
        progress(number, count)
    workspace.catalogue.publish(images=entries)


def _entry(
    exposure: Exposure, partner: str, browse: ProductRef, workspace: Workspace
) -> ImageEntry:
    data = label_bytes(exposure)
    scope = image_scope(exposure.product_id)
    recipe = Recipe(ProductKind.IMAGE, scope, params=ContentDigest.of(data))
    ref = workspace.store.make(recipe, lambda draft: write_bytes(draft, data))
    stop = exposure.stop
    return ImageEntry(
        id=exposure.product_id,
        mission=stop.mission,
        stop=str(stop),
        site=stop.site,
        drive=stop.drive,
        sol=exposure.sol,
        instrument=str(exposure.instrument),
        eye=str(exposure.eye),
        product_type="EFF",
        start_time=None,
        local_solar_time=None,
        partner=partner,
        unpaired_because=None,
        ref=ref,
        browse=browse,
        notes=(NO_PIXELS,),
    )


def _placeholder_image(workspace: Workspace) -> ProductRef:
    """The common browse image of all images, which states that there are no pixels."""

    def write(path: Path) -> None:
        image = np.full((256, 256), 96, dtype=np.uint8)
        font = cv2.FONT_HERSHEY_SIMPLEX
        for line, word in enumerate(("simulated", "no pixels")):
            cv2.putText(image, word, (48, 120 + 36 * line), font, 1.0, 220, 2, cv2.LINE_AA)
        encoded, png = cv2.imencode(".png", image)
        if not encoded:
            raise OSError(f"{path.name} could not be encoded as PNG")
        path.write_bytes(png.tobytes())

    recipe = Recipe(ProductKind.BROWSE, region_scope(MISSION), params=NO_PIXELS)
    return workspace.store.make(recipe, write)


@stage(task_run_name="network")
def adjust_simulated(
    mission: SimulatedMission, params: SimulationParams, workspace: Workspace
) -> ProductRef:
    """Adjust the mission overall, with its control."""

    def write(path: Path) -> None:
        network = mission.network
        if mission.control is not None:
            frames, shown = (mission.control.frame,), mission.control.control
            network = with_control(network, frames, shown, params.adjustment)
        adjusted, report = adjust_overall(network, params.adjustment)
        priors = {prior.stop: prior for prior in mission.network.stops}
        product = NetworkProduct(
            mission=MISSION,
            sol=params.plan.stops,
            telemetry={stop: prior.lsl_from_rover for stop, prior in priors.items()},
            sols={stop: prior.sols for stop, prior in priors.items()},
            adjusted=adjusted,
            links=(),
            report=report_document(report),
        )
        path.write_text(json.dumps(product_document(product)))

    return workspace.store.make(network_recipe(params), write)


def network_recipe(params: SimulationParams) -> Recipe:
    """Everything that determines the network."""
    scope = network_scope(MISSION, params.plan.stops, AdjustmentMode.OVERALL)
    return Recipe(ProductKind.NETWORK, scope, params=params)


@stage(task_run_name="truth")
def write_truth(mission: SimulatedMission, path: Path) -> None:
    """Write the true positions of stops, for evaluation only."""
    drives = [None, *mission.slips.tolist()]
    rows = [
        {
            "stop": str(prior.stop),
            "lsl_from_rover": pose_document(pose),
            "slip": drives[k],
            "tied_to_the_stop_before": k not in mission.untied,
        }
        for k, (prior, pose) in enumerate(
            zip(mission.network.stops, mission.truth.lsl_from_rover, strict=True)
        )
    ]
    place = mission.control.place.tolist() if mission.control else None
    path.write_text(json.dumps({"stops": rows, "orbital_image": place}, indent=1))
