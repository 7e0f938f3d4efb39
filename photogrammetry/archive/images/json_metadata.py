"""Public raw images of Curiosity and Perseverance, which have JSON metadata instead of labels.

The metadata are an item of the image lists of mars.nasa.gov: `images` of `rss/api` (Mars 2020),
`items` of `api/v1/raw_image_items` (MSL), or the flat copy of either that programs save beside an
image file. The lists have different names for the same values:

    sclk             spacecraft_clock         seconds
    date_taken_utc   date_taken               UTC
    dimension        -                        (samples, lines) of the image
    subframeRect     subframe_rect            (first sample, first line, samples, lines), detector
    scaleFactor      scale_factor             detector pixels per image pixel

`camera_model_component_list` holds the vectors of the model in the order of its letters, separated
by semicolons, C;A;H;V;O;R;E, then for CAHVORE the two numbers T (type) and P (parameter), all in
the rover frame. The model belongs to the image as stored: frames of Perseverance are transmitted in
tiles of a sensor of 5120 x 3840 pixels, whole or averaged by 2 or 4, and in the model of a tile the
principal point is shifted by its first pixel and scaled.

`xyz` is the position of the rover in its site, `attitude` its quaternion with the scalar first,
which some copies of the metadata omit. Without an attitude the image cannot be placed on a map; the
error then names the sources of one.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from solmap.photogrammetry.archive.file_names import FileName, parse_file_name
from solmap.photogrammetry.archive.images.rover_image import check_field
from solmap.photogrammetry.archive.missions import M2020, MSL
from solmap.photogrammetry.archive.times import time_text
from solmap.photogrammetry.arrays import Quaternion
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.errors import CameraError, FrameError, LabelError
from solmap.photogrammetry.frames import Pose, site_frame
from solmap.photogrammetry.imagery import RoverImage, StopId

MAX_CHARACTERS = 1 << 20
LETTERS = {"CAHV": "cahv", "CAHVOR": "cahvor", "CAHVORE": "cahvore"}
OTHER_KEYS = {
    "spacecraft_clock": "sclk",
    "date_taken": "date_taken_utc",
    "subframeRect": "subframe_rect",
    "scaleFactor": "scale_factor",
}
"""Alternative names in the lists -> the name used here."""
_BAND = re.compile(r"ZCAM_[LR](\d)_", re.ASCII)
"""Pattern of the band in filter_name of Mastcam-Z: ZCAM_L6_442NM."""
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def camera_of_metadata(text: str, source: str) -> Cahv | Cahvor | Cahvore:
    """The camera model of an image's metadata, in the rover frame.

    Raises:
        LabelError: the text is not such metadata, or its model is impossible.
    """
    metadata = _flat(_metadata(text, source))
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


def rover_image_of_metadata(
    text: str, source: str, *, site_from_rover: Pose | None = None
) -> RoverImage:
    """The record of a raw image.

    Args:
        text: its metadata.
        source: the name of their file.
        site_from_rover: pose of the rover, if the metadata lack it.

    Raises:
        LabelError: something is missing or broken, most often the attitude of the rover.
    """
    metadata = _flat(_metadata(text, source))
    kind = metadata.get("sample_type")
    if metadata.get("is_thumbnail") is True:
        kind = "thumbnail"
    if isinstance(kind, str) and kind.upper() == "THUMBNAIL":
        raise LabelError(f"{source}: not a mapping image: sample_type is {kind!a}")
    camera = camera_of_metadata(json.dumps(metadata), source)
    instrument = str(metadata.get("instrument")).upper()
    mission = next((one for one in (M2020, MSL) if instrument in one.instruments), None)
    if mission is None:
        raise LabelError(f"{source}: unknown instrument {instrument[:40]!a}")
    camera_name, eye = mission.instruments[instrument]
    site, drive = (_counter(metadata, key, source) for key in ("site", "drive"))
    stop = StopId(mission.hosts[0], site, drive)
    samples, lines = _size(metadata, source)
    check_field(camera, samples, lines, source)
    image_id = str(metadata.get("imageid") or source).rpartition("/")[2].partition(".")[0].upper()
    name = _name(image_id)
    band = _BAND.match(str(metadata.get("filter_name")))
    try:
        return RoverImage(
            id=image_id,
            stop=stop,
            sol=_counter(metadata, "sol", source),
            instrument=camera_name,
            eye=eye,
            filter_number=int(band[1]) if band else None,
            clock=_clock(metadata, source),
            motion_counter=(site, drive),
            sequence=name.sequence if name else "",
            product_type=name.product_type if name else "RAW",
            is_linearised=False,
            lines=lines,
            samples=samples,
            camera=camera,
            site_from_rover=site_from_rover or _site_from_rover(metadata, stop, source),
            attitude_measured_by="UNKNOWN",
            local_solar_time=None,
            start_time=time_text(str(metadata.get("date_taken_utc"))),
            sun_azimuth=None,
            sun_elevation=None,
        )
    except FrameError as error:
        raise LabelError(f"{source}: {error}") from error


def _size(metadata: dict[str, Any], source: str) -> tuple[int, int]:
    """Samples and lines of the image: stated, or those of its detector region, averaged."""
    if metadata.get("dimension"):
        samples, lines = (int(size) for size in _list(metadata, "dimension", 2, source))
    else:
        _, _, width, height = _list(metadata, "subframe_rect", 4, source)
        scale = metadata.get("scale_factor") or 1
        if str(scale) not in {"1", "2", "4", "8"}:
            raise LabelError(f"{source}: scale_factor should be 1, 2, 4 or 8, but is {scale!a:.40}")
        samples, lines = int(width) // int(scale), int(height) // int(scale)
    if min(samples, lines) < 1:
        raise LabelError(f"{source}: dimension {samples} x {lines} is not that of an image")
    return samples, lines


def _name(image_id: str) -> FileName | None:
    try:
        return parse_file_name(image_id)
    except LabelError:
        return None


def with_attitude(
    text: str, source: str, attitude_of: Callable[[RoverImage], Quaternion | None]
) -> str:
    """The metadata with an attitude from another source added, where they have none.

    Args:
        text: the metadata.
        source: the name of their file.
        attitude_of: returns the attitude of the rover at an image (scalar first, rover into north,
            east, down), or None; it must not return that of the record passed to it.

    Raises:
        LabelError: something else is missing or broken.
    """
    metadata = _metadata(text, source)
    if _flat(metadata).get("attitude"):
        return text
    level = json.dumps(metadata | {"attitude": [1, 0, 0, 0]})
    stated = attitude_of(rover_image_of_metadata(level, source))
    return text if stated is None else json.dumps(metadata | {"attitude": stated.tolist()})


def _site_from_rover(metadata: dict[str, Any], stop: StopId, source: str) -> Pose:
    """The pose in the metadata, where it is complete."""
    if not metadata.get("attitude"):
        raise LabelError(
            f"{source}: the metadata name site {stop.site} and drive {stop.drive}, but no attitude "
            "of the rover; give its pose by `solmap run FOLDER --places FILE` (PLACES table, .rvf, "
            "poses CSV, SPICE kernels), or bring metadata that have it by `solmap fetch --raw`"
        )
    quaternion, offset_m = (
        np.array(_list(metadata, key, count, source))
        for key, count in (("attitude", 4), ("xyz", 3))
    )
    return Pose.of_quaternion(site_frame(stop.site), stop.frame, quaternion, offset_m)


def _flat(metadata: dict[str, Any]) -> dict[str, Any]:
    """Metadata with the parts `camera` and `extended` of the image list's form flattened."""
    parts = [metadata.get(key) for key in ("extended", "camera")]
    flat = {key: value for part in parts if isinstance(part, dict) for key, value in part.items()}
    flat |= metadata
    return {**flat, **{OTHER_KEYS[key]: flat[key] for key in OTHER_KEYS if key in flat}}


def _counter(metadata: dict[str, Any], key: str, source: str) -> int:
    text = str(metadata.get(key))
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise LabelError(f"{source}: {key} should be a whole number, but is {text[:40]!a}")
    return int(text)


def _clock(metadata: dict[str, Any], source: str) -> float:
    try:
        clock = float(metadata.get("sclk"))  # type: ignore[arg-type] # refused below
    except (TypeError, ValueError, OverflowError):
        clock = math.nan
    if not math.isfinite(clock):
        raise LabelError(f"{source}: sclk should be seconds, but is {metadata.get('sclk')!a:.40}")
    return clock


def _list(metadata: dict[str, Any], key: str, count: int, source: str) -> Sequence[float]:
    """Numbers written as "(1,2)" or as a list."""
    value = metadata.get(key)
    words = (
        [str(v) for v in value] if isinstance(value, list) else str(value).strip("() ").split(",")
    )
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word.strip())]
    if len(words) != count or len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise LabelError(f"{source}: {key} should be {count} numbers, but is {value!a:.60}")
    return numbers


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
