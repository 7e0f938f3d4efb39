"""The record of an image as JSON; numbers are read back exactly.

The catalogue caches labels in this form, and images of an own stereo rig, which have no labels, are
stored with it as their label.
"""

from __future__ import annotations

import dataclasses
import json
from enum import Enum
from typing import Any

import numpy as np

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.cameras.calibrated import BrownConrady, Fisheye
from solmap.photogrammetry.errors import LabelError, PhotogrammetryError
from solmap.photogrammetry.frames import Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId

_CAMERAS = (Cahv, Cahvor, Cahvore, BrownConrady, Fisheye)
_RECORDS: dict[str, Any] = {
    record.__name__: record for record in (RoverImage, StopId, Pose, Frame, *_CAMERAS)
}
_NAMES: dict[str, Any] = {name.__name__: name for name in (Eye, FrameKind)}
START = '{"": "RoverImage"'
"""Beginning of a record's text."""


def text_of_label(label: RoverImage) -> str:
    """The content of a label as JSON; numbers are read back exactly."""
    return json.dumps(_document(label))


def label_of_text(text: str, source: str = "a cached label") -> RoverImage:
    """The inverse of `text_of_label`.

    Raises:
        LabelError: it is not a record; the message names `source`.
    """
    try:
        label = _value(json.loads(text))
    except PhotogrammetryError as error:
        raise LabelError(f"{source}: {error}") from error
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
        raise LabelError(f"{source}: not the record of an image: {error!r:.100}") from error
    if not isinstance(label, RoverImage):
        raise LabelError(f"{source}: not the record of an image")
    return label


def _document(value: Any) -> Any:  # noqa: ANN401 - any part of a label
    if isinstance(value, Enum):
        return {"": type(value).__name__, "value": value.value}
    if dataclasses.is_dataclass(value):
        parts = {part.name: getattr(value, part.name) for part in dataclasses.fields(value)}
        return {"": type(value).__name__, **{name: _document(part) for name, part in parts.items()}}
    if isinstance(value, np.ndarray):
        return {"": "array", "value": value.tolist()}
    if isinstance(value, tuple):
        return [_document(part) for part in value]
    return value


def _value(document: Any) -> Any:  # noqa: ANN401 - as above
    if isinstance(document, list):
        return tuple(map(_value, document))
    if not isinstance(document, dict):
        return document
    kind = document[""]
    if kind == "array":
        return np.array(document["value"], dtype=np.float64)
    if kind in _NAMES:
        return _NAMES[kind](document["value"])
    return _RECORDS[kind](**{name: _value(part) for name, part in document.items() if name})
