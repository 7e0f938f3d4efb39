"""Content of the store as rows for scripts: the contract of `solmap ... --json`."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

from solmap.config.settings import Settings
from solmap.products.catalogue.catalogue import ImageEntry, published_networks
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import MARS, crs_text
from solmap.products.model import Layer, ProductKind, ProductRef

_Stops = dict[tuple[int, int], tuple[dict[str, Any], dict[str, Any]]]
"""Stops by (site, drive): telemetry and adjusted pose."""


def position_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """One row per stop, of every map of every mission, in the order of the traverse.

    The LSL is that of the row's map; sites that are not tied to the lander have a separate one.
    Positions are (north, east, down) metres in the LSL; the quaternion turns the rover into the
    LSL, scalar first; the covariance is of rotation vector (radians) and position in the LSL.
    """
    rows = []
    for ref in latest_networks(workspace):
        stops = _stops_of(ref, workspace)
        of_map = {"map": ref.scope.name.rpartition("-sol")[0].upper()}
        rows += [of_map | _position_row(*stops[name]) for name in sorted(stops)]
    return rows


def _stops_of(ref: ProductRef, workspace: Workspace) -> _Stops:
    """The stops of a network, from its documents.

    They are read as JSON (documented in `products.formats.documents.network`), because reading the
    ties of a mission takes seconds, and a table of positions needs none.
    """
    document = json.loads(workspace.store.path(ref).read_text())
    stops = _stops_in(document)
    names = document.get("holders", {})
    for text in sorted(set(names.values())):
        holder = workspace.store.path(ProductRef.of_text(text)).read_text()
        held = _stops_in(json.loads(holder))
        stops |= {
            place: stop
            for place, stop in held.items()
            if place not in stops and names.get(_name_of(stop[0])) == text
        }
    return stops


def _stops_in(document: dict[str, Any]) -> _Stops:
    adjusted = {(stop["site"], stop["drive"]): stop for stop in document["network"]["stops"]}
    return {
        (row["site"], row["drive"]): (row, adjusted[row["site"], row["drive"]])
        for row in document["stops"]
    }


def _name_of(stop: dict[str, Any]) -> str:
    """Text of the identifier, as of `StopId`."""
    return f"{stop['mission'].lower()}-site{stop['site']:04d}-drive{stop['drive']:04d}"


def _position_row(stop: dict[str, Any], adjusted: dict[str, Any]) -> dict[str, Any]:
    pose, covariance = adjusted["lsl_from_rover"], adjusted["covariance"]
    return {
        "mission": stop["mission"],
        "site": stop["site"],
        "drive": stop["drive"],
        "stop": _name_of(stop),
        "sols": stop["sols"],
        "telemetry_ned_m": stop["telemetry"]["translation_m"],
        "adjusted_ned_m": pose["translation_m"],
        "adjusted_quaternion": pose["quaternion"],
        "sigma_ned_m": [math.sqrt(max(covariance[k][k], 0.0)) for k in (3, 4, 5)],
        "covariance": covariance,
        "held": adjusted["held"],
        "held_by": adjusted["held_by"],
    }


def latest_networks(workspace: Workspace) -> list[ProductRef]:
    """The network of the last sol of every mission."""
    latest: dict[str, ProductRef] = {}
    for ref in workspace.catalogue.pointers(ProductKind.NETWORK):
        mission, _, _ = ref.scope.name.rpartition("-sol")
        if mission not in latest or latest[mission].scope.name < ref.scope.name:
            latest[mission] = ref
    return [latest[mission] for mission in sorted(latest)]


def product_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """One row per published product: layers, then the browse images."""
    proj4 = {entry.mission: crs_text(entry.landing) for entry in workspace.catalogue.missions()}
    layers = [_layer_row(layer, proj4, workspace) for layer in workspace.catalogue.layers()]
    return layers + [_browse_row(entry, workspace) for entry in workspace.catalogue.images()]


def _layer_row(layer: Layer, proj4: dict[str, str], workspace: Workspace) -> dict[str, Any]:
    return {
        "kind": str(layer.ref.kind),
        "scope": layer.ref.scope.name,
        "level": str(layer.ref.scope.level),
        "mission": layer.mission,
        "sols": list(layer.sols),
        "path": str(workspace.store.address(layer.ref)),
        "crs": _crs(layer, proj4[layer.mission]),
        "cell_m": layer.cell_m,
        "made_at": layer.made_at,
    }


def _crs(layer: Layer, local: str) -> str | None:
    """Coordinate reference system of a layer's file; coordinates of a panorama are angles."""
    if layer.type == "panorama":
        return None
    return MARS if layer.type == "vector" else local


