"""Control as JSON documents, read back bit for bit, and the product with them.

A product of control is one control frame, usually an orbital image, and positions of stops in it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedControl,
    AdjustedFrame,
)
from solmap.photogrammetry.adjustment.model.network import ControlFrame, StopControl
from solmap.photogrammetry.imagery import StopId
from solmap.products.errors import ProductError
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore

FORMAT = "solmap control 1"


def read_control(ref: ProductRef, store: ProductStore) -> tuple[ControlFrame, list[StopControl]]:
    """A control frame, and positions of stops in it."""
    document = _read(ref, store)
    found = [control_of_document(row) for row in document["control"]]
    return control_frame_of_document(document["frame"]), found


def refused_stops(ref: ProductRef, store: ProductStore) -> dict[str, str]:
    """Stops that could not be found in an image, with the reason."""
    refused: dict[str, str] = _read(ref, store)["refused"]
    return refused


def _read(ref: ProductRef, store: ProductStore) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(store.path(ref).read_text())
    if document.get("format") != FORMAT:
        raise ProductError(
            f"{ref.scope.name}: {FORMAT!r} is expected, not {document.get('format')!r}; add the "
            "image or the file again with this version"
        )
    return document


def control_product(
    frame: ControlFrame, control: Sequence[StopControl], refused: dict[str, str]
) -> dict[str, Any]:
    """A product of control for JSON; `refused` are stops that were not found, with the reasons."""
    return {
        "format": FORMAT,
        "frame": control_frame_document(frame),
        "control": [control_document(one) for one in control],
        "refused": refused,
    }


Document = dict[str, Any]


def control_frame_document(frame: ControlFrame) -> Document:
    """A control frame for JSON."""
    return {
        "name": frame.name,
        "centre_m": list(frame.centre_m),
        "place": frame.place.tolist(),
        "covariance": frame.covariance.tolist(),
    }


def control_frame_of_document(document: Document) -> ControlFrame:
    """The inverse of `control_frame_document`."""
    east, north = document["centre_m"]
    return ControlFrame(
        document["name"],
        (east, north),
        np.array(document["place"], dtype=np.float64),
        np.array(document["covariance"], dtype=np.float64),
    )


def control_document(control: StopControl) -> Document:
    """Control of a stop for JSON."""
    return {
        "mission": control.stop.mission,
        "site": control.stop.site,
        "drive": control.stop.drive,
        "frame": control.frame,
        "east_m": control.east_m,
        "north_m": control.north_m,
        "up_m": control.up_m,
        "azimuth_deg": control.azimuth_deg,
        "covariance": control.covariance.tolist(),
    }


def control_of_document(document: Document) -> StopControl:
    """The inverse of `control_document`."""
    return StopControl(
        StopId(document["mission"], document["site"], document["drive"]),
        document["frame"],
        document["east_m"],
        document["north_m"],
        np.array(document["covariance"], dtype=np.float64),
        document["up_m"],
        document["azimuth_deg"],
    )


def adjusted_control_document(adjusted: AdjustedControl) -> Document:
    """Results of control, for JSON."""
    return {
        **control_document(adjusted.control),
        "used": adjusted.used,
        "residual": _numbers(adjusted.residual),
        "test": _numbers(np.array([adjusted.test]))[0],
        "redundancy": adjusted.redundancy,
        "note": adjusted.note,
    }


def adjusted_control_of_document(document: Document) -> AdjustedControl:
    """The inverse of `adjusted_control_document`."""
    return AdjustedControl(
        control_of_document(document),
        document["used"],
        np.array(document["residual"], dtype=np.float64),  # None becomes NaN
        float("nan") if document["test"] is None else document["test"],
        document["redundancy"],
        document["note"],
    )


def adjusted_frame_document(adjusted: AdjustedFrame) -> Document:
    """Adjusted position of a frame, for JSON."""
    return {
        "frame": control_frame_document(adjusted.frame),
        "place": adjusted.place.tolist(),
        "covariance": adjusted.covariance.tolist(),
    }


def adjusted_frame_of_document(document: Document) -> AdjustedFrame:
    """The inverse of `adjusted_frame_document`."""
    return AdjustedFrame(
        control_frame_of_document(document["frame"]),
        np.array(document["place"], dtype=np.float64),
        np.array(document["covariance"], dtype=np.float64),
    )


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
