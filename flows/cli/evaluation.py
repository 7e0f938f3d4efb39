"""Evaluate a store against the truth of a simulated world: positions, attitudes and terrain.

Truth is never an input of the pipeline; this is how its errors are stated.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from scipy.spatial.transform import Rotation

from solmap.flows.cli.tables import position_rows
from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.frames import rotation_of_quaternion
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import ProductKind

RANGE_BANDS_M = ((0, 10), (10, 20), (20, 30), (30, 40))
"""Ranges for which stereo errors are usually tabulated."""


@dataclass(frozen=True, slots=True)
class TrueStop:
    """True pose of a stop."""

    site: int
    drive: int
    position: np.ndarray
    rotation: np.ndarray


def true_stops(truth_dir: Path) -> list[TrueStop]:
    """The stops of `truth.json`, in the order of the traverse."""
    stops = json.loads((truth_dir / "truth.json").read_text())["stops"]
    return [
        TrueStop(
            row["site"],
            row["drive"],
            np.array(row["position"]),
            rotation_of_quaternion(np.array(row["rover_to_lsl_quaternion_wxyz"])),
        )
        for row in stops
    ]


def evaluate_positions(rows: list[dict[str, Any]], stops: list[TrueStop]) -> list[dict[str, Any]]:
    """Errors of telemetry and adjustment, one row per stop.

    Percent is of the distance driven so far. `nees` is the squared error of attitude and position
    in units of the stated covariance, divided by its six degrees of freedom: 1 on average if the
    covariance is true.

    Args:
        rows: as `position_rows` lists them.
        stops: the truth.
    """
    errors, driven_m, before = [], 0.0, None
    by_name = {(row["site"], row["drive"]): row for row in rows}
    for stop in stops:
        if before is not None:
            driven_m += float(np.linalg.norm(stop.position - before))
        before = stop.position
        row = by_name.get((stop.site, stop.drive))
        if row is None:
            continue
        adjusted = rotation_of_quaternion(np.array(row["adjusted_quaternion"]))
        azimuth_deg, tilt_deg = attitude_error_deg(adjusted, stop.rotation)
        error = np.subtract(row["adjusted_ned_m"], stop.position)
        errors.append(
            {
                "stop": row["stop"],
                "driven_m": round(driven_m, 2),
                "telemetry_error_m": _length(np.subtract(row["telemetry_ned_m"], stop.position)),
                "adjusted_error_m": _length(error),
                "percent": round(100 * _length(error) / driven_m, 3) if driven_m else None,
                "azimuth_error_deg": azimuth_deg,
                "tilt_error_deg": tilt_deg,
                "error_ned_m": [round(float(value), 4) for value in error],
                "sigma_ned_m": [round(value, 4) for value in row["sigma_ned_m"]],
                "nees": _nees(row, error, adjusted @ stop.rotation.T),
                "held_by": row["held_by"],
            }
        )
    return errors


def evaluate_terrain(workspace: Workspace, truth_dir: Path) -> list[dict[str, Any]]:
    """Vertical errors of every stop's terrain model by range from the rover, one row per band."""
    errors = []
    for row in position_rows(workspace):
        try:
            layer = workspace.catalogue.layer(row["stop"], ProductKind.DTM)
        except ProductNotFoundError:
            continue
        dtm = read_dtm(workspace.store.path(layer.ref))
        errors += _bands(row["stop"], row["adjusted_ned_m"], dtm, truth_dir / "dtm.tif")
    return errors


def _bands(stop: str, ned_m: list[float], dtm: Dtm, truth: Path) -> list[dict[str, Any]]:
    errors = dtm.elevation - true_elevation(dtm, truth)
    east, north = dtm.grid.centres()
    range_m = np.hypot(north[:, None] - ned_m[0], east[None, :] - ned_m[1])
    rows = []
    for low, high in RANGE_BANDS_M:
        cells = np.isfinite(errors) & (range_m >= low) & (range_m < high)
        if not cells.any():
            continue
        size, sigma = np.abs(errors[cells]), dtm.sigma_m[cells]
        rows.append(
            {
                "stop": stop,
                "range_m": [low, high],
                "cells": int(cells.sum()),
                "median_m": round(float(np.median(size)), 4),
                "p90_m": round(float(np.percentile(size, 90)), 4),
                "bias_m": round(float(np.median(errors[cells])), 4),
                "within_sigma": [round(float((size <= k * sigma).mean()), 3) for k in (1, 2, 3)],
            }
        )
    return rows


def true_elevation(dtm: Dtm, truth: Path) -> Raster:
    """The true elevation at the cells of a terrain model; NaN beyond the truth."""
    with rasterio.open(truth) as dataset:
        elevation = dataset.read(1)
        transform = dataset.transform
    east, north = dtm.grid.centres()
    cols = np.floor((east - transform.c) / transform.a).astype(int)
    rows = np.floor((north - transform.f) / transform.e).astype(int)
    inside_cols = (cols >= 0) & (cols < elevation.shape[1])
    inside_rows = (rows >= 0) & (rows < elevation.shape[0])
    true = np.full(dtm.grid.shape, np.nan, dtype=np.float32)
    true[np.ix_(inside_rows, inside_cols)] = elevation[np.ix_(rows[inside_rows], cols[inside_cols])]
    return true


def _nees(row: dict[str, Any], error_m: np.ndarray, turn: np.ndarray) -> float | None:
    """None for the datum, which has no covariance."""
    covariance = np.array(row["covariance"])
    if not covariance.any():
        return None
    error = np.concatenate([Rotation.from_matrix(turn).as_rotvec(), error_m])
    return round(float(error @ np.linalg.solve(covariance, error)) / len(error), 3)


def attitude_error_deg(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Errors of azimuth and of tilt: the rotation about the vertical, and the remainder."""
    turn = Rotation.from_matrix(found @ true.T).as_rotvec()
    azimuth, tilt = np.rad2deg([turn[2], np.hypot(turn[0], turn[1])])
    return round(float(azimuth), 4), round(float(tilt), 4)


def _length(vector: np.ndarray) -> float:
    return round(float(np.linalg.norm(vector)), 4)
