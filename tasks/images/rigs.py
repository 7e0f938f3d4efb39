"""Images of an own stereo rig in a delivery: a folder with a `rig.toml` (`archive.rig`).

They become images of the store with a record, including camera and pose, as their label, so that
all later steps read them like any other image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath

from solmap.photogrammetry.archive.images.record_json import label_of_text, text_of_label
from solmap.photogrammetry.archive.labels.detached import join_label, split_label
from solmap.photogrammetry.archive.rig import POSES_FILE, RIG_FILE, RigShot, read_rig, rig_shots
from solmap.photogrammetry.archive.tables.pose_table import parse_poses
from solmap.photogrammetry.errors import LabelError, PhotogrammetryError
from solmap.products.store.user_files import MAX_ROWS_BYTES, plain_name, read_user_file, reason_of
from solmap.tasks.images.folders import IMAGE_FILE_SUFFIXES


@dataclass(frozen=True, slots=True, eq=False)
class RigImages:
    """The images of all rigs in a delivery."""

    shots: dict[Path, tuple[RigShot, str]] = field(default_factory=dict)
    """Data of each except its size, and the last change of its calibration or poses."""
    faults: dict[Path, str] = field(default_factory=dict)
    """Images that cannot be ingested and files of rigs that cannot be used, with the reasons."""
    unusable: set[Path] = field(default_factory=set)
    """Images of rigs whose own file has an error, which is reported only once."""


def rig_images(files: Sequence[Path], downlink: Path) -> RigImages:
    """The images among the files of a delivery in or below a folder with a `rig.toml`."""
    found = RigImages()
    by_folder: dict[Path, list[Path]] = {}
    for file in files:
        folder = _rig_folder(file, downlink)
        if folder is not None:
            by_folder.setdefault(folder, []).append(file)
    for folder, images in by_folder.items():
        _add_folder(folder, images, downlink, found)
    return found


def rig_image_bytes(
    shot: RigShot, created: str, data: bytes, name: str, kept: bytes | None
) -> bytes:
    """An image joined to its record, which is its label.

    Args:
        shot: Its data.
        created: Last change of its calibration or poses.
        data: The file.
        name: Its name, for messages.
        kept: The image in the store, if any; it is kept if only the date differs.
    """
    record = shot.record(data, name, created)
    if kept is not None:
        label, pixels = split_label(kept, name)
        before = None if label is None else label_of_text(label.decode(), name)
        if before is not None and pixels == data:
            same = replace(record, created=before.created)
            record = same if text_of_label(same) == text_of_label(before) else record
    return join_label(text_of_label(record).encode(), data, name)


def _rig_folder(file: Path, downlink: Path) -> Path | None:
    """The nearest folder of an image that has a `rig.toml`, not above the delivery's."""
    if file.suffix.lower() not in IMAGE_FILE_SUFFIXES:
        return None
    for folder in file.parents:
        if not folder.is_relative_to(downlink):
            return None
        if (folder / RIG_FILE).is_file():
            return folder
    return None


def _add_folder(folder: Path, images: Sequence[Path], downlink: Path, found: RigImages) -> None:
    """Add the images of one rig to those found."""
    rig_file = folder / RIG_FILE
    read: list[Path] = []

    def text_of(name: str) -> str:
        path = folder / name
        read.append(path)
        return _text_of(path, name, downlink)

    names = {image.relative_to(folder).as_posix(): image for image in images}
    try:
        rig = read_rig(text_of(RIG_FILE), RIG_FILE, text_of)
        poses_file = rig.poses or (POSES_FILE if (folder / POSES_FILE).is_file() else None)
        poses = None if poses_file is None else parse_poses(text_of(poses_file), poses_file)
        shots, faults = rig_shots(rig, list(names), poses)
    except PhotogrammetryError as error:
        found.faults[rig_file] = str(error)
        found.unusable.update(images)
        return
    latest = max(path.stat().st_mtime for path in read)
    created = datetime.fromtimestamp(latest, UTC).isoformat(timespec="seconds")
    found.shots.update({names[name]: (shot, created) for name, shot in shots.items()})
    found.faults.update({names[name]: f"{name}: {why}" for name, why in faults.items()})


def _text_of(path: Path, name: str, downlink: Path) -> str:
    """The text of a file named in a rig's description.

    Raises:
        LabelError: it is elsewhere, or cannot be read.
    """
    place = PurePosixPath(name)
    if place.is_absolute() or ".." in place.parts:
        raise LabelError(f"{plain_name(name)} should be in the folder of {RIG_FILE} or below it")
    try:
        data = read_user_file(path, downlink, most_bytes=MAX_ROWS_BYTES)
    except OSError as error:
        raise LabelError(
            f"{plain_name(name)} cannot be read: {reason_of(error)}; it should be in the folder "
            f"of {RIG_FILE}"
        ) from error
    return data.decode("utf-8", "replace")
