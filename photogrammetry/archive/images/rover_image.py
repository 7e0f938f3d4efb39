"""From a label to a `RoverImage`: pose, camera model, time and identifiers.

The camera model of a label already belongs to the image as stored: sub-frame and pixel averaging
are included. Only one correction is made: MER's software, unlike that of later missions, omitted
half a pixel when it averaged blocks of w x h pixels (integer coordinates are pixel centres),

    H <- H - (1 - 1/w)/2 A,        V <- V - (1 - 1/h)/2 A.

Directions in labels are not used. Elevations have the wrong sign in whole product families although
their labels state POSITIVE_ELEVATION_DIRECTION = UP, so the sign of the Sun's is corrected: by the
mast's x axis, whose elevation follows from the quaternion and must agree with INSTRUMENT_ELEVATION,
or, without a mast, because the Sun is up by day.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from solmap.photogrammetry.archive.file_names import FileName, parse_file_name
from solmap.photogrammetry.archive.labels.label import Label
from solmap.photogrammetry.archive.missions import MISSIONS, Mission, mission_id, mission_of_host
from solmap.photogrammetry.archive.times import time_text
from solmap.photogrammetry.cameras.cahv import Cahv, interior_orientation
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.errors import CameraError, FrameError, LabelError
from solmap.photogrammetry.frames import Pose, rotation_of_quaternion, site_frame
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId

CAMERA = "GEOMETRIC_CAMERA_MODEL"
ROVER = "ROVER_COORDINATE_SYSTEM"
SITE = "SITE_COORDINATE_SYSTEM"
SITE_GEOMETRY = "SITE_DERIVED_GEOMETRY_PARMS"
ROVER_GEOMETRY = "ROVER_DERIVED_GEOMETRY_PARMS"
STATE = "INSTRUMENT_STATE_PARMS"
ROVER_FRAMES = frozenset({"ROVER_FRAME", "ROVER_NAV_FRAME"})
MODELS = {"CAHV": "CAHV", "CAHVOR": "CAHVOR", "CAHVORE": "CAHVORETP"}
LEAST_ELEVATION = math.radians(1.0)
"""Mast elevations nearer to the horizon do not determine the sign: six digits and 0.1 degree of
lag."""
DETECTOR_ON_MAST = re.compile(r"(?:NAV|PAN)[ _]CCD\Z", re.ASCII)
"""Pattern in the names of temperatures: LEFT PAN CCD of MER, B_LEFT_NAV_CCD of MSL."""
MAX_CELSIUS = 150.0
"""Labels have 1e30 where nothing was measured, or zero."""
DAY_HOURS = (6.5, 17.5)
"""Local true solar time at which the Sun is up at any rover's latitude, in every season."""

MAX_FIELD_RATIO = 20.0
"""Image size over focal length: a field of 168 degrees, wider than any of these lenses has."""
MAX_FOCAL_PX = 1e6
"""Twenty times that of the longest lens on a mast."""
_SOLAR_TIME = re.compile(
    r"(?:SOL-?\d{1,6}[ MT]+)?(?P<hour>\d{1,2}):(?P<minute>\d\d)(?::\d\d(?:\.\d{0,9})?)?",
    re.ASCII | re.IGNORECASE,
)
"""Local true solar time, alone or after the sol."""

Camera = Cahv | Cahvor | Cahvore


