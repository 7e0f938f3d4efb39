"""The tie points of an image, in pixels of the image as stored, with their residuals.

Ties are measured in the epipolar images of a pair. Observed and computed places go from there into
space along the label's own rays and back through the camera of the image as stored; what differs
between both is the residual in that image.
"""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import UNITS, NetworkUsed, number
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    BLUNDER,
    UNUSED,
    USED,
    AdjustedTies,
)
from solmap.photogrammetry.arrays import Float64, ImagePoints, Int32
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, single_image
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.imagery import Eye, RoverImage
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission, geometry_of, matches_of
from solmap.products.formats.documents.network import NetworkProduct

_FAR_M = 1e4
"""How far away a point that has no place is taken to lie."""
_STATUS = {USED: "used", BLUNDER: "blunder", UNUSED: "unused"}


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
    """Other pairs, by their left images, whose observations of the point stand."""
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


def in_stored_image(
    left: ImagePoints,
    parallax_px: Float64[np.ndarray, " n"],
    geometry: EpipolarPair,
    camera: CameraModel,
) -> ImagePoints:
    """Points of the left epipolar image in an image of the pair as stored.

    Where there is no parallax the point lies far away on its ray; in the left image its distance
    does not matter.
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
    observed = in_stored_image(left, parallax, geometry, image.camera)
    moved = parallax - np.nan_to_num(residual[:, 2])
    computed = in_stored_image(left - residual[:, :2], moved, geometry, image.camera)
    others = _others(rows, ties)
    return [
        _tie(int(row), observed[k], (observed - computed)[k], ties, others)
        for k, row in enumerate(rows.tolist())
        if np.isfinite(observed[k]).all()
    ]


def _others(rows: np.ndarray, ties: AdjustedTies) -> dict[int, list[tuple[int, str]]]:
    """By point: the used observations and the pairs they are in."""
    seen = ties.observations
    wanted = np.flatnonzero(np.isin(seen.point, seen.point[rows]) & (ties.status == USED))
    found: dict[int, list[tuple[int, str]]] = {}
    for row in wanted.tolist():
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
        residual_sample_px=number(residual[0]),
        residual_line_px=number(residual[1]),
        standardised=number(float(np.nanmax(standardised)), 3)
        if np.isfinite(standardised).any()
        else None,
        status=_STATUS[int(ties.status[row])],
        pairs=[pair for other, pair in others.get(index, []) if other != row],
        place=(east, north, up) if is_placed else None,
        sigma_m=number(np.sqrt(max(variance, 0.0)) if np.isfinite(variance) else None),
    )
