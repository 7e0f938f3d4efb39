"""The adjusted network and its quality as JSON documents; the network is read back too.

Numbers are written in full, so that poses, covariances and the marginal of a sequential adjustment
are read back bit for bit. NaN (not measured, not placed) is written as null, which JSON has
instead.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedMast,
    AdjustedNetwork,
    AdjustedPair,
    AdjustedStop,
    AdjustedTies,
    AdjustmentReport,
    Memory,
)
from solmap.photogrammetry.adjustment.model.variance_components import (
    COMPONENTS,
    Scatter,
    VarianceComponents,
)
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import StopId, TieKind, TiePoints
from solmap.products.formats.documents.control import (
    adjusted_control_document,
    adjusted_control_of_document,
    adjusted_frame_document,
    adjusted_frame_of_document,
)

Document = dict[str, Any]
FORMAT = "solmap adjusted network 1"


def network_document(
    network: AdjustedNetwork, reports: Iterable[AdjustmentReport] = ()
) -> Document:
    """The network and the reports of its adjustments, for JSON."""
    return {
        "format": FORMAT,
        "stops": [_stop_document(stop) for stop in network.stops],
        "pairs": [_pair_document(pair) for pair in network.pairs],
        "ties": _ties_document(network.ties),
        "memory": memory_document(network.memory) if network.memory else None,
        "control": [adjusted_control_document(one) for one in network.control],
        "control_frames": [adjusted_frame_document(frame) for frame in network.frames],
        "variance_components": components_document(network.components),
        "mast": {
            "values": network.mast.values.tolist(),
            "covariance": network.mast.covariance.tolist(),
        },
        "reports": [report_document(report) for report in reports],
    }


def network_of_document(document: Document) -> AdjustedNetwork:
    """The network written by `network_document`.

    Raises:
        AdjustmentError: the document is of another kind or lacks a part.
    """
    if document.get("format") != FORMAT:
        raise AdjustmentError(
            f"expected a document of format {FORMAT!r}, found {document.get('format')!r}; adjust "
            "the network again with this version"
        )
    try:
        return AdjustedNetwork(
            tuple(_stop_of(stop) for stop in document["stops"]),
            tuple(_pair_of(pair) for pair in document["pairs"]),
            _ties_of(document["ties"]),
            memory_of_document(document["memory"]) if document.get("memory") else None,
            tuple(adjusted_control_of_document(one) for one in document.get("control", ())),
            tuple(adjusted_frame_of_document(one) for one in document.get("control_frames", ())),
            components_of_document(document.get("variance_components", {})),
            _mast_of(document["mast"]) if "mast" in document else AdjustedMast(),
        )
    except KeyError as error:
        raise AdjustmentError(f"the document of an adjusted network lacks {error}") from error


def _mast_of(document: Document) -> AdjustedMast:
    values, k = AdjustedMast().values, len(document["values"])  # three before the azimuth zero
    covariance = AdjustedMast().covariance
    values[:k], covariance[:k, :k] = document["values"], document["covariance"]
    return AdjustedMast(values, covariance)


def components_document(components: VarianceComponents) -> Document:
    """Variance components for JSON: prior, factor, squares and redundancy, now and past."""
    now, past = components.scatter, components.past
    columns = (now.squares, now.redundancy, past.squares, past.redundancy)
    return {
        str(name): {
            "prior": float(components.priors[k]),
            "factor": float(components.factors[k]),
            "scatter": [column[k].tolist() for column in columns],
        }
        for k, name in enumerate(COMPONENTS)
    }


def components_of_document(document: Document) -> VarianceComponents:
    """The inverse of `components_document`; missing values are as stated."""
    nothing = {"prior": 1.0, "factor": 1.0, "scatter": np.zeros((4, 3)).tolist()}
    rows = [document.get(str(name), nothing) for name in COMPONENTS]
    columns = _array([row["scatter"] for row in rows], -1, 4, 3).swapaxes(0, 1).copy()
    return VarianceComponents(
        _array([row["factor"] for row in rows], -1),
        Scatter(*columns[:2]),
        Scatter(*columns[2:]),
        _array([row["prior"] for row in rows], -1),
    )


def report_document(report: AdjustmentReport) -> Document:
    """A report for JSON, with its one-line text."""

    def agreement(kinds: dict[TieKind, Any]) -> Document:
        return {
            str(kind): {
                "comparisons": c.comparisons,
                "mean_2d_px": _number(c.mean_2d_px),
                "mean_3d_m": _number(c.mean_3d_m),
            }
            for kind, c in kinds.items()
        }

    return {
        "name": report.name,
        "summary": str(report),
        "is_usable": report.is_usable,
        "converged": report.converged,
        "iterations": report.iterations,
        "sigma0": _number(report.sigma0),
        "redundancy": report.redundancy,
        "stops": report.stops,
        "pairs": report.pairs,
        "ties": {str(kind): count for kind, count in report.ties.items()},
        "blunders": report.blunders,
        "control": report.control,
        "control_refused": list(report.control_refused),
        "before": agreement(report.before),
        "after": agreement(report.after),
        "untied": [_stop_id_document(stop) for stop in report.untied],
        "message": report.message,
        "findings": [
            {
                "stop": _stop_id_document(finding.stop),
                "lack": str(finding.lack),
                "ties": finding.ties,
                "rank": finding.rank,
                "text": finding.text,
            }
            for finding in report.findings
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _numbers(array: np.ndarray) -> list[Any]:
    """Nested lists, with None for NaN."""
    if np.isfinite(array).all():
        return array.tolist()
    values = array.astype(object)
    values[~np.isfinite(array)] = None
    return values.tolist()


def _array(values: list[Any], *shape: int) -> np.ndarray:
    return np.array(values, dtype=np.float64).reshape(shape)  # None becomes NaN


def _stop_id_document(stop: StopId) -> Document:
    return {"mission": stop.mission, "site": stop.site, "drive": stop.drive}


def _frame_document(frame: Frame) -> list[Any]:
    return [str(frame.kind), *frame.index]


def _frame_of(values: list[Any]) -> Frame:
    return Frame(FrameKind(values[0]), tuple(values[1:]))


def _pose_document(pose: Pose) -> Document:
    return {
        "rotation": pose.rotation.tolist(),
        "translation_m": pose.translation_m.tolist(),
        "quaternion": pose.quaternion.tolist(),
    }


def _pose_of(document: Document, target: Frame, source: Frame) -> Pose:
    rotation, shift = _array(document["rotation"], 3, 3), _array(document["translation_m"], 3)
    return Pose(target, source, rotation, shift)


def _stop_document(stop: AdjustedStop) -> Document:
    return {
        **_stop_id_document(stop.stop),
        "lsl_from_rover": _pose_document(stop.lsl_from_rover),
        "covariance": stop.covariance.tolist(),
        "held": stop.held,
        "is_tied": stop.is_tied,
        "held_by": stop.held_by,
    }


def _stop_of(document: Document) -> AdjustedStop:
    stop = StopId(document["mission"], document["site"], document["drive"])
    return AdjustedStop(
        stop,
        _pose_of(document["lsl_from_rover"], LSL, stop.frame),
        _array(document["covariance"], 6, 6),
        document["held"],
        document["is_tied"],
        document["held_by"],
    )


def _pair_document(pair: AdjustedPair) -> Document:
    return {
        "pair_id": pair.pair_id,
        "stop": _stop_id_document(pair.stop),
        "frame": _frame_document(pair.lsl_from_pair.source),
        "lsl_from_pair": _pose_document(pair.lsl_from_pair),
        "rover_from_pair": _pose_document(pair.rover_from_pair),
        "pointing": pair.pointing.tolist(),
        "covariance": pair.covariance.tolist(),
        "pointing_covariance": pair.pointing_covariance.tolist(),
        "ties": pair.ties,
    }


def _pair_of(document: Document) -> AdjustedPair:
    stop = StopId(**document["stop"])
    frame = _frame_of(document["frame"])
    return AdjustedPair(
        document["pair_id"],
        stop,
        _pose_of(document["lsl_from_pair"], LSL, frame),
        _pose_of(document["rover_from_pair"], stop.frame, frame),
        _array(document["pointing"], 3),
        _array(document["covariance"], 6, 6),
        _array(document["pointing_covariance"], 3, 3),
        document["ties"],
    )


def _ties_document(ties: AdjustedTies) -> Document:
    seen = ties.observations
    return {
        "pair_ids": list(seen.pair_ids),
        "point": seen.point.tolist(),
        "pair": seen.pair.tolist(),
        "left": _numbers(seen.left),
        "parallax_px": _numbers(seen.parallax_px),
        "sigma_px": _numbers(seen.sigma_px),
        "sigma_parallax_px": _numbers(seen.sigma_parallax_px),
        "sigma_line_px": _numbers(seen.sigma_line_px),
        "by_shape": seen.surface_matched.tolist(),
        "points": _numbers(ties.points),
        "covariances": _numbers(ties.covariances),
        "kinds": [str(kind) for kind in ties.kinds],
        "status": ties.status.tolist(),
        "residuals_px": _numbers(ties.residuals_px),
        "standardised": _numbers(ties.standardised),
        "redundancy": _numbers(ties.redundancy),
    }


def _ties_of(document: Document) -> AdjustedTies:
    return AdjustedTies(
        TiePoints(
            tuple(document["pair_ids"]),
            np.array(document["point"], dtype=np.int32),
            np.array(document["pair"], dtype=np.int32),
            _array(document["left"], -1, 2),
            _array(document["parallax_px"], -1),
            _array(document["sigma_px"], -1),
            _array(document["sigma_parallax_px"], -1),
            _array(document["sigma_line_px" if "sigma_line_px" in document else "sigma_px"], -1),
            np.array(document.get("by_shape", [False] * len(document["point"])), dtype=bool),
        ),
        _array(document["points"], -1, 3),
        _array(document["covariances"], -1, 3, 3),
        tuple(TieKind(kind) for kind in document["kinds"]),
        np.array(document["status"], dtype=np.int32),
        _array(document["residuals_px"], -1, 3),
        _array(document["standardised"], -1, 3),
        _array(document["redundancy"], -1, 3),
    )


def memory_document(memory: Memory) -> Document:
    """The marginal of a sequential adjustment, for JSON."""
    names = ("rotations", "centres", "pointings", "root", "right")
    return {
        "window": [_stop_id_document(stop) for stop in memory.window],
        "stops": [_stop_id_document(stop) for stop in memory.stops],
        "pairs": list(memory.pair_ids),
        **{name: getattr(memory, name).tolist() for name in names},
        "spent": memory.spent,
        "surplus": memory.surplus,
        "grounded": list(memory.grounded),
        "frames": list(memory.frames),
        "frame_places": memory.frame_places.tolist(),
        "mast": memory.mast.tolist(),
    }


def memory_of_document(document: Document) -> Memory:
    """The inverse of `memory_document`."""
    stops, right = document["stops"], np.array(document["right"], dtype=np.float64)
    pairs, frames = document["pairs"], document.get("frames", [])
    mast = np.array(document.get("mast", []), dtype=np.float64)
    columns = 6 * len(stops) + 3 * len(pairs) + 5 * len(frames) + len(mast)
    return Memory(
        tuple(StopId(**stop) for stop in document["window"]),
        tuple(StopId(**stop) for stop in stops),
        tuple(pairs),
        _array(document["rotations"], -1, 3, 3),
        _array(document["centres"], -1, 3),
        _array(document["pointings"], -1, 3),
        _array(document["root"], len(right), columns),
        right,
        document["spent"],
        document["surplus"],
        tuple(document["grounded"]),
        tuple(frames),
        _array(document["frame_places"], -1, 5) if frames else np.zeros((0, 5)),
        mast,
    )


def quality_document(value: Any) -> Any:  # noqa: ANN401 - a record, or what one holds
    """Records as plain JSON values: identifiers as text, null for values not measured."""
    if isinstance(value, StopId):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: quality_document(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {_key_name(key): quality_document(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [quality_document(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _key_name(key: Any) -> str:  # noqa: ANN401 - a kind of tie, or two stops
    return " - ".join(str(part) for part in key) if isinstance(key, tuple) else str(key)
