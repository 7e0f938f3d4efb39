"""The table of a mission's stereo rigs: corrections by matching, and those by its latest network.

The network is that of an overall adjustment: all stops with their telemetry and control, and the
ties of the latest network, including those between stops. Images without a stereo partner have no
rig and are left out. Nothing is stored: the result is rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedNetwork
from solmap.photogrammetry.adjustment.model.datum import held_stops, with_control
from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.rig_calibration import (
    RigCorrection,
    calibrate_rig,
    parallax_partials,
)
from solmap.products.catalogue.catalogue import latest_network
from solmap.products.catalogue.images import image_records
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.archives import read_matches, read_right_turn
from solmap.products.formats.documents.control import read_control
from solmap.products.formats.documents.network import whole_network
from solmap.products.formats.documents.rig import RigProduct, read_rig
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.images.pairs import camera_set
from solmap.tasks.images.telemetry import read_telemetry, vector_files
from solmap.tasks.network.orientations import latest_rig
from solmap.tasks.scopes import pair_scope

COMPONENTS = ("rotation about x", "toe-in, about y", "rotation about z", "baseline")
"""Axes of the pair: x right along the baseline, y down, z forward."""
UNITS = ("degree", "degree", "degree", "mm")
SCALES = np.array([*3 * [np.degrees(1.0)], 1e3])
"""Factors from radians and metres to these units."""
STANDS_OUT = 3.0
"""Standard deviations from zero that occur by chance once in 370 times."""


@dataclass(frozen=True, slots=True)
class RigRow:
    """One component of the correction of a mission's camera set."""

    mission: str
    camera: str
    pairs: int
    """Stereo pairs of the camera set in the network."""
    pairs_rotated_by_matching: int
    """Number of these whose right camera was rotated by matching."""
    component: str
    unit: str
    applied: float
    """Correction of the labels by matching, at the mission's last stop with this camera set."""
    applied_sigma: float | None
    """Its standard deviation; None where unknown, and for the baseline."""
    value: float
    """Additional correction by the network."""
    sigma: float
    stands_out: bool
    """Whether it differs from zero by more than `STANDS_OUT` standard deviations."""
    parallax_px: float
    """Root mean square change of the parallaxes of the tie points."""
    sigma0_labelled: float
    """Sigma0 of the network with the rigs of the labels."""
    sigma0_corrected: float


@dataclass(frozen=True, slots=True, eq=False)
class _RigNetwork:
    """A mission's network, and the camera sets of its pairs."""

    network: Network
    adjusted: AdjustedNetwork
    instruments: Mapping[str, str]
    """Camera set by pair."""
    rotated: frozenset[str]
    """Pairs whose right camera was rotated by matching."""


def rig_rows(
    mission: str, control: Iterable[ProductRef], params: AdjustmentParams, workspace: Workspace
) -> list[RigRow]:
    """The correction of every camera set of a mission, one row per component.

    Args:
        mission: As in its labels: MER2.
        control: Published control of its stops.
        params: Of the adjustment.
        workspace: With the mission.

    Raises:
        ProductNotFoundError: the mission, its network, or the matches of a pair do not exist.
        AdjustmentError: the network cannot be adjusted, or determines no correction.
    """
    read = _read_rig_network(mission, control, params, workspace)
    network = read.network
    found = calibrate_rig(network, held_stops(network), read.instruments, params, read.adjusted)
    pairs = Counter(read.instruments.values())
    ref = latest_rig(mission, workspace)
    rig = read_rig(workspace.store.path(ref)) if ref else RigProduct()
    rotated = Counter(read.instruments[pair] for pair in read.rotated)
    return [
        RigRow(
            mission=mission,
            camera=one.instrument,
            pairs=pairs[one.instrument],
            pairs_rotated_by_matching=rotated[one.instrument],
            component=COMPONENTS[k],
            unit=UNITS[k],
            applied=applied[k],
            applied_sigma=applied_sigmas[k],
            value=float(value),
            sigma=float(sigma),
            stands_out=bool(abs(value) > STANDS_OUT * sigma),
            parallax_px=float(parallax),
            sigma0_labelled=found.as_labelled.sigma0,
            sigma0_corrected=found.corrected.sigma0,
        )
        for one in found.corrections
        for applied, applied_sigmas in [_applied(rig, one.instrument)]
        for k, (value, sigma, parallax) in enumerate(
            zip(one.values * SCALES, one.sigmas * SCALES, _parallax_px(one, read), strict=True)
        )
    ]


