"""Rig: the rotation of right cameras applied by matching, one per camera set, pooled over stops.

First the rows of a sol's pairs, measured with the rigs of the labels, are added, and the pairs are
matched with the resulting rotations; then the ties within the sol's stops, which determine toe-in
(`adjustment.modes.rig_pooling`). Each product contains the observations of the last stops and the
applied rotations; that of a sol is made from the previous one, so that the same images lead to the
same rotations in any order of delivery.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.modes.rig_pooling import (
    CameraRows,
    NormalEquations,
    StopRig,
    correction_to_apply,
    pooled_rotations,
    stop_normal_equations,
    weigh_by_cells,
)
from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.matching.stereo.orientation import WRONG_RIG_PX, RowCells
from solmap.photogrammetry.matching.tracks import build_tie_points
from solmap.products.formats.documents.archives import (
    read_matches,
    read_right_turn,
    read_ties,
)
from solmap.products.formats.documents.rig import (
    PairRows,
    RigProduct,
    read_pair_rows,
    read_rig,
    write_rig,
)
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import Turn
from solmap.tasks.network.adjust import NetworkParams
from solmap.tasks.network.tie import StopProducts
from solmap.tasks.scopes import sol_scope
from solmap.tasks.stage import stage

log = logging.getLogger(__name__)

MOST_STOPS = 30
"""Number of the last stops over which rotations are pooled: stereo rigs change over the years."""


@stage(task_run_name="rig-sol{sol}")
def pool_rig(
    mission: str,
    sol: int,
    rows: tuple[ProductRef, ...],
    previous: ProductRef | None,
    store: ProductStore,
) -> ProductRef:
    """Add the rows of a sol's stops to the estimates of the stereo rigs; also returns the pairs."""

    def write(path: Path) -> None:
        before = read_rig(store.path(previous)) if previous else RigProduct()
        read = [read_pair_rows(store.path(ref)) for ref in rows]
        stops = dict(before.stops)
        for name in dict.fromkeys(pair.stop for pair in read):
            known = stops.pop(name, StopRig({}))
            stops[name] = replace(known, rows=_rows_of_stop([p for p in read if p.stop == name]))
        write_rig(path, _pooled(stops, before))

    inputs = (*((previous,) if previous else ()), *rows)
    return store.make(Recipe(ProductKind.RIG, sol_scope(mission, sol), inputs), write)


@stage(task_run_name="rig-ties-{previous.scope}")
def refine_rig(
    stops: tuple[StopTies, ...],
    previous: ProductRef,
    params: NetworkParams,
    store: ProductStore,
) -> ProductRef:
    """Add the ties within a sol's stops to the estimates of the stereo rigs."""

    def write(path: Path) -> None:
        before = read_rig(store.path(previous))
        known = dict(before.stops)
        for stop in stops:
            name = str(stop.products.stop)
            if name in known:
                known[name] = replace(known[name], ties=_ties_of_stop(stop, before, params, store))
        write_rig(path, _pooled(known, before))

    inputs = (previous, *(ref for stop in stops for ref in (*stop.products.inputs, stop.ties)))
    return store.make(Recipe(ProductKind.RIG, previous.scope, inputs, params), write)


@dataclass(frozen=True, slots=True)
class StopTies:
    """A matched stop and the ties of its pairs."""

    products: StopProducts
    ties: ProductRef


def turn_of_pair(pair: PairRows, rig: RigProduct) -> tuple[Turn | None, bool]:
    """Rotation of the right camera of a pair, and whether it is the pair's own.

    A pair whose rows contradict the pooled rotation gets a rotation by its own rows, with the
    toe-in of the camera set.
    """
    turn = rig.applied_at(pair.stop, pair.instrument)
    is_own = pair.rows is not None and abs(pair.rows.cells.median_px(turn)) > WRONG_RIG_PX
    if is_own and pair.rows:
        turn = pair.rows.cells.rotation_with(float(turn[1]))
    if not turn.any():
        return None, False
    x, y, z = (pair.rover_from_pair @ turn).tolist()
    return (x, y, z), is_own


def _rows_of_stop(pairs: list[PairRows]) -> dict[str, CameraRows]:
    """The rows of a stop by camera set, without pairs that contradict most of their set."""
    found: dict[str, CameraRows] = {}
    for camera in sorted({pair.instrument for pair in pairs}):
        rows = [pair.rows for pair in pairs if pair.instrument == camera and pair.rows]
        angles = np.array([one.cells.median_px(np.zeros(3)) / one.focal_px for one in rows])
        off = np.abs(angles - np.median(angles)) if rows else angles
        agree = [one for one, by in zip(rows, off, strict=True) if by * one.focal_px < WRONG_RIG_PX]
        if agree:
            finest = max(agree, key=lambda one: one.focal_px)
            cells = RowCells.together([one.cells for one in agree])
            known = [one.celsius for one in agree if one.celsius is not None]
            celsius = float(np.mean(known)) if known else None
            found[camera] = CameraRows(cells, len(agree), finest.focal_px, finest.samples, celsius)
    return found


def _ties_of_stop(
    stop: StopTies, rig: RigProduct, params: NetworkParams, store: ProductStore
) -> NormalEquations | None:
    """Normal equations of the ties within a stop; None where they determine nothing."""
    name, pairs = stop.products.stop, stop.products.pairs
    read = [(pair, *read_matches(path := store.path(pair.matches)), path) for pair in pairs]
    ties = weigh_by_cells(read_ties(store.path(stop.ties))[0])
    network = Network(
        (StopPrior(name, Pose(LSL, name.frame, np.eye(3), np.zeros(3))),),
        tuple(PairGeometry(pair.files.id, name, shape) for pair, shape, _, path in read),
        build_tie_points([matches for _, _, matches, _ in read], [ties], params.tracks),
    )
    instruments = {
        pair.files.id: pair.files.instrument
        for pair, shape, _, path in read
        if _is_turned_by(rig.applied_at(str(name), pair.files.instrument), shape, path)
    }
    applied = {camera: rig.applied_at(str(name), camera) for camera in set(instruments.values())}
    try:
        return stop_normal_equations(network, instruments, applied, params.adjustment)
    except AdjustmentError as error:
        log.info("%s does not determine the stereo rigs: %s", name, error)
        return None


def _is_turned_by(rotation: Vector3, shape: EpipolarPair, matches: Path) -> bool:
    """Whether a pair was matched with this rotation, and not with its own."""
    turn = np.array(read_right_turn(matches) or (0.0, 0.0, 0.0))
    return bool(np.allclose(shape.rover_from_pair.rotation.T @ turn, rotation, rtol=0, atol=1e-5))


def _pooled(stops: Mapping[str, StopRig], before: RigProduct) -> RigProduct:
    """The estimates with these stops, and the applied corrections."""
    last = dict(list(stops.items())[-MOST_STOPS:])
    found = pooled_rotations(last)
    applied = {stop: dict(turns) for stop, turns in before.applied.items()}
    latest: dict[str, Vector3] = {}
    for turns in before.applied.values():
        latest |= turns
    for stop, cameras in found.items():
        is_new = stop not in before.stops
        for camera, rotation in cameras.items():
            start = latest.get(camera, np.zeros(3)) if is_new else before.applied_at(stop, camera)
            turn = correction_to_apply(rotation, start, last[stop].rows[camera])
            if turn.any():
                applied.setdefault(stop, {})[camera] = turn
    return RigProduct(last, found, applied)