def rover_image(label: Label, file_name: str, missions: Sequence[Mission] = MISSIONS) -> RoverImage:
    """The record of an image.

    Raises:
        LabelError: the label does not describe a mapping image, or lacks a required value.
    """
    mission = _mission(label, missions)
    name = _name(label, file_name)
    product_id = name.product_id if name else _stem(file_name)
    product_type = name.product_type if name else "UNKNOWN"
    _check_mapping_image(label, mission, product_type)
    instrument, eye = _instrument(label, mission)
    counter = _motion_counter(label)
    host = label.require("", "INSTRUMENT_HOST_ID", str)
    stop = StopId(mission_id(host), counter[0], counter[1])
    site_from_rover = _site_from_rover(label, stop)
    lines, samples = (label.require("IMAGE", size, int) for size in ("LINES", "LINE_SAMPLES"))
    check_field(camera_model(label), samples, lines, label.source)
    return RoverImage(
        id=product_id,
        stop=stop,
        sol=label.require("", "PLANET_DAY_NUMBER", int),
        instrument=instrument,
        eye=eye,
        filter_number=_filter_number(label, mission, instrument, name),
        clock=_clock(label),
        motion_counter=counter,
        sequence=(label.optional("", "SEQUENCE_ID", str) or "").lower(),
        product_type=product_type,
        is_linearised=label.optional("", "GEOMETRY_PROJECTION_TYPE", str) == "LINEARIZED",
        lines=lines,
        samples=samples,
        camera=_camera_in_rover(
            label,
            site_from_rover,
            correct_half_pixel=mission.leaves_out_half_pixel,
        ),
        site_from_rover=site_from_rover,
        attitude_measured_by=label.optional(ROVER, "QUATERNION_MEASUREMENT_METHOD", str)
        or "UNKNOWN",
        local_solar_time=_local_solar_time(label),
        start_time=time_text(label.optional("", "START_TIME", str)),
        sun_azimuth=_sun_azimuth(label),
        sun_elevation=_sun_elevation(label, mission),
        mast_in_rover=_mast_in_rover(label, mission, instrument),
        parent_from_site=parent_from_site(label, stop.site),
        created=time_text(label.optional("", "PRODUCT_CREATION_TIME", str)),
        camera_celsius=_camera_celsius(label, instrument),
    )


def camera_model(label: Label) -> Camera:
    """The camera model of a label unchanged, except that O is scaled to length 1.

    Raises:
        LabelError: there is none, or it is impossible.
    """
    if not label.has_group(CAMERA):
        raise LabelError(f"{label.source}: the label has no camera model ({CAMERA})")
    model_type = label.require(CAMERA, "MODEL_TYPE", str).upper()
    letters = MODELS.get(model_type)
    if letters is None:
        raise LabelError(
            f"{label.source}: {CAMERA}/MODEL_TYPE should be CAHV, CAHVOR or CAHVORE, but is "
            f"{model_type[:40]!a}"
        )
    parts = {
        letter: _component(label, letter, number) for number, letter in enumerate(letters, start=1)
    }
    vectors = {letter.lower(): parts[letter] for letter in letters if letter not in "TP"}
    if "o" in vectors:
        vectors["o"] = _unit(label, vectors["o"])
    try:
        if model_type == "CAHV":
            return Cahv(**vectors)
        if model_type == "CAHVOR":
            return Cahvor(**vectors)
        return Cahvore(**vectors, type=_model_kind(label, parts), parameter=float(parts["P"][0]))
    except CameraError as error:
        raise LabelError(f"{label.source}: {CAMERA}: {error}") from error


def check_field(camera: Camera, samples: int, lines: int, source: str) -> None:
    """Reject a camera model that cannot be that of an image of this size.

    Raises:
        LabelError: its focal lengths or principal point are impossible for the image.
    """
    inner = interior_orientation(camera.a, camera.h, camera.v)
    for size, focal_px, centre_px in ((samples, inner.hs, inner.hc), (lines, inner.vs, inner.vc)):
        is_plausible = (
            size <= MAX_FIELD_RATIO * focal_px
            and focal_px <= MAX_FOCAL_PX
            and abs(centre_px) <= MAX_FOCAL_PX
        )
        if not is_plausible:
            raise LabelError(
                f"{source}: {CAMERA}: focal length {focal_px:.6g} px and principal point "
                f"{centre_px:.6g} px cannot belong to an image of {samples} x {lines} pixels"
            )


