"""Your own stereo rig: `rig.toml`, image pairs, and their poses.

    mission = "K10"                 # letters and digits: what maps and files are called after
    sol = 1                         # the day; images of one folder belong to one, 1 by default
    site = 0                        # the frame that poses are in, 0 by default
    poses = "poses.csv"             # the default, where there is such a file (`tables.pose_table`)
    calibration = "stereo.yaml"     # of both cameras (`calibrations`), or one per camera:

    [left]
    images = "left*.png"            # PNG or JPEG; * is what both images of a pair have in common
    calibration = "left.tsai"       # or the numbers themselves:
    model = "brown-conrady"         # or pinhole, or fisheye
    size_px = [1024, 768]
    focal_px = [620.9, 622.3]
    principal_px = [526.1, 374.3]   # (0, 0) is the centre of the first pixel
    distortion = [-0.33, 0.13, -0.0004, 0.0011]
    position_m = [0.0, -0.06, 0.0]  # in the rig: forward, right, down; looking forward, turned by
    pitch_deg = -20.0               # roll_deg, pitch_deg (up) and yaw_deg (right)

    [right]                         # likewise

    [mount]                         # of the rig on the rover: forward, right, down of its origin
    position_m = [0.1, 0.0, -0.9]
    pitch_deg = -20.0

Every pair is a separate stop: drive is the number in its name, or its index where names contain no
numbers. Poses are those of the rover in the frame of the site, north, east, down. Without poses the
first pair is the origin, level and facing north, and every other pair has its own map, because its
position is unknown.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from solmap.photogrammetry.archive.calibrations import (
    FORWARD_RIGHT_DOWN,
    CalibratedEye,
    Lens,
    camera_of,
    read_calibration,
)
from solmap.photogrammetry.archive.images.pixels import image_file_size
from solmap.photogrammetry.archive.missions import mission_id, mission_of_host
from solmap.photogrammetry.archive.tables.pose_table import PoseRow
from solmap.photogrammetry.errors import CameraError, FrameError, LabelError
from solmap.photogrammetry.frames import (
    Frame,
    FrameKind,
    Pose,
    rotation_of_quaternion,
    rotation_of_roll_pitch_yaw,
    site_frame,
)
from solmap.photogrammetry.imagery import MAX_COUNTER, Eye, RoverImage, StopId

RIG_FILE = "rig.toml"
POSES_FILE = "poses.csv"
INSTRUMENT = "STEREO"
_MISSION = re.compile(r"[A-Z][A-Z0-9]{0,15}", re.ASCII)
_PLACE = ("position_m", "roll_deg", "pitch_deg", "yaw_deg")
_LENS = ("model", "size_px", "focal_px", "principal_px", "distortion")
_EYE = ("images", "calibration", *_LENS, *_PLACE)
_RIG = ("mission", "sol", "site", "poses", "calibration", "mount", "left", "right")
SECONDS_APART = 10.0
"""Clock difference assigned to consecutive pairs: larger than the limit for images of one
exposure."""
OFF_MIDDLE = 0.15
"""Most distance of the principal point from the middle of an image, as a fraction of its size."""


@dataclass(frozen=True, slots=True)
class Rig:
    """Content of `rig.toml`."""

    mission: str
    sol: int
    site: int
    poses: str | None
    """Name of the poses CSV; None: `POSES_FILE`, if there is one."""
    images: Mapping[Eye, str]
    """File name patterns of each camera."""
    cameras: Mapping[Eye, CalibratedEye]
    """Cameras in the rover frame."""
    source: str


@dataclass(frozen=True, slots=True)
class RigShot:
    """An image of a rig, with everything its record needs except its size."""

    rig: Rig
    eye: Eye
    stop: StopId
    image_id: str
    sol: int
    clock: float
    site_from_rover: Pose

    def record(self, data: bytes, name: str, created: str | None) -> RoverImage:
        """The record of the image.

        Args:
            data: the file.
            name: its name, for messages.
            created: when calibration and poses were written.

        Raises:
            PixelError: it is not an image.
            LabelError: it has another size than its camera was calibrated for.
        """
        samples, lines = image_file_size(data, name)
        _check_size(self.rig.cameras[self.eye], samples, lines, name, self.rig.source)
        return RoverImage(
            id=self.image_id,
            stop=self.stop,
            sol=self.sol,
            instrument=INSTRUMENT,
            eye=self.eye,
            filter_number=None,
            clock=self.clock,
            motion_counter=(self.stop.site, self.stop.drive),
            sequence="",
            product_type="RAW",
            is_linearised=False,
            lines=lines,
            samples=samples,
            camera=self.rig.cameras[self.eye].camera,
            site_from_rover=self.site_from_rover,
            attitude_measured_by="UNKNOWN",
            local_solar_time=None,
            start_time=None,
            sun_azimuth=None,
            sun_elevation=None,
            created=created,
        )


def read_rig(text: str, source: str, read: Callable[[str], str]) -> Rig:
    """Read a `rig.toml` and its calibrations.

    Args:
        text: the file.
        source: its name, for messages.
        read: returns the text of a file named in it.

    Raises:
        LabelError: it cannot be read, or is incomplete; the message names the key and what is
            expected.
    """
    try:
        tree = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise LabelError(f"{source}: {error}") from error
    _check_keys(tree, _RIG, source)
    eyes = {eye: _table(tree, eye.value, _EYE, source) for eye in (Eye.LEFT, Eye.RIGHT)}
    mission = mission_id(_text(tree, "mission", source))
    if not _MISSION.fullmatch(mission):
        raise LabelError(
            f"{source}: mission should be up to 16 letters and digits, but is {mission[:40]!a}"
        )
    if mission_of_host(mission):
        raise LabelError(f"{source}: mission {mission} is a rover on Mars; choose another name")
    poses = _text(tree, "poses", source) if "poses" in tree else None
    mount = _pose(_table(tree, "mount", _PLACE, source) if "mount" in tree else {}, source)
    made = _cameras(tree, eyes, source, read)
    try:
        cameras = {
            eye: CalibratedEye(one.camera.transform(mount), one.size) for eye, one in made.items()
        }
    except CameraError as error:
        raise LabelError(f"{source}: {error}") from error
    base_m = np.linalg.norm(cameras[Eye.RIGHT].camera.centre - cameras[Eye.LEFT].camera.centre)
    if not base_m > 0:
        raise LabelError(
            f"{source}: both cameras have the same position; give position_m of [right], or a "
            "calibration of both cameras"
        )
    images = {eye: _pattern(table, eye, source) for eye, table in eyes.items()}
    if images[Eye.LEFT] == images[Eye.RIGHT]:
        raise LabelError(f"{source}: [left] and [right] should name different images")
    counts = (_count(tree, "sol", 1, source), _count(tree, "site", 0, source))
    return Rig(mission, *counts, poses, images, cameras, source)


def rig_shots(
    rig: Rig, files: Sequence[str], poses: Sequence[PoseRow] | None
) -> tuple[dict[str, RigShot], dict[str, str]]:
    """The images of a rig's folder, and the reasons why others are rejected, by file name.

    Args:
        rig: content of `rig.toml`.
        files: all image files below its folder, with `/` between folders.
        poses: rows of the poses CSV; None where there is none.
    """
    shots: dict[str, RigShot] = {}
    faults: dict[str, str] = {}
    pairs: dict[str, dict[Eye, str]] = {}
    patterns = {eye: _regex(pattern) for eye, pattern in rig.images.items()}
    for file in files:
        found = [(eye, match[1]) for eye, one in patterns.items() if (match := one.fullmatch(file))]
        if len(found) == 1:
            ((eye, name),) = found
            pairs.setdefault(name, {})[eye] = file
        else:
            expected = " nor ".join(rig.images.values())
            faults[file] = f"its name is neither {expected} of {rig.source}; it is left out"
    numbers = _numbers(pairs)
    whole = [name for name, pair in pairs.items() if len(pair) == len(Eye) - 1]
    in_order = sorted(whole, key=lambda name: (numbers[name], name))
    for name, pair in pairs.items():
        if name not in in_order:
            ((eye, file),) = pair.items()
            other = rig.images[Eye.RIGHT if eye is Eye.LEFT else Eye.LEFT].replace("*", name)
            faults[file] = f"its partner {other} is missing; deliver both images of a pair"
    for place, name in enumerate(in_order):
        pair = pairs[name]
        try:
            known = _place(rig, place, numbers[name], pair.values(), poses)
        except (FrameError, LabelError) as error:
            faults |= dict.fromkeys(pair.values(), str(error))
            continue
        stems = {eye: PurePosixPath(file).stem for eye, file in pair.items()}
        are_equal = len(set(stems.values())) == 1
        for eye, file in pair.items():
            stem = f"{stems[eye]}-{eye[0]}" if are_equal else stems[eye]
            image_id = _identifier(f"{rig.mission}_S{rig.site:03d}_{stem}")
            clock = SECONDS_APART * (1 + numbers[name])
            shots[file] = RigShot(rig, eye, known[0], image_id, known[1], clock, known[2])
    return shots, faults


def _place(
    rig: Rig, place: int, number: int, files: Iterable[str], poses: Sequence[PoseRow] | None
) -> tuple[StopId, int, Pose]:
    """Stop, sol and pose of a pair.

    Raises:
        LabelError: there are poses, but none for it, or one without attitude.
    """
    if poses is None:
        stop = StopId(rig.mission, rig.site + place, number)
        return stop, rig.sol, Pose.identity(site_frame(stop.site), stop.frame)
    names = {PurePosixPath(file).name.partition(".")[0].upper() for file in files}
    rows = [row for row in poses if row.image in names]
    rows += [row for row in poses if (row.image, row.site, row.drive) == (None, rig.site, number)]
    if not rows:
        first = min(names).lower()
        raise LabelError(
            f"no row of the poses CSV matches it; add one with image = {first}, or with site = "
            f"{rig.site} and drive = {number}"
        )
    row = rows[0]
    if row.quaternion is None:
        raise LabelError(f"{row.where} has no attitude; give roll_deg, pitch_deg and yaw_deg")
    site = rig.site if row.site is None else row.site
    stop = StopId(rig.mission, site, number if row.drive is None else row.drive)
    frame = site_frame(site if row.reference_site is None else row.reference_site)
    pose = Pose(frame, stop.frame, rotation_of_quaternion(row.quaternion), row.position_m)
    return stop, rig.sol if row.sol is None else row.sol, pose


def _numbers(names: Iterable[str]) -> dict[str, int]:
    """A number for every pair: that in its name, or else its index."""
    known = sorted(names)
    stated = [int(name) for name in known if re.fullmatch(r"\d{1,7}", name, re.ASCII)]
    if len(set(stated)) == len(known) and max(stated, default=0) < MAX_COUNTER:
        return {name: int(name) for name in known}
    return {name: place for place, name in enumerate(known)}


def _identifier(text: str) -> str:
    return re.sub(r"[^A-Z0-9_.()+-]", "-", text.upper(), flags=re.ASCII)[:100]


def _regex(pattern: str) -> re.Pattern[str]:
    before, _, after = pattern.partition("*")
    return re.compile(f"{re.escape(before)}([^/]+){re.escape(after)}")


def _check_size(eye: CalibratedEye, samples: int, lines: int, name: str, source: str) -> None:
    if eye.size is not None:
        if eye.size != (samples, lines):
            raise LabelError(
                f"{name}: {samples} x {lines} pixels, but its camera in {source} is calibrated "
                f"for {eye.size[0]} x {eye.size[1]}; deliver images of that size, or calibrate "
                "again"
            )
        return
    ahead = eye.camera.rays(np.array([[(samples - 1) / 2, (lines - 1) / 2]]))
    principal = _principal_px(eye)
    off = np.abs(principal - [(samples - 1) / 2, (lines - 1) / 2]) / [samples, lines]
    if not (off <= OFF_MIDDLE).all() or not np.isfinite(ahead).all():
        raise LabelError(
            f"{name}: {samples} x {lines} pixels, but the principal point of its camera in "
            f"{source} is {principal.round(1).tolist()}; it was calibrated at another size"
        )


def _principal_px(eye: CalibratedEye) -> np.ndarray:
    camera = eye.camera
    if hasattr(camera, "principal_px"):
        return np.array(camera.principal_px)
    return camera.project((camera.centre + camera.a)[None])[0]


def _cameras(
    tree: Mapping[str, Any],
    eyes: Mapping[Eye, Mapping[str, Any]],
    source: str,
    read: Callable[[str], str],
) -> dict[Eye, CalibratedEye]:
    """The cameras in the rig: from a common calibration, one each, or the given numbers."""
    if "calibration" in tree:
        name = _text(tree, "calibration", source)
        both = read_calibration(read(name), name)
        if len(both) != len(eyes):
            raise LabelError(f"{name}: one camera; name it under [left] or [right] of {source}")
        return dict(zip(eyes, both, strict=True))
    cameras = {}
    for eye, table in eyes.items():
        where = f"{source}: [{eye}]"
        if "calibration" not in table:
            cameras[eye] = _of_numbers(table, where)
            continue
        name = _text(table, "calibration", where)
        found = read_calibration(read(name), name)
        if len(found) != 1:
            raise LabelError(f"{name}: both cameras; name it in the first lines of {source}")
        pose = _pose(table, where)
        cameras[eye] = CalibratedEye(found[0].camera.transform(pose), found[0].size)
    return cameras


def _of_numbers(table: Mapping[str, Any], where: str) -> CalibratedEye:
    if "model" not in table:
        raise LabelError(f"{where} names no calibration and no model")
    samples, lines = (int(size) for size in _list(table, "size_px", 2, where))
    pose = _pose(table, where)
    lens = Lens(
        _text(table, "model", where),
        _list(table, "focal_px", 2, where),
        _list(table, "principal_px", 2, where),
        _list(table, "distortion", None, where) if "distortion" in table else (),
    )
    axes = FORWARD_RIGHT_DOWN @ pose.rotation.T
    return CalibratedEye(camera_of(lens, pose.translation_m, axes, where), (samples, lines))


def _pose(table: Mapping[str, Any], where: str) -> Pose:
    """Pose of a camera in its rig, or of the rig on its rover."""
    position_m = _list(table, "position_m", 3, where) if "position_m" in table else np.zeros(3)
    angles = [np.radians(_number(table, f"{name}_deg", where)) for name in ("roll", "pitch", "yaw")]
    rover, camera = Frame(FrameKind.ROVER), Frame(FrameKind.CAMERA)
    return Pose(rover, camera, rotation_of_roll_pitch_yaw(*angles), np.array(position_m))


def _pattern(table: Mapping[str, Any], eye: Eye, source: str) -> str:
    pattern = _text(table, "images", f"{source}: [{eye}]")
    if pattern.count("*") != 1:
        raise LabelError(
            f"{source}: images of [{eye}] should contain one *, the common part of both names of "
            f"a pair, but is {pattern[:40]!a}"
        )
    return pattern.removeprefix("./")


def _table(
    tree: Mapping[str, Any], name: str, keys: Sequence[str], source: str
) -> Mapping[str, Any]:
    table = tree.get(name)
    if not isinstance(table, dict):
        raise LabelError(f"{source}: the table [{name}] is missing")
    _check_keys(table, keys, f"{source}: [{name}]")
    return table


def _check_keys(table: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    unknown = sorted(set(table) - set(keys))
    if unknown:
        raise LabelError(f"{where} has no setting {unknown[0][:40]!a}; it has {', '.join(keys)}")


def _text(table: Mapping[str, Any], key: str, where: str) -> str:
    value = table.get(key)
    if not isinstance(value, str) or not value.strip():
        raise LabelError(f"{where}: {key} should be a text, but is {value!a:.40}")
    return value


def _count(table: Mapping[str, Any], key: str, default: int, where: str) -> int:
    value = table.get(key, default)
    if type(value) is not int or not 0 <= value < MAX_COUNTER:
        raise LabelError(f"{where}: {key} should be a whole number, but is {value!a:.40}")
    return value


def _number(table: Mapping[str, Any], key: str, where: str) -> float:
    return _list({key: [table.get(key, 0.0)]}, key, 1, where)[0]


def _list(table: Mapping[str, Any], key: str, count: int | None, where: str) -> list[float]:
    """A list of a number of finite values; None: any number of them."""
    value = table.get(key)
    given = value if isinstance(value, list) else []
    numbers = [float(one) for one in given if type(one) in (int, float)]
    wrong = len(numbers) != (len(given) if count is None else count) or given is not value
    if wrong or not np.isfinite(numbers).all():
        expected = "a list of numbers" if count is None else f"{count} number{'s' * (count > 1)}"
        raise LabelError(f"{where}: {key} should be {expected}, but is {value!a:.60}")
    return numbers
