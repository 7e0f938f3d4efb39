"""A mission that was adjusted twice: layers of two solutions whose values are known.

The bowl's mission is adjusted stepwise, then overall, which moves its second stop by half a metre.
Both stops are mapped by either; the first did not move, so that its map is one and the same.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedPair,
    AdjustedStop,
    AdjustedTies,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.quality.movement import ReissueParams
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.imagery import StopId, TiePoints
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.adjusted_network import network_document
from solmap.products.formats.documents.archives import pose_document
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import summarise, write_raster
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.tasks.network.orientations import choose_orientations, read_orientations
from tests.support.bowl_store import CRS, STOPS, fill

GRID = MapGrid.covering((-40.0, -40.0, 40.0, 40.0), 0.16)
STEP_NED_M = (0.30, -0.40, 0.05)
"""By which the overall adjustment moved the second stop."""
OFF_M, TILT = 0.25, 0.01
"""The older map of the second stop is higher by 0.25 m + 1 % of east."""
GREYS = (60.0, 200.0)
"""Of its orthophoto, older and newer."""


@dataclass(frozen=True)
class Versions:
    """The two networks, oldest first, and the stop that stayed and the one that moved."""

    networks: tuple[ProductRef, ProductRef]
    stayed: str
    moved: str


def ground(*, older: bool) -> np.ndarray:
    """Elevation of the map by one of the solutions."""
    east, north = GRID.centres()
    plane = 0.05 * north[:, None] + 0.0 * east[None, :]
    return (plane + (OFF_M + TILT * east[None, :] if older else 0.0)).astype(np.float32)


def fill_versions(root: Path) -> Versions:
    """The bowl's store, with both stops' maps by one network and then by the other."""
    root.mkdir(parents=True, exist_ok=True)
    workspace = Workspace.open(root)
    fill(workspace)
    (stayed, *_), (moved, *_) = STOPS[:2]
    chosen, networks = None, []
    for name, is_older in (("mer2-sol0156", True), ("mer2-sol0156-overall", False)):
        network = _network(workspace, name, is_older=is_older)
        networks.append(network)
        chosen = choose_orientations.fn(network, chosen, ReissueParams(), workspace.store)
        workspace.catalogue.publish(pointers=[network, chosen])
        for stop, looked in read_orientations(chosen, workspace.store).items():
            off = is_older and stop == moved
            layers = _maps(workspace, stop, looked.orientations, older=off)
            workspace.catalogue.publish(layers=layers)
    return Versions((networks[0], networks[1]), stayed, moved)


def _network(workspace: Workspace, name: str, *, is_older: bool) -> ProductRef:
    stops, pairs, reported = [], [], []
    for number, (_, site, drive, (east, north), telemetry) in enumerate(STOPS[:2]):
        stop = StopId("MER2", site, drive)
        rover = rover_frame(site, drive)
        bar = Frame(FrameKind.PAIR, (site, drive, 0))
        step = np.array(STEP_NED_M) if number == 1 and is_older else np.zeros(3)
        place = np.array([north, east, 0.0]) + step
        lsl_from_rover = Pose(LSL, rover, np.eye(3), place)
        stops.append(
            AdjustedStop(
                stop, lsl_from_rover, 1e-4 * np.eye(6), number == 0, is_tied=True, held_by=""
            )
        )
        pair_id = f"2N{number}L"
        lsl_from_pair = Pose(LSL, bar, np.eye(3), place)
        rover_from_pair = Pose(rover, bar, np.eye(3), np.zeros(3))
        pairs.append(
            AdjustedPair(
                pair_id,
                stop,
                lsl_from_pair,
                rover_from_pair,
                np.zeros(3),
                1e-6 * np.eye(6),
                1e-8 * np.eye(3),
                0,
            )
        )
        where = np.array([telemetry[1], telemetry[0], 0.0])
        pose = Pose(LSL, rover, np.eye(3), where)
        message = {"mission": "MER2", "site": site, "drive": drive, "sols": [155 + number]}
        reported.append({**message, "telemetry": pose_document(pose)})
    network = AdjustedNetwork(tuple(stops), tuple(pairs), _no_ties(pairs))
    report = AdjustmentReport(name, converged=True, iterations=1, sigma0=1.0, redundancy=0,
                              stops=2, pairs=2)  # fmt: skip
    document = {
        "mission": "MER2", "sol": 156, "stops": reported, "reports": [name], "links": [],
        "network": network_document(network, [report]),
    }  # fmt: skip
    return workspace.store.make(
        Recipe(ProductKind.NETWORK, Scope(ScopeLevel.SOL, name)),
        lambda path: path.write_text(json.dumps(document)),
    )


def _no_ties(pairs: list[AdjustedPair]) -> AdjustedTies:
    empty, none = np.zeros(0), np.zeros(0, np.int32)
    points = TiePoints(
        tuple(pair.pair_id for pair in pairs), none, none, np.zeros((0, 2)), empty, empty, empty,
        empty,
    )  # fmt: skip
    of_rows = [np.zeros((0, 3)) for _ in range(3)]
    return AdjustedTies(points, np.zeros((0, 3)), np.zeros((0, 3, 3)), (), none, *of_rows)


def _maps(workspace: Workspace, stop: str, orientations, *, older: bool) -> list[Layer]:
    scope = Scope(ScopeLevel.STOP, stop)
    values = ground(older=older)
    dtm = workspace.store.make(
        Recipe(ProductKind.DTM, scope, (), ("a known plane", orientations)),
        lambda path: write_raster(path, GRID, {"elevation": values}, CRS, unit="m"),
    )
    image = np.full(values.shape, GREYS[0 if older else 1], np.float32)
    orthophoto = workspace.store.make(
        Recipe(ProductKind.ORTHOPHOTO, scope, (dtm,)),
        lambda path: write_orthophoto(path, GRID, image, CRS, stretch=(0.0, 254.0)),
    )
    return [_layer(ref, workspace) for ref in (dtm, orthophoto)]


def _layer(ref: ProductRef, workspace: Workspace) -> Layer:
    grid, bands = summarise(workspace.store.path(ref))
    facts = (grid.bounds, grid.cell_m, bands[0].unit or None, bands[0].range)
    made_at = workspace.store.made_at(ref)
    return Layer(ref, "MER2", str(ref.kind), "raster", *facts, (155,), made_at)