def _component(label: Label, letter: str, number: int) -> np.ndarray:
    """One vector of the model, found by MODEL_COMPONENT_ID where that is given."""
    order = label.get(CAMERA, "MODEL_COMPONENT_ID")
    if isinstance(order, tuple) and letter in order:
        number = order.index(letter) + 1
    count = 1 if letter in "TP" else 3
    return label.require_numbers(CAMERA, f"MODEL_COMPONENT_{number}", count)


def _model_kind(label: Label, parts: Mapping[str, np.ndarray]) -> int:
    """T of a CAHVORE model, which labels write as a real number."""
    kind = float(parts["T"][0])
    if not kind.is_integer():
        raise LabelError(f"{label.source}: {CAMERA}: T should be 1, 2 or 3, but is {kind:g}")
    return int(kind)


def _unit(label: Label, vector: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    if not 0.5 < length < 2:  # noqa: PLR2004 - nothing that rounding could have made of 1
        raise LabelError(
            f"{label.source}: {CAMERA}: O should be a unit vector, but has length {length:.3g}"
        )
    return vector / length


def _camera_in_rover(label: Label, site_from_rover: Pose, *, correct_half_pixel: bool) -> Camera:
    """The camera model in the rover frame, with the half pixel corrected."""
    camera = camera_model(label)
    frame = label.optional(CAMERA, "REFERENCE_COORD_SYSTEM_NAME", str) or "ROVER_FRAME"
    if frame == "SITE_FRAME":
        camera = camera.transform(site_from_rover.inverse)
    elif frame not in ROVER_FRAMES:
        raise LabelError(
            f"{label.source}: {CAMERA}/REFERENCE_COORD_SYSTEM_NAME should be ROVER_FRAME or "
            f"SITE_FRAME, but is {frame[:40]!a}"
        )
    width, height = pixel_averaging(label)
    if not correct_half_pixel or (width, height) == (1, 1):
        return camera
    return camera.subframe(0.5 * (1 - 1 / width), 0.5 * (1 - 1 / height))


def pixel_averaging(label: Label) -> tuple[int, int]:
    """Number of columns and lines of the detector that were averaged into one pixel."""
    counts = []
    for keyword in ("PIXEL_AVERAGING_WIDTH", "PIXEL_AVERAGING_HEIGHT"):
        count = label.optional(STATE, keyword, int)
        if count is None:
            count = 1
        if count < 1:
            raise LabelError(f"{label.source}: {keyword} should be 1 or more, but is {count}")
        counts.append(count)
    return counts[0], counts[1]


def _site_from_rover(label: Label, stop: StopId) -> Pose:
    """Pose of the rover in its site, by telemetry."""
    reference = label.optional(ROVER, "REFERENCE_COORD_SYSTEM_NAME", str) or "SITE_FRAME"
    if reference != "SITE_FRAME":
        raise LabelError(
            f"{label.source}: {ROVER}/REFERENCE_COORD_SYSTEM_NAME should be SITE_FRAME, but is "
            f"{reference[:40]!a}"
        )
    site = label.optional(ROVER, "REFERENCE_COORD_SYSTEM_INDEX", int)
    quaternion = label.require_numbers(ROVER, "ORIGIN_ROTATION_QUATERNION", 4)
    offset_m = label.require_numbers(ROVER, "ORIGIN_OFFSET_VECTOR", 3)
    try:
        return Pose.of_quaternion(
            site_frame(stop.site if site is None else site), stop.frame, quaternion, offset_m
        )
    except FrameError as error:
        raise LabelError(f"{label.source}: {ROVER}: {error}") from error


def parent_from_site(label: Label, site: int) -> Pose | None:
    """Position of the image's site in the site where it was declared; MER labels lack it.

    Raises:
        LabelError: the group SITE_COORDINATE_SYSTEM exists, but does not give a pose.
    """
    if label.get(SITE, "ORIGIN_OFFSET_VECTOR") is None:
        return None
    if label.get(SITE, "ORIGIN_ROTATION_QUATERNION") is None:
        return None
    name = label.optional(SITE, "REFERENCE_COORD_SYSTEM_NAME", str)
    parent = label.optional(SITE, "REFERENCE_COORD_SYSTEM_INDEX", int)
    own = label.optional(SITE, "COORDINATE_SYSTEM_INDEX", int)
    if name != "SITE_FRAME" or parent is None or own not in {None, site} or parent == site:
        return None
    quaternion = label.require_numbers(SITE, "ORIGIN_ROTATION_QUATERNION", 4)
    offset_m = label.require_numbers(SITE, "ORIGIN_OFFSET_VECTOR", 3)
    try:
        return Pose.of_quaternion(site_frame(parent), site_frame(site), quaternion, offset_m)
    except FrameError as error:
        raise LabelError(f"{label.source}: {SITE}: {error}") from error


def _mission(label: Label, missions: Sequence[Mission]) -> Mission:
    host = label.require("", "INSTRUMENT_HOST_ID", str)
    mission = mission_of_host(host, missions)
    if mission is None:
        known = ", ".join(host for mission in missions for host in mission.hosts)
        raise LabelError(
            f"{label.source}: INSTRUMENT_HOST_ID should be one of {known}, but is {host[:40]!a}"
        )
    return mission


def _name(label: Label, file_name: str) -> FileName | None:
    """The parts of the file's name; of PRODUCT_ID where the file was renamed."""
    for name in (file_name, label.optional("", "PRODUCT_ID", str) or ""):
        try:
            return parse_file_name(name)
        except LabelError:
            continue
    return None


def _stem(file_name: str) -> str:
    return file_name.replace("\\", "/").rpartition("/")[2].partition(".")[0].upper() or "UNNAMED"


def _check_mapping_image(label: Label, mission: Mission, product_type: str) -> None:
    """Reject thumbnails, reference pixels, histograms and rasters of anything but grey values."""
    image_type = label.optional("", "IMAGE_TYPE", str) or "REGULAR"
    if image_type != "REGULAR":
        raise LabelError(f"{label.source}: not a mapping image: IMAGE_TYPE is {image_type[:40]!a}")
    derived = label.optional("DERIVED_IMAGE_PARMS", "DERIVED_IMAGE_TYPE", str) or "IMAGE"
    if derived != "IMAGE":
        raise LabelError(
            f"{label.source}: not a mapping image: DERIVED_IMAGE_TYPE is {derived[:40]!a}"
        )
    known = mission.mapping_products
    if known is not None and product_type != "UNKNOWN" and product_type not in known:
        raise LabelError(f"{label.source}: not a mapping image: product type {product_type}")


def _instrument(label: Label, mission: Mission) -> tuple[str, Eye]:
    identifier = label.require("", "INSTRUMENT_ID", str).upper()
    if identifier not in mission.instruments:
        raise LabelError(f"{label.source}: unknown camera INSTRUMENT_ID {identifier[:40]!a}")
    return mission.instruments[identifier]


def _motion_counter(label: Label) -> tuple[int, ...]:
    counter = label.require_numbers("", "ROVER_MOTION_COUNTER")
    if len(counter) < 2 or (counter % 1).any() or (counter < 0).any():  # noqa: PLR2004 - site, drive
        raise LabelError(
            f"{label.source}: ROVER_MOTION_COUNTER should be whole numbers (SITE,DRIVE,...), "
            f"but is {counter[:10].tolist()}"
        )
    return tuple(int(count) for count in counter)


def _clock(label: Label) -> float:
    """Seconds of the spacecraft clock; a partition before a slash is dropped."""
    text = label.require("", "SPACECRAFT_CLOCK_START_COUNT", str).rpartition("/")[2]
    try:
        clock = float(text)
    except ValueError:
        clock = math.nan
    if not math.isfinite(clock):
        raise LabelError(
            f"{label.source}: SPACECRAFT_CLOCK_START_COUNT should be seconds, but is {text[:40]!a}"
        )
    return clock


def _filter_number(
    label: Label, mission: Mission, instrument: str, name: FileName | None
) -> int | None:
    """The filter of an instrument with filters: labels of others repeat the Pancam wheel's."""
    if instrument not in mission.stereo_filters:
        return None
    if name is not None and name.filter_number > 0:
        return name.filter_number
    return label.optional(STATE, "FILTER_NUMBER", int)


def _sun_azimuth(label: Label) -> float | None:
    azimuth = label.optional_angle(SITE_GEOMETRY, "SOLAR_AZIMUTH")
    return None if azimuth is None else azimuth % math.tau


def _sun_elevation(label: Label, mission: Mission) -> float | None:
    """Elevation of the Sun with its sign corrected (see the module)."""
    elevation = label.optional_angle(SITE_GEOMETRY, "SOLAR_ELEVATION")
    if elevation is None:
        return None
    stated = label.optional_angle(ROVER_GEOMETRY, "INSTRUMENT_ELEVATION")
    true = _mast_elevation(label, mission)
    if stated is not None and true is not None and abs(true) > LEAST_ELEVATION:
        return elevation if abs(stated - true) <= abs(stated + true) else -elevation
    return abs(elevation) if _is_day(label) else elevation


def _mast_in_rover(
    label: Label, mission: Mission, instrument: str
) -> tuple[float, float, float] | None:
    """Origin of the mast frame in the rover frame, metres, for cameras on the mast."""
    if instrument.endswith("HAZCAM"):
        return None
    if label.get(mission.mast_group, "ORIGIN_OFFSET_VECTOR") is None:
        return None
    x, y, z = label.require_numbers(mission.mast_group, "ORIGIN_OFFSET_VECTOR", 3).tolist()
    return x, y, z


def _camera_celsius(label: Label, instrument: str) -> float | None:
    """Mean temperature of the mast's detectors, of those that were measured."""
    names = label.get(STATE, "INSTRUMENT_TEMPERATURE_NAME")
    if instrument.endswith("HAZCAM") or not isinstance(names, tuple):
        return None
    try:
        values = label.require_numbers(STATE, "INSTRUMENT_TEMPERATURE", len(names))
    except LabelError:
        return None  # optional: a broken value must not reject the image
    on_mast = np.array([bool(DETECTOR_ON_MAST.search(str(name))) for name in names], dtype=bool)
    measured = values[on_mast & (values != 0) & (np.abs(values) < MAX_CELSIUS)]
    return float(measured.mean()) if len(measured) else None


def _mast_elevation(label: Label, mission: Mission) -> float | None:
    """Elevation of the mast's x axis in the rover frame, from its quaternion."""
    if label.get(mission.mast_group, "ORIGIN_ROTATION_QUATERNION") is None:
        return None
    quaternion = label.require_numbers(mission.mast_group, "ORIGIN_ROTATION_QUATERNION", 4)
    try:
        forward = rotation_of_quaternion(quaternion)[:, 0]
    except FrameError as error:
        raise LabelError(f"{label.source}: {mission.mast_group}: {error}") from error
    return math.asin(max(-1.0, min(1.0, -float(forward[2]))))


def _local_solar_time(label: Label) -> str | None:
    """The local true solar time of the label; None where it is not valid."""
    text = label.optional("", "LOCAL_TRUE_SOLAR_TIME", str)
    return text if text is not None and _SOLAR_TIME.fullmatch(text) else None


def _is_day(label: Label) -> bool:
    """Whether the local solar time is by day; rovers photograph by day if it is not stated."""
    time = _SOLAR_TIME.fullmatch(label.optional("", "LOCAL_TRUE_SOLAR_TIME", str) or "")
    if time is None:
        return True
    return DAY_HOURS[0] <= int(time["hour"]) + int(time["minute"]) / 60 <= DAY_HOURS[1]
