"""Quality figures of an adjusted network (Di et al. 2008, sections 3.3 and 5).

Consistency in image and object space is measured while the network is adjusted (`consistency`).
Added here: internal precision (standard deviations of cameras and tie points from the covariance
matrix), residuals by camera and by position in the image, redundancy, the observations that were
set aside, the error ellipse of every stop, the agreement of control, and the weak parts of the
network.

A residual is measured minus computed. Random residuals of standard deviation s have a mean over n
of standard deviation s / sqrt(n); a wrong camera model leaves a larger mean in a cell of the image.
The grid of means therefore shows systematic errors that the sum of squares does not.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    BLUNDER,
    USED,
    AdjustedNetwork,
    AdjustedPair,
    AdjustedStop,
    AdjustedTies,
)
from solmap.photogrammetry.adjustment.model.network import MAP
from solmap.photogrammetry.adjustment.model.variance_components import (
    COMPONENTS,
    TIES,
    Component,
)
from solmap.photogrammetry.adjustment.quality.records import (
    Blunder,
    CameraResiduals,
    ComponentQuality,
    ControlQuality,
    FrameQuality,
    MastQuality,
    PairCamera,
    Precision,
    Quality,
    QualityParams,
    Redundancy,
    ResidualFigures,
    StopQuality,
    TiePrecision,
    Triple,
)
from solmap.photogrammetry.adjustment.quality.weaknesses import shared_ties, weaknesses
from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId, TieKind

GRID_CELLS = 8
"""Cells along the side of the grid in which residuals are averaged: patches of 128 pixels, the
coarsest grid that shows radial and bent patterns."""
FEWEST_IN_CELL = 5
"""Fewest observations of a cell whose mean is shown."""
UNCHECKED = 0.1
"""Redundancy number below which a coordinate counts as unchecked."""
ARCMINUTES = 60.0 * 180.0 / np.pi


def network_quality(
    network: AdjustedNetwork,
    telemetry: Mapping[StopId, Pose],
    cameras: Mapping[str, PairCamera],
    params: QualityParams,
) -> Quality:
    """The quality of a network; `cameras` by pair, `telemetry` by stop."""
    held = {stop.stop for stop in network.stops if stop.held}
    estimated = [pair for pair in network.pairs if pair.stop not in held]
    links = shared_ties(network)
    residuals = camera_residuals(network.ties, cameras)
    return Quality(
        stops=_stops(network, telemetry),
        precision=precision(estimated or list(network.pairs)),
        ties=_tie_precision(network.ties),
        redundancy=_redundancy(network.ties),
        cameras=residuals,
        blunders=blunders(network),
        links=links,
        weaknesses=weaknesses(network, links, residuals, params),
        control=control_quality(network),
        frames=frame_quality(network),
        components=component_quality(network),
        mast=mast_quality(network),
    )


def precision(pairs: list[AdjustedPair]) -> Precision | None:
    """Mean standard deviations of the cameras of some pairs."""
    if not pairs:
        return None
    variances = np.array([np.diagonal(pair.covariance) for pair in pairs])
    sigmas = np.sqrt(np.clip(variances, 0.0, None)).mean(axis=0)
    return Precision(len(pairs), _triple(1e3 * sigmas[3:]), _triple(ARCMINUTES * sigmas[:3]))


def blunders(network: AdjustedNetwork) -> tuple[Blunder, ...]:
    """The observations set aside, largest residual first."""
    ties, seen = network.ties, network.ties.observations
    stop_of = {pair.pair_id: pair.stop for pair in network.pairs}
    used_by_point: dict[int, set[str]] = {}
    rows = np.flatnonzero(ties.status == BLUNDER)
    rows_of_points = np.isin(seen.point, seen.point[rows]) & (ties.status == USED)
    for k in np.flatnonzero(rows_of_points).tolist():
        used_by_point.setdefault(int(seen.point[k]), set()).add(seen.pair_ids[seen.pair[k]])
    size = np.linalg.norm(np.nan_to_num(ties.residuals_px[rows]), axis=1)
    found = []
    for k in rows[np.argsort(-size, kind="stable")].tolist():
        pair_id, point = seen.pair_ids[seen.pair[k]], int(seen.point[k])
        if pair_id not in stop_of:
            continue  # of a stop that is marginalised
        found.append(
            Blunder(
                pair_id,
                stop_of[pair_id],
                point,
                (float(seen.left[k, 0]), float(seen.left[k, 1])),
                float(seen.parallax_px[k]),
                _triple(ties.residuals_px[k]),
                tuple(sorted(used_by_point.get(point, ()))),
            )
        )
    return tuple(found)


def error_ellipse(stop: AdjustedStop) -> tuple[tuple[float, float], float]:
    """Semi-axes of the 1-sigma error ellipse on the map, metres, and the major one's azimuth."""
    variances, axes = np.linalg.eigh(stop.covariance[3:5, 3:5])
    north, east = axes[:, 1]
    minor, major = np.sqrt(np.clip(variances, 0.0, None)).tolist()
    return (major, minor), float(np.degrees(np.arctan2(east, north)) % 180.0)


