"""Write a store of a simulated mission: traverse, stops, ties and footprints, without images."""

from __future__ import annotations

from pathlib import Path

from prefect import flow

from solmap.config.landing import landing_site
from solmap.config.pipeline import load_pipeline
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.mission_layers import draw_mission
from solmap.flows.progress import report
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.synthetic.mission import MissionPlan
from solmap.photogrammetry.synthetic.mission_images import MISSION
from solmap.products.catalogue.catalogue import MissionEntry, Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.publish import publish
from solmap.tasks.report import report_quality
from solmap.tasks.simulated_mission import (
    NO_PIXELS,
    SimulationParams,
    adjust_simulated,
    keep_labels,
    network_recipe,
    simulated,
    write_truth,
)

TRUTH = "truth.json"


@flow(name="simulate-mission", flow_run_name="{seed}")
def simulate_into(store: Path, plan: MissionPlan, seed: int, pipeline: str = "default") -> str:
    """Simulate a mission and publish it; one line of what it holds.

    Raises:
        PhotogrammetryError: the store holds another mission.
    """
    workspace = open_workspace(store)
    config = load_pipeline(pipeline)
    params = SimulationParams(plan, seed, config.adjustment)
    _refuse_other_missions(workspace, network_recipe(params).ref)
    mission = simulated(params)
    keep_labels(mission, plan, workspace, lambda done, count: report("keep labels", done, count))
    network = adjust_simulated(mission, params, workspace)
    write_truth(mission, workspace.store.root / TRUTH)
    _publish(network, workspace, pipeline)
    ties = len(mission.truth.points)
    images = 2 * len(mission.network.pairs)
    return (
        f"{plan.stops} stops, {images} images, {ties} ties, {mission.along_m[-1]:.0f} m; "
        f"{len(mission.untied)} drives without ties"
    )


def _publish(network: ProductRef, workspace: Workspace, pipeline: str) -> None:
    site = landing_site(MISSION, Settings().landing_sites)
    told = report_quality(network, (), load_pipeline(pipeline).quality, workspace.store)
    entry = MissionEntry(MISSION, f"{site.title} (simulated)", site.landing, None)
    done = Outcome.now(network.scope.name, ("simulated: there are no images",))
    publish(entry, [], [network, *told], [done], workspace)
    draw_mission(MISSION, network, workspace, pipeline)


def _refuse_other_missions(workspace: Workspace, network: ProductRef) -> None:
    """A store holds one mission of a name: what is simulated must not mix with anything else."""
    images = workspace.catalogue.images(MISSION)
    others = [one for one in workspace.catalogue.pointers(ProductKind.NETWORK) if one != network]
    if others or any(NO_PIXELS not in image.notes for image in images):
        raise PhotogrammetryError(
            f"{workspace.store.root} holds another mission {MISSION}, with {len(images)} images: "
            "a simulated one must not mix with it; name an empty store"
        )
