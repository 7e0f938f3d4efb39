"""The image network: its graph of stops and pairs, and the tie points of an image with residuals.

Nodes are stops or pairs, edges the tie points they share. Weaknesses are those of
`photogrammetry.adjustment`: stops that only telemetry holds, links that rest on few ties, pairs
that no tie joins to another.

Ties are measured in the epipolar images of a pair. Observed and computed places are triangulated
along the label's own rays and projected with the camera of the image as stored; the difference of
both is the residual in that image.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import TIE_STATUS, UNITS, NetworkUsed, json_number
from solmap.gis_server.analysis.scene import Place, on_map
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    BLUNDER,
    USED,
    AdjustedNetwork,
    AdjustedPair,
    AdjustedTies,
)
from solmap.photogrammetry.adjustment.quality.records import QualityParams
from solmap.photogrammetry.adjustment.quality.weaknesses import Links, shared_ties, weaknesses
from solmap.photogrammetry.arrays import Float64, ImagePoints, Int32
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, single_image
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.imagery import Eye, RoverImage
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission, geometry_of, matches_of
from solmap.products.formats.documents.network import NetworkProduct
from solmap.products.model import ProductRef

MOST_PAIRS = 2000
"""Most pairs and single images of one response."""
_FAR_M = 1e4
"""Assumed range of a point without a position."""


class StopNode(BaseModel):
    """A stop and what holds it."""

    stop: str
    label: str
    sols: tuple[int, ...]
    place: Place
    pairs: int
    """Stereo pairs and single images of the stop that are in the network."""
    held_by: str
    is_tied: bool
    weak: list[str]
    """Why it is weak; empty if it is well determined."""


class LinkEdge(BaseModel):
    """Two stops and the tie points they share."""

    one: str
    other: str
    ties: int
    tried: str | None
    """Result of the search for ties, as text; null: it was made on an earlier sol."""
    weak: list[str]


class Weak(BaseModel):
    """A weak part of the network."""

    what: str
    why: str


class Agreement(BaseModel):
    """Mean difference between positions of the same points from two pairs."""

    comparisons: int
    mean_2d_px: float | None
    mean_3d_m: float | None


class Adjustment(BaseModel):
    """Figures of the adjustment; ties and agreement by kind of tie point."""

    converged: bool
    iterations: int
    sigma0: float | None
    """Standard deviation of unit weight; 1 when all stated standard deviations are true."""
    redundancy: int
    pairs: int
    ties: dict[str, int]
    blunders: int
    """Observations set aside."""
    control: int
    """Number of positions in control frames that were used."""
    before: dict[str, Agreement]
    after: dict[str, Agreement]
    message: str


class NetworkGraph(BaseModel):
    """All stops and the links between them."""

    units: str = UNITS
    network: NetworkUsed
    adjustment: Adjustment
    few_ties: int
    """A link with fewer ties is weak."""
    stops: list[StopNode]
    links: list[LinkEdge]
    weaknesses: list[Weak]


class PairNode(BaseModel):
    """A stereo pair, named by its left image, or an image without partner."""

    id: str
    stop: str
    sol: int | None
    instrument: str | None
    azimuth_deg: float
    elevation_deg: float
    """Elevation of its viewing direction."""
    ties: int
    """Observations that join it to others."""
    blunders: int
    weak: list[str]


class PairEdge(BaseModel):
    """Two pairs and the tie points they share."""

    one: str
    other: str
    ties: int


class PairGraph(BaseModel):
    """The pairs of a stop, and the pairs of other stops that share ties with them."""

    network: NetworkUsed
    stop: str
    pairs: list[PairNode]
    edges: list[PairEdge]


@lru_cache(maxsize=4)
def _assess(network: NetworkProduct) -> tuple[Links, tuple[Weak, ...]]:
    """Links and weaknesses of a network, cached because it never changes."""
    links = shared_ties(network.adjusted)
    found = weaknesses(network.adjusted, links, (), QualityParams())
    return links, tuple(Weak(what=one.what, why=one.why) for one in found)


@lru_cache(maxsize=4)
def _shared_by_pairs(network: NetworkProduct) -> dict[tuple[str, str], int]:
    return shared_by_pairs(network.adjusted)


def network_graph(ref: ProductRef, network: NetworkProduct) -> NetworkGraph:
    """The stops of a network and their links."""
    adjusted, params = network.adjusted, QualityParams()
    links, weak = _assess(network)
    pairs = Counter(str(pair.stop) for pair in adjusted.pairs)
    return NetworkGraph(
        network=NetworkUsed.of(ref),
        adjustment=Adjustment.model_validate(network.report),
        few_ties=params.few_ties,
        stops=[
            StopNode(
                stop=str(stop.stop),
                label=f"{stop.stop.site}/{stop.stop.drive}",
                sols=network.sols[stop.stop],
                place=on_map(stop.lsl_from_rover.translation_m),
                pairs=pairs[str(stop.stop)],
                held_by=stop.held_by,
                is_tied=stop.is_tied or stop.held,
                weak=_why(weak, str(stop.stop)),
            )
            for stop in adjusted.stops
        ],
        links=_links(links, network.links, weak, params.few_ties),
        weaknesses=list(weak),
    )


def _links(
    links: Links, tried: tuple[dict[str, Any], ...], weak: Sequence[Weak], few: int
) -> list[LinkEdge]:
    """Links with ties, and those that were searched without finding any."""
    reasons = {(row["earlier"], row["later"]): str(row["reason"]) for row in tried}
    counts = {(str(one), str(other)): count for (one, other), count in links.items()}
    names = list(counts) + [
        pair for pair in reasons if pair not in counts and pair[::-1] not in counts
    ]
    edges = []
    for one, other in names:
        ties = counts.get((one, other), 0)
        why = _why(weak, f"link {one} - {other}")
        if ties == 0:
            why = [f"no tie was found that holds; {few} make a link"]
        reason = reasons.get((one, other)) or reasons.get((other, one))
        edges.append(LinkEdge(one=one, other=other, ties=ties, tried=reason, weak=why))
    return edges


def pair_graph(
    ref: ProductRef, network: NetworkProduct, stop: str, entries: Mapping[str, ImageEntry]
) -> PairGraph:
    """The pairs of a stop and the pairs tied to them; `entries` by image identifier."""
    adjusted = network.adjusted
    own = {pair.pair_id for pair in adjusted.pairs if str(pair.stop) == stop}
    edges = [
        PairEdge(one=one, other=other, ties=count)
        for (one, other), count in _shared_by_pairs(network).items()
        if one in own or other in own
    ]
    shown = own | {name for edge in edges for name in (edge.one, edge.other)}
    _, weak = _assess(network)
    blunders = _count_blunders(adjusted)
    nodes = [
        _pair_node(pair, entries.get(pair.pair_id), blunders[pair.pair_id], weak)
        for pair in adjusted.pairs
        if pair.pair_id in shown
    ]
    return PairGraph(network=NetworkUsed.of(ref), stop=stop, pairs=nodes[:MOST_PAIRS], edges=edges)


def shared_by_pairs(network: AdjustedNetwork) -> dict[tuple[str, str], int]:
    """Number of tie points shared by each two pairs, from used observations."""
    ties, seen = network.ties, network.ties.observations
    rows = np.flatnonzero(ties.status == USED)
    met = np.unique(np.column_stack([seen.point[rows], seen.pair[rows]]), axis=0)
    counts: dict[tuple[str, str], int] = {}
    for lag in range(1, len(met)):
        same = met[lag:, 0] == met[:-lag, 0]
        if not same.any():
            break
        couples = np.column_stack([met[:-lag, 1], met[lag:, 1]])[same]
        for (a, b), n in zip(*np.unique(couples, axis=0, return_counts=True), strict=True):
            couple = (seen.pair_ids[a], seen.pair_ids[b])
            counts[couple] = counts.get(couple, 0) + int(n)
    return counts


def _count_blunders(network: AdjustedNetwork) -> Counter[str]:
    ties, seen = network.ties, network.ties.observations
    numbers = np.bincount(seen.pair[ties.status == BLUNDER], minlength=len(seen.pair_ids))
    return Counter(dict(zip(seen.pair_ids, numbers.tolist(), strict=True)))


def _pair_node(
    pair: AdjustedPair, entry: ImageEntry | None, blunders: int, weak: Sequence[Weak]
) -> PairNode:
    east, north, up = (MAP_FROM_LSL @ pair.lsl_from_pair.rotation[:, 2]).tolist()
    return PairNode(
        id=pair.pair_id,
        stop=str(pair.stop),
        sol=entry.sol if entry else None,
        instrument=entry.instrument if entry else None,
        azimuth_deg=round(float(np.degrees(np.arctan2(east, north))) % 360.0, 2),
        elevation_deg=round(float(np.degrees(np.arcsin(np.clip(up, -1.0, 1.0)))), 2),
        ties=pair.ties,
        blunders=blunders,
        weak=_why(weak, f"pair {pair.pair_id}"),
    )


def _why(weak: Sequence[Weak], what: str) -> list[str]:
    return [one.why for one in weak if one.what == what]


class ImageTie(BaseModel):
    """A tie point in an image."""

    point: int
    """Its number in the network."""
    kind: str
    sample: float
    line: float
    residual_sample_px: float | None
    residual_line_px: float | None
    """Measured less computed."""
    standardised: float | None
    """Largest residual over its own standard deviation; null: nothing checks it."""
    status: str
    """used; blunder: set aside; unused: not placed."""
    pairs: list[str]
    """Other pairs, by their left images, with used observations of the point."""
    place: tuple[float, float, float] | None
    """(east, north, up) as adjusted."""
    sigma_m: float | None
    """Root of the trace of its covariance."""


class ImageTies(BaseModel):
    """The tie points of an image."""

    units: str = UNITS
    image: str
    network: NetworkUsed
    samples: int
    lines: int
    ties: list[ImageTie]


def image_ties(entry: ImageEntry, mission: OrientedMission) -> ImageTies:
    """The tie points of an image in the latest network."""
    network, image = mission.network, mission.record(entry)
    pair = mission.pair_of(entry)
    rows = np.zeros(0, dtype=np.intp)
    if pair is not None:
        rows = _rows_of(pair.pair_id, network)
    ties = network.adjusted.ties
    if entry.eye == Eye.RIGHT:
        rows = rows[np.isfinite(ties.observations.parallax_px[rows])]
    geometry = _geometry(entry, image, mission) if len(rows) else None
    return ImageTies(
        image=entry.id,
        network=NetworkUsed.of(mission.ref),
        samples=image.samples,
        lines=image.lines,
        ties=[] if geometry is None else _ties(rows, ties, geometry, image),
    )


def _rows_of(pair_id: str, network: NetworkProduct) -> np.ndarray:
    seen = network.adjusted.ties.observations
    if pair_id not in seen.pair_ids:
        return np.zeros(0, dtype=np.intp)
    return np.flatnonzero(seen.pair == seen.pair_ids.index(pair_id))


def _geometry(entry: ImageEntry, image: RoverImage, mission: OrientedMission) -> EpipolarPair:
    """The epipolar geometry that the image's ties were measured in."""
    matches = matches_of(entry, mission.workspace) if entry.partner else None
    if matches is None:
        size = image.samples, image.lines
        return single_image(image.camera, size, image.stop.frame, image.stop.frame)
    return geometry_of(matches, mission.workspace)