def _stops(network: AdjustedNetwork, telemetry: Mapping[StopId, Pose]) -> tuple[StopQuality, ...]:
    places = np.array([s.lsl_from_rover.translation_m for s in network.stops]).reshape(-1, 3)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    by_stop: dict[StopId, list[AdjustedPair]] = {}
    for pair in network.pairs:
        by_stop.setdefault(pair.stop, []).append(pair)
    found = []
    for k, stop in enumerate(network.stops):
        axes_m, azimuth_deg = error_ellipse(stop)
        moved: Vector3 = places[k] - telemetry[stop.stop].translation_m
        found.append(
            StopQuality(
                stop.stop,
                stop.held_by,
                stop.is_tied,
                precision(by_stop.get(stop.stop, [])),
                axes_m,
                azimuth_deg,
                float(stop.sigma_ned_m[2]),
                float(np.linalg.norm(moved)),
                float(driven[k]),
            )
        )
    return tuple(found)


def _tie_precision(ties: AdjustedTies) -> dict[TieKind, TiePrecision]:
    variances = np.diagonal(ties.covariances, axis1=1, axis2=2)
    known = np.isfinite(variances).all(axis=1) & np.isfinite(ties.points).all(axis=1)
    sigmas = np.sqrt(np.clip(variances, 0.0, None))
    found = {}
    for kind in TieKind:
        rows = known & np.array([of == kind for of in ties.kinds], dtype=bool)
        if rows.any():
            median = _triple(np.median(sigmas[rows], axis=0))
            found[kind] = TiePrecision(int(rows.sum()), _triple(sigmas[rows].mean(axis=0)), median)
    return found


def _redundancy(ties: AdjustedTies) -> dict[TieKind, Redundancy]:
    """Redundancy by kind of tie, over the measured coordinates of used observations."""
    kinds = np.array([str(kind) for kind in ties.kinds], dtype=str)[ties.observations.point]
    measured = np.isfinite(ties.residuals_px) & (ties.status == USED)[:, None]
    found = {}
    for kind in (TieKind.INTER_STEREO, TieKind.CROSS_SITE):
        of_kind = measured & (kinds == str(kind))[:, None]
        numbers = ties.redundancy[of_kind]
        if len(numbers):
            observations = int(of_kind.any(axis=1).sum())
            unchecked = int((numbers < UNCHECKED).sum())
            found[kind] = Redundancy(observations, float(numbers.mean()), unchecked)
    return found


def _triple(values: np.ndarray) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])


def tied_rows(ties: AdjustedTies, cameras: Mapping[str, PairCamera], instrument: str) -> np.ndarray:
    """Used observations of a camera; without points that only one pair sees: they always fit."""
    of_pair = [cameras.get(name) for name in ties.observations.pair_ids]
    own = np.array([c is not None and c.instrument == instrument for c in of_pair], dtype=bool)
    tied = (ties.status == USED) & (ties.redundancy > 0).any(axis=1)
    return np.flatnonzero(tied & own[ties.observations.pair]) if len(own) else np.zeros(0, np.int64)


def image_size_px(cameras: Mapping[str, PairCamera], instrument: str) -> int:
    """Longest side of a camera's epipolar images."""
    views = [c for c in cameras.values() if c.instrument == instrument]
    return max(max(view.samples, view.lines) for view in views)


def camera_residuals(
    ties: AdjustedTies, cameras: Mapping[str, PairCamera]
) -> tuple[CameraResiduals, ...]:
    """Residuals of the tied observations, camera by camera."""
    instruments = sorted({camera.instrument for camera in cameras.values()})
    rows = {name: tied_rows(ties, cameras, name) for name in instruments}
    return tuple(
        _of_camera(ties, rows[name], name, image_size_px(cameras, name))
        for name in instruments
        if len(rows[name])
    )


