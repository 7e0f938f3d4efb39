"""Camera models of Mars 2020, whose public raw images come with JSON metadata instead of labels.

`camera_model_component_list` holds the vectors of the model in the order of its letters, separated
by semicolons, C;A;H;V;O;R;E, then for CAHVORE the two numbers T (type) and P (parameter), all in
the rover frame. The metadata name site and drive, but no attitude of the rover: the camera can be
used, the frame cannot be placed on the map without a vector file.
"""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from photogrammetry.cameras.cahv import Cahv
from photogrammetry.cameras.cahvor import Cahvor
from photogrammetry.cameras.cahvore import Cahvore
from photogrammetry.errors import CameraError, LabelError

MAX_CHARACTERS = 1 << 20
LETTERS = {"CAHV": "cahv", "CAHVOR": "cahvor", "CAHVORE": "cahvore"}
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def camera_of_metadata(text: str, source: str) -> Cahv | Cahvor | Cahvore:
    """The camera model of an image's metadata, in the rover frame.

    Raises:
        LabelError: the text is no such metadata, or its model is impossible.
    """
    metadata = _metadata(text, source)
    model_type = metadata.get("camera_model_type")
    letters = LETTERS.get(model_type) if isinstance(model_type, str) else None
    if letters is None:
        raise LabelError(
            f"{source}: camera_model_type should be CAHV, CAHVOR or CAHVORE, but is "
            f"{model_type!a:.60}"
        )
    parts = str(metadata.get("camera_model_component_list", "")).split(";")
    scalars = 2 if model_type == "CAHVORE" else 0
    if len(parts) != len(letters) + scalars:
        raise LabelError(
            f"{source}: camera_model_component_list should have {len(letters) + scalars} parts, "
            f"but has {len(parts)}"
        )
    vectors = {
        letter: _numbers(part, 3, letter, source)
        for letter, part in zip(letters, parts, strict=False)
    }
    try:
        if model_type == "CAHV":
            return Cahv(**vectors)
        length = float(np.linalg.norm(vectors["o"]))
        vectors["o"] = vectors["o"] / (length if length > 0 else 1.0)
        if model_type == "CAHVOR":
            return Cahvor(**vectors)
        kind, parameter = (
            _numbers(part, 1, name, source)[0] for name, part in zip("tp", parts[-2:], strict=True)
        )
        if not float(kind).is_integer():
            raise LabelError(f"{source}: T of camera_model_component_list is {kind}, not 1, 2 or 3")
        return Cahvore(**vectors, type=int(kind), parameter=float(parameter))
    except CameraError as error:
        raise LabelError(f"{source}: camera_model_component_list: {error}") from error


def _metadata(text: str, source: str) -> dict[str, Any]:
    if len(text) > MAX_CHARACTERS:
        raise LabelError(f"{source}: {len(text)} characters are too many for image metadata")
    try:
        metadata = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise LabelError(f"{source}: not JSON: {str(error)[:100]}") from error
    if not isinstance(metadata, dict):
        raise LabelError(f"{source}: expected a JSON object with the metadata of an image")
    return metadata


def _numbers(part: str, count: int, letter: str, source: str) -> np.ndarray:
    words = part.strip().strip("()").split(",")
    if len(words) != count or not all(_NUMBER.fullmatch(word.strip()) for word in words):
        raise LabelError(
            f"{source}: {letter.upper()} of camera_model_component_list should be {count} "
            f"number{'s' if count > 1 else ''}, but is {part[:40]!a}"
        )
    return np.array([float(word) for word in words])