def _browse_row(entry: ImageEntry, workspace: Workspace) -> dict[str, Any]:
    return {
        "kind": str(entry.browse.kind),
        "scope": entry.browse.scope.name,
        "level": str(entry.browse.scope.level),
        "mission": entry.mission,
        "sols": [entry.sol],
        "path": str(workspace.store.address(entry.browse)),
        "crs": None,
        "cell_m": None,
        "made_at": workspace.store.made_at(entry.browse),
    }


def outcome_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """One row per file or sol: the outcome of its last processing.

    Mission and sols are None and empty for others, such as files that are not images.
    """
    images = {image.id: image for image in workspace.catalogue.images()}
    return [
        {
            "subject": outcome.subject,
            **_mission_and_sols(outcome.subject, images),
            "ended": "failed" if outcome.is_failure else "done",
            "notes": list(outcome.notes),
            "at": outcome.at,
        }
        for outcome in workspace.catalogue.outcomes()
    ]


def report_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """One row per adjustment, in the order of the sols: page, figures and time."""
    figures = {ref.scope: ref for ref in workspace.catalogue.pointers(ProductKind.QUALITY)}
    return [
        {
            "adjustment": page.scope.name,
            **_mission_and_sols(page.scope.name),
            "page": str(workspace.store.path(page)),
            "figures": _path(figures.get(page.scope), workspace),
            "made_at": workspace.store.made_at(page),
        }
        for page in workspace.catalogue.pointers(ProductKind.REPORT)
    ]


def write_sol_report(mission: str, sol: int, workspace: Workspace, path: Path) -> None:
    """Write the report of a sol as one page; links lead to the map's server.

    A file that ends in `.pdf` becomes a PDF with figures of the maps.

    Raises:
        ProductNotFoundError: the store has no image of that sol.
    """
    from solmap.products.reports.sol_pdf import sol_pdf  # noqa: PLC0415 - slow to import
    from solmap.products.reports.sol_report import sol_report  # noqa: PLC0415 - slow to import

    if path.suffix.lower() == ".pdf":
        path.write_bytes(sol_pdf(mission, sol, workspace))
        return
    path.write_text(sol_report(mission, sol, workspace, Settings().map_url), encoding="utf-8")


def timing_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """Time and memory of all products of the store, one row per kind, the longest first."""
    from solmap.products.reports.sol_report import timings  # noqa: PLC0415 - slow to import

    return [asdict(row) for row in timings(list(workspace.store.refs()), workspace)]


def rig_correction_rows(workspace: Workspace, mission: str | None = None) -> list[dict[str, Any]]:
    """Differences of stereo rigs from the labels, four rows per camera set; all missions, or one.

    Raises:
        ConfigError: the pipeline of the settings cannot be read.
        ProductNotFoundError: there is no such mission, or no network of it.
        AdjustmentError: a network cannot be adjusted, or determines no correction.
    """
    from solmap.config.pipeline import load_pipeline  # noqa: PLC0415 - slow to import
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


def _mission_and_sols(
    subject: str, images: Mapping[str, ImageEntry] = MappingProxyType({})
) -> dict[str, Any]:
    """Mission and sols of an image file or a scope such as `mer2-sol0156`; else None and empty."""
    image = images.get(subject.partition(".")[0].upper())
    if image is not None:
        return {"mission": image.mission, "sols": [image.sol]}
    sol = re.match(r"(.+)-sol(\d+)", subject)
    mission = sol[1] if sol else subject.rpartition("-")[0]
    return {
        "mission": mission.upper() if mission and subject.islower() else None,
        "sols": [int(sol[2])] if sol else [],
    }


def _path(ref: ProductRef | None, workspace: Workspace) -> str | None:
    return str(workspace.store.path(ref)) if ref else None
