"""Residuals by camera and by place in its image.

A residual is measured minus computed. Were a camera's model wrong, the mean residual in a cell of
its image would stay, while that of n residuals that chance makes, each of standard deviation s, has
the standard deviation s / sqrt(n); so the grid of means shows what the sum of squares hides.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solmap.photogrammetry.adjustment.quality_records import (
    CameraResiduals,
    PairCamera,
    QualityParams,
    ResidualFigures,
    Triple,
)
from solmap.photogrammetry.adjustment.records import USED, AdjustedTies
from solmap.photogrammetry.imagery import TieKind


def tied_rows(ties: AdjustedTies, cameras: Mapping[str, PairCamera], instrument: str) -> np.ndarray:
    """Used observations of a camera; without points that one pair alone sees: they always fit."""
    of_pair = [cameras.get(name) for name in ties.observations.pair_ids]
    own = np.array([c is not None and c.instrument == instrument for c in of_pair], dtype=bool)
    tied = (ties.status == USED) & (ties.redundancy > 0).any(axis=1)
    return np.flatnonzero(tied & own[ties.observations.pair]) if len(own) else np.zeros(0, np.int64)


def image_size_px(cameras: Mapping[str, PairCamera], instrument: str) -> int:
    """Longest side of a camera's epipolar images."""
    views = [c for c in cameras.values() if c.instrument == instrument]
    return max(max(view.samples, view.lines) for view in views)


def camera_residuals(
    ties: AdjustedTies, cameras: Mapping[str, PairCamera], params: QualityParams
) -> tuple[CameraResiduals, ...]:
    """Residuals of the tied observations, camera by camera."""
    instruments = sorted({camera.instrument for camera in cameras.values()})
    rows = {name: tied_rows(ties, cameras, name) for name in instruments}
    return tuple(
        _of_camera(ties, rows[name], name, image_size_px(cameras, name), params)
        for name in instruments
        if len(rows[name])
    )


def _of_camera(
    ties: AdjustedTies,
    rows: np.ndarray,
    instrument: str,
    size_px: int,
    params: QualityParams,
) -> CameraResiduals:
    seen, n = ties.observations, params.grid_cells
    cell_px = size_px / n
    place = np.clip(np.floor(seen.left[rows] / cell_px).astype(np.int64), 0, n - 1)
    code = place[:, 1] * n + place[:, 0]
    sigma = np.column_stack([seen.sigma_px, seen.sigma_line_px, seen.sigma_parallax_px])[rows]
    v, weight = ties.residuals_px[rows], 1.0 / sigma**2
    grid = [
        _mean(v[code == k], weight[code == k]) if (code == k).sum() >= params.fewest_in_cell
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


def _triple(values: np.ndarray) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])
