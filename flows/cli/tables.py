"""What the store holds, as rows that scripts read: the contract of `solmap ... --json`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from solmap.config.pipeline import load_pipeline
from solmap.config.settings import Settings
from solmap.products.catalogue.catalogue import ImageEntry, published_networks
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import MARS, local_proj4
from solmap.products.formats.documents.network import whole_network
from solmap.products.model import Layer, ProductKind, ProductRef
from solmap.products.reports.sol_report import sol_report, timings
from solmap.tasks.scopes import is_of_mission


def position_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """One row a stop, of every mission, in the order of the traverse.

    Positions are (north, east, down) metres in the LSL; the quaternion turns the rover into the
    LSL, scalar first; the covariance is of rotation vector (radians) and position in the LSL.
    """
    rows = []
    for ref in latest_networks(workspace):
        network = whole_network(ref, workspace.store)
        for stop in network.adjusted.stops:
            name = stop.stop
            rows.append(
                {
                    "mission": name.mission,
                    "site": name.site,
                    "drive": name.drive,
                    "stop": str(name),
                    "sols": list(network.sols[name]),
                    "telemetry_ned_m": network.telemetry[name].translation_m.tolist(),
                    "adjusted_ned_m": stop.lsl_from_rover.translation_m.tolist(),
                    "adjusted_quaternion": stop.lsl_from_rover.quaternion.tolist(),
                    "sigma_ned_m": stop.sigma_ned_m.tolist(),
                    "covariance": stop.covariance.tolist(),
                    "held": stop.held,
                    "held_by": stop.held_by,
                }
            )
    return rows


def latest_networks(workspace: Workspace) -> list[ProductRef]:
    """The network of the last sol of every mission."""
    latest: dict[str, ProductRef] = {}
    for ref in workspace.catalogue.pointers(ProductKind.NETWORK):
        mission, _, _ = ref.scope.name.rpartition("-sol")
        if mission not in latest or latest[mission].scope.name < ref.scope.name:
            latest[mission] = ref
    return [latest[mission] for mission in sorted(latest)]


def product_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """One row a published product: layers, then the browse images."""
    proj4 = {entry.mission: local_proj4(entry.landing) for entry in workspace.catalogue.missions()}
    layers = [_layer_row(layer, proj4, workspace) for layer in workspace.catalogue.layers()]
    return layers + [_browse_row(entry, workspace) for entry in workspace.catalogue.images()]


def _layer_row(layer: Layer, proj4: dict[str, str], workspace: Workspace) -> dict[str, Any]:
    return {
        "kind": str(layer.ref.kind),
        "scope": layer.ref.scope.name,
        "level": str(layer.ref.scope.level),
        "path": str(workspace.store.address(layer.ref)),
        "crs": _crs(layer, proj4[layer.mission]),
        "cell_m": layer.cell_m,
        "made_at": layer.made_at,
    }


def _crs(layer: Layer, local: str) -> str | None:
    """What the coordinates in a layer's file are of; those of a panorama are angles."""
    if layer.type == "panorama":
        return None
    return MARS if layer.type == "vector" else local


def _browse_row(entry: ImageEntry, workspace: Workspace) -> dict[str, Any]:
    return {
        "kind": str(entry.browse.kind),
        "scope": entry.browse.scope.name,
        "level": str(entry.browse.scope.level),
        "path": str(workspace.store.address(entry.browse)),
        "crs": None,
        "cell_m": None,
        "made_at": workspace.store.made_at(entry.browse),
    }


def outcome_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """One row a file or sol: how its last processing ended."""
    return [
        {
            "subject": outcome.subject,
            "ended": "failed" if outcome.is_failure else "done",
            "notes": list(outcome.notes),
            "at": outcome.at,
        }
        for outcome in workspace.catalogue.outcomes()
    ]


def report_rows(workspace: Workspace, mission: str | None = None) -> list[dict[str, Any]]:
    """One row an adjustment, in the order of the sols: its page, its figures, and when."""
    figures = {ref.scope: ref for ref in workspace.catalogue.pointers(ProductKind.QUALITY)}
    return [
        {
            "adjustment": page.scope.name,
            "page": str(workspace.store.path(page)),
            "figures": _path(figures.get(page.scope), workspace),
            "made_at": workspace.store.made_at(page),
        }
        for page in workspace.catalogue.pointers(ProductKind.REPORT)
        if mission is None or is_of_mission(page.scope, mission)
    ]


def write_sol_report(mission: str, sol: int, workspace: Workspace, path: Path) -> None:
    """Write all that is known of a sol as one page; links lead to the map's server.

    Raises:
        ProductNotFoundError: the store has no image of that sol.
    """
    path.write_text(sol_report(mission, sol, workspace, Settings().map_url), encoding="utf-8")


def timing_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """What all products of the store took, one row a kind, the longest first."""
    return [asdict(row) for row in timings(list(workspace.store.refs()), workspace)]


def rig_correction_rows(workspace: Workspace, mission: str | None = None) -> list[dict[str, Any]]:
    """Four rows a camera set: how its stereo rig differs from the labels; all missions, or one.

    Raises:
        ConfigError: the pipeline of the settings cannot be read.
        ProductNotFoundError: there is no such mission, or no network of it.
        AdjustmentError: a network cannot be adjusted, or determines no correction.
    """
    from solmap.tasks.mission.control import control_of  # noqa: PLC0415 - brings the engine
    from solmap.tasks.network.rig_table import rig_rows  # noqa: PLC0415

    catalogue, params = workspace.catalogue, load_pipeline(Settings().pipeline).adjustment
    names = (
        [mission.upper()]
        if mission
        else [
            entry.mission
            for entry in catalogue.missions()
            if published_networks(entry.mission, catalogue)
        ]
    )
    return [
        asdict(row)
        for name in names
        for row in rig_rows(name, control_of(name, workspace), params, workspace)
    ]


def _path(ref: ProductRef | None, workspace: Workspace) -> str | None:
    return str(workspace.store.path(ref)) if ref else None