def to_stored_image(
    left: ImagePoints,
    parallax_px: Float64[np.ndarray, " n"],
    geometry: EpipolarPair,
    camera: CameraModel,
) -> ImagePoints:
    """Points of the left epipolar image in an image of the pair as stored.

    A point without parallax is placed far away on its ray; in the left image its distance does not
    matter.
    """
    far = geometry.focal_px * geometry.base_m / _FAR_M
    known = np.where(np.isfinite(parallax_px) & (parallax_px > 0), parallax_px, far)
    points = geometry.triangulate(left, known)
    return camera.project(geometry.rover_from_pair.apply(points))


def _ties(
    rows: Int32[np.ndarray, " n"] | np.ndarray,
    ties: AdjustedTies,
    geometry: EpipolarPair,
    image: RoverImage,
) -> list[ImageTie]:
    seen = ties.observations
    left, parallax, residual = seen.left[rows], seen.parallax_px[rows], ties.residuals_px[rows]
    observed = to_stored_image(left, parallax, geometry, image.camera)
    moved = parallax - np.nan_to_num(residual[:, 2])
    computed = to_stored_image(left - residual[:, :2], moved, geometry, image.camera)
    others = _others(rows, ties)
    return [
        _tie(int(row), observed[k], (observed - computed)[k], ties, others)
        for k, row in enumerate(rows.tolist())
        if np.isfinite(observed[k]).all()
    ]