def _applied(rig: RigProduct, camera: str) -> tuple[list[float], list[float | None]]:
    """The four components applied by matching, and their standard deviations."""
    stop = next((name for name in reversed(tuple(rig.found)) if camera in rig.found[name]), "")
    known = rig.found.get(stop, {}).get(camera)
    turn = np.append(rig.applied_at(stop, camera), 0.0) * SCALES
    if known is None:
        return turn.tolist(), [None] * len(COMPONENTS)
    off = np.hypot(known.sigmas, known.rotation - turn[:3] / SCALES[:3])
    return turn.tolist(), [*(off * SCALES[:3]).tolist(), None]


def _read_rig_network(
    mission: str, control: Iterable[ProductRef], params: AdjustmentParams, workspace: Workspace
) -> _RigNetwork:
    catalogue, store = workspace.catalogue, workspace.store
    catalogue.mission(mission)
    adjusted = whole_network(latest_network(mission, catalogue), store).adjusted
    entries = {entry.id: entry for entry in catalogue.images(mission)}
    ties = adjusted.ties.observations
    measured = {ties.pair_ids[k] for k in np.unique(ties.pair[np.isfinite(ties.parallax_px)])}
    stereo = [pair for pair in adjusted.pairs if pair.pair_id in measured]
    paths = {pair.pair_id: store.path(_matches_of(pair.pair_id, workspace)) for pair in stereo}
    pairs = tuple(
        PairGeometry(pair.pair_id, pair.stop, read_matches(path)[0])
        for pair, path in zip(stereo, paths.values(), strict=True)
    )
    is_stereo = np.array([name in paths for name in ties.pair_ids], dtype=bool)
    rows = is_stereo[ties.pair] if len(ties) else np.zeros(0, dtype=bool)
    images = image_records(entries.values(), workspace)
    telemetry = read_telemetry(images, vector_files(mission, workspace))
    there = {stop.stop for stop in adjusted.stops}
    stops = tuple(stop for stop in telemetry.stops if stop.stop in there)
    network = Network(stops, pairs, select(ties, rows))
    for ref in control:
        frame, places = read_control(ref, store)
        if places:
            network = with_control(network, [frame], places, params)
    instruments = {pair: camera_set(entries[pair]) for pair in paths}
    rotated = frozenset(pair for pair, path in paths.items() if read_right_turn(path) is not None)
    return _RigNetwork(network, adjusted, instruments, rotated)


def _matches_of(pair_id: str, workspace: Workspace) -> ProductRef:
    scope = pair_scope(pair_id)
    digest = workspace.catalogue.latest(scope.name, ProductKind.MATCHES)
    if digest is None:
        raise ProductNotFoundError(
            f"no matches of pair {pair_id} are in the store, so the geometry of its rig is "
            "unknown; a mission simulated without images has none"
        )
    return ProductRef(ProductKind.MATCHES, scope, digest)


def _parallax_px(rig: RigCorrection, read: _RigNetwork) -> np.ndarray:
    """Root mean square change of the set's parallaxes by each component."""
    names = read.network.ties.pair_ids
    own = np.array([read.instruments[name] == rig.instrument for name in names], dtype=bool)
    partials = parallax_partials(read.network)[own[read.network.ties.pair]]
    return np.sqrt(np.mean(np.square(partials), axis=0)) * np.abs(rig.values)
