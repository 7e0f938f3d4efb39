"""Control measured by people: taken into the store, listed, and taken back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from solmap.config.landing import landing_site
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.orbital import latest_standing
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.control import read_control
from solmap.tasks.control import FrameParams, control_of, take_control
from solmap.tasks.publish import publish


def add_control(file: Path, mission: str, root: Path, params: FrameParams) -> str:
    """Publish a file of measured control; one line on what it holds.

    Raises:
        AdjustmentError: the file is broken, or names a stop that is not known.
        ProductNotFoundError: no network of the mission is in the store.
    """
    workspace = open_workspace(root)
    site = landing_site(mission, Settings().landing_sites)
    standing = latest_standing(mission, workspace)
    if standing is None:
        raise ProductNotFoundError(
            f"no network of {mission} is in the store; `solmap run` its downlink first"
        )
    store = workspace.store
    ref = take_control(file.name, file.read_bytes(), standing.network, params, site.landing, store)
    publish.fn(MissionEntry(mission, site.title, site.landing, None), [], [ref], (), workspace)
    frame, found = read_control(ref, store)
    if not found:
        return f"{file.name} is empty: what it held before counts no more"
    return f"{frame.name}: {len(found)} places; `solmap adjust --overall` weighs them in"


def control_rows(mission: str, root: Path) -> list[dict[str, Any]]:
    """Every place of a stop that counts as control."""
    workspace = open_workspace(root)
    rows = []
    for ref in control_of(mission, workspace):
        frame, control = read_control(ref, workspace.store)
        rows += [
            {
                "frame": frame.name,
                "stop": str(one.stop),
                "east_m": round(one.east_m, 3),
                "north_m": round(one.north_m, 3),
                "sigma_m": round(float(one.covariance[:2, :2].trace() / 2) ** 0.5, 3),
                "up_m": one.up_m,
                "azimuth_deg": one.azimuth_deg and round(one.azimuth_deg, 3),
            }
            for one in control
        ]
    return rows