def _others(rows: np.ndarray, ties: AdjustedTies) -> dict[int, list[tuple[int, str]]]:
    """By point, the used observations and the pairs that contain them."""
    seen = ties.observations
    rows_of_points = np.flatnonzero(np.isin(seen.point, seen.point[rows]) & (ties.status == USED))
    found: dict[int, list[tuple[int, str]]] = {}
    for row in rows_of_points.tolist():
        found.setdefault(int(seen.point[row]), []).append((row, seen.pair_ids[seen.pair[row]]))
    return found


def _tie(
    row: int,
    observed: np.ndarray,
    residual: np.ndarray,
    ties: AdjustedTies,
    others: dict[int, list[tuple[int, str]]],
) -> ImageTie:
    index = int(ties.observations.point[row])
    standardised = np.abs(ties.standardised[row])
    point = MAP_FROM_LSL @ ties.points[index]
    is_placed = bool(np.isfinite(point).all())
    variance = float(np.trace(ties.covariances[index]))
    east, north, up = np.round(np.nan_to_num(point), 4).tolist()
    return ImageTie(
        point=index,
        kind=str(ties.kinds[index]),
        sample=round(float(observed[0]), 3),
        line=round(float(observed[1]), 3),
        residual_sample_px=json_number(residual[0]),
        residual_line_px=json_number(residual[1]),
        standardised=json_number(float(np.nanmax(standardised)), 3)
        if np.isfinite(standardised).any()
        else None,
        status=TIE_STATUS[int(ties.status[row])],
        pairs=[pair for other, pair in others.get(index, []) if other != row],
        place=(east, north, up) if is_placed else None,
        sigma_m=json_number(np.sqrt(max(variance, 0.0)) if np.isfinite(variance) else None),
    )
