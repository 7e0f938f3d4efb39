"""Stereo rigs as JSON: rows of pairs, and the estimated rotations of a mission's rigs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.adjustment.modes.rig_pooling import (
    CameraRows,
    NormalEquations,
    RigRotation,
    StopRig,
)
from solmap.photogrammetry.arrays import Rotation, Vector3
from solmap.photogrammetry.matching.cross_site.tie_weights import SHARED_PARALLAX_PX
from solmap.photogrammetry.matching.stereo.orientation import RowCells

SIGNIFICANT = 3
"""Digits of standard deviations that enter recipes."""


@dataclass(frozen=True, slots=True, eq=False)
class PairRows:
    """Correspondence of the rows of a pair, with the rig as labelled."""

    pair_id: str
    stop: str
    instrument: str
    summary: str
    rover_from_pair: Rotation
    rows: CameraRows | None
    """Correction by rows; None if they do not determine the rig: few points, or rows that no
    rotation corrects."""


@dataclass(frozen=True, slots=True, eq=False)
class RigProduct:
    """Estimates of the stereo rigs of a mission, and the applied rotations of right cameras."""

    stops: Mapping[str, StopRig] = field(default_factory=dict)
    """The last stops of the mission, by name."""
    found: Mapping[str, Mapping[str, RigRotation]] = field(default_factory=dict)
    """Rig corrections found, by stop and camera set, of the same stops."""
    applied: Mapping[str, Mapping[str, Vector3]] = field(default_factory=dict)
    """Rotation by stop and camera set, of all stops so far; without those that keep their
    labels."""

    def applied_at(self, stop: str, camera: str) -> Vector3:
        """Rotation vector of the right camera that matching applies, radians."""
        return self.applied.get(stop, {}).get(camera, np.zeros(3))

    def toe_in_sigmas(self, stop: str) -> dict[str, float]:
        """Standard deviation of toe-in by camera set, radians: common to all pairs of the set."""
        return {
            camera: float(
                f"{found.toe_in_sigma(self.applied_at(stop, camera)):.{SIGNIFICANT - 1}e}"
            )
            for camera, found in self.found.get(stop, {}).items()
        }

    def toe_in_sigmas_of_ties(self, stop: str) -> tuple[tuple[str, float], ...]:
        """The same for ties between stops, in powers of two, so that they seldom change.

        Without those below the common error of parallaxes.
        """
        sigmas = self.toe_in_sigmas(stop)
        focal_px = {camera: rows.focal_px for camera, rows in self._rows(stop).items()}
        return tuple(
            (camera, 2.0 ** float(np.ceil(np.log2(sigma))))
            for camera, sigma in sorted(sigmas.items())
            if sigma * focal_px[camera] > SHARED_PARALLAX_PX
        )

    def _rows(self, stop: str) -> Mapping[str, CameraRows]:
        return self.stops[stop].rows if stop in self.stops else {}


def write_pair_rows(path: Path, pair: PairRows) -> None:
    """Write the correspondence of the rows of a pair."""
    document = {
        "pair": pair.pair_id,
        "stop": pair.stop,
        "instrument": pair.instrument,
        "summary": pair.summary,
        "rover_from_pair": pair.rover_from_pair.tolist(),
        "rows": _rows_document(pair.rows) if pair.rows else None,
    }
    path.write_text(json.dumps(document))


def read_pair_rows(path: Path) -> PairRows:
    """The inverse of `write_pair_rows`."""
    document = json.loads(path.read_text())
    return PairRows(
        document["pair"],
        document["stop"],
        document["instrument"],
        document["summary"],
        np.array(document["rover_from_pair"]),
        _rows_of(document["rows"]) if document["rows"] else None,
    )


def write_rig(path: Path, rig: RigProduct) -> None:
    """Write the estimates of the stereo rigs of a mission."""
    document = {
        "stops": {name: _stop_document(stop) for name, stop in rig.stops.items()},
        "found": {
            stop: {
                camera: {
                    "rotation": found.rotation.tolist(),
                    "covariance": found.covariance.tolist(),
                }
                for camera, found in cameras.items()
            }
            for stop, cameras in rig.found.items()
        },
        "applied": {
            stop: {camera: turn.tolist() for camera, turn in cameras.items()}
            for stop, cameras in rig.applied.items()
        },
    }
    path.write_text(json.dumps(document))


def read_rig(path: Path) -> RigProduct:
    """The inverse of `write_rig`."""
    document = json.loads(path.read_text())
    return RigProduct(
        {name: _stop_of(stop) for name, stop in document["stops"].items()},
        {
            stop: {
                camera: RigRotation(np.array(found["rotation"]), np.array(found["covariance"]))
                for camera, found in cameras.items()
            }
            for stop, cameras in document["found"].items()
        },
        {
            stop: {camera: np.array(turn) for camera, turn in cameras.items()}
            for stop, cameras in document["applied"].items()
        },
    )


def _rows_document(rows: CameraRows) -> dict[str, Any]:
    cells = rows.cells
    return {
        "cells": np.column_stack([cells.weight, cells.design, cells.vertical_px]).tolist(),
        "pairs": rows.pairs,
        "focal_px": rows.focal_px,
        "samples": rows.samples,
        "celsius": rows.celsius,
    }


def _rows_of(document: dict[str, Any]) -> CameraRows:
    cells = np.array(document["cells"])
    return CameraRows(
        RowCells(cells[:, 0], cells[:, 1:4], cells[:, 4]),
        document["pairs"],
        document["focal_px"],
        document["samples"],
        document.get("celsius"),
    )


def _stop_document(stop: StopRig) -> dict[str, Any]:
    ties = stop.ties
    return {
        "rows": {camera: _rows_document(rows) for camera, rows in stop.rows.items()},
        "ties": {"cameras": ties.cameras, "N": ties.N.tolist(), "n": ties.n.tolist()}
        if ties
        else None,
    }


def _stop_of(document: dict[str, Any]) -> StopRig:
    ties = document["ties"]
    return StopRig(
        {camera: _rows_of(rows) for camera, rows in document["rows"].items()},
        NormalEquations(tuple(ties["cameras"]), np.array(ties["N"]), np.array(ties["n"]))
        if ties
        else None,
    )