def _of_camera(
    ties: AdjustedTies,
    rows: np.ndarray,
    instrument: str,
    size_px: int,
) -> CameraResiduals:
    seen, n = ties.observations, GRID_CELLS
    cell_px = size_px / n
    place = np.clip(np.floor(seen.left[rows] / cell_px).astype(np.int64), 0, n - 1)
    code = place[:, 1] * n + place[:, 0]
    sigma = np.column_stack([seen.sigma_px, seen.sigma_line_px, seen.sigma_parallax_px])[rows]
    v, weight = ties.residuals_px[rows], 1.0 / sigma**2
    grid = [
        _mean(v[code == k], weight[code == k]) if (code == k).sum() >= FEWEST_IN_CELL
        else None
        for k in range(n * n)
    ]  # fmt: skip
    kinds = np.array([str(kind) for kind in ties.kinds], dtype=str)[seen.point[rows]]
    return CameraResiduals(
        instrument,
        len(np.unique(seen.pair[rows])),
        {
            kind: _figures(ties, rows[kinds == str(kind)])
            for kind in TieKind
            if (kinds == str(kind)).any()
        },
        cell_px,
        tuple(tuple(grid[row * n : (row + 1) * n]) for row in range(n)),
    )


def _figures(ties: AdjustedTies, rows: np.ndarray) -> ResidualFigures:
    v, w = ties.residuals_px[rows], ties.standardised[rows]
    return ResidualFigures(
        observations=len(rows),
        mean_px=_mean(v, np.ones_like(v)),
        rms_px=_triple(np.sqrt(np.array(_mean(v**2, np.ones_like(v))))),
        rms_standardised=float(np.sqrt(np.nanmean(w**2))) if np.isfinite(w).any() else float("nan"),
    )


def _mean(values: np.ndarray, weight: np.ndarray) -> Triple:
    """Weighted mean of each coordinate, where it was measured."""
    weight = np.where(np.isfinite(values), weight, 0.0)
    total = weight.sum(axis=0)
    sums = (np.nan_to_num(values) * np.nan_to_num(weight)).sum(axis=0)
    with np.errstate(invalid="ignore"):
        return _triple(np.where(total > 0, sums / total, np.nan))


def control_quality(network: AdjustedNetwork) -> tuple[ControlQuality, ...]:
    """Every position of a stop in a control frame, the worst agreement first."""
    found = [
        ControlQuality(
            one.control.stop,
            one.control.frame,
            one.used,
            tuple(np.sqrt(np.diagonal(one.control.covariance)[:2]).tolist()),
            (float(one.residual[0]), float(one.residual[1])),
            one.test if np.isfinite(one.test) else None,
            one.redundancy,
            one.note,
        )
        for one in network.control
        if one.control.frame != MAP.name
    ]
    return tuple(sorted(found, key=lambda one: -(one.test or 0.0)))


def frame_quality(network: AdjustedNetwork) -> tuple[FrameQuality, ...]:
    """Position of every control frame."""
    found = []
    for adjusted in network.frames:
        if adjusted.frame.is_certain:
            continue
        place, sigma = adjusted.place, np.sqrt(np.clip(np.diagonal(adjusted.covariance), 0, None))
        found.append(
            FrameQuality(
                adjusted.frame.name,
                _triple(place),
                _triple(sigma),
                float(np.degrees(place[3])),
                float(np.degrees(sigma[3])),
                float(place[4]),
                float(sigma[4]),
            )
        )
    return tuple(found)


def component_quality(network: AdjustedNetwork) -> tuple[ComponentQuality, ...]:
    """Prior and estimate of the standard deviations of every kind of observation there is."""
    found, components = [], network.components
    for k, (component, sigma) in enumerate(components.sigmas.items()):
        redundancy = float(components.scatter.redundancy[k].sum())
        if redundancy > 0:
            unit = "of the standard deviations of matching" if k >= TIES else "degrees"
            unit = "of the drive" if component is Component.POSITION else unit
            prior = float(components.priors[k])
            found.append(ComponentQuality(COMPONENTS[k], unit, prior, sigma, redundancy))
    return tuple(found)


def mast_quality(network: AdjustedNetwork) -> tuple[MastQuality, ...]:
    """Systematic errors of the mast."""
    mast = network.mast
    names = ("elevation zero", "axis about x", "axis about y", "azimuth zero")
    sigmas = np.degrees(np.sqrt(np.clip(np.diagonal(mast.covariance), 0.0, None)))
    values = np.degrees(mast.values)
    return tuple(
        MastQuality(name, float(value), float(sigma))
        for name, value, sigma in zip(names, values, sigmas, strict=True)
        if sigma > 0
    )
