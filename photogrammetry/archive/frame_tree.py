"""The whole tree of frames: camera, mast, rover, site, LSL and the body of Mars.

    body <- LSL <- site <- rover <- mast <- camera

Of a label come the rover in its site, the mast's head in the rover, the site in its parent (after
MER) and the camera, whose frame is right, down, forward with the origin in C (see
`cameras.photogrammetric`). Vector files and PLACES tables place sites and stops by priority; the
landing point ties the LSL to Mars. Along the chain the paper's equations (1) and (2) hold:

    M = M_R M_S M_0          C = M_0' (M_S' C_R + T_S) + T_0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from solmap.photogrammetry.archive.images.rover_image import Camera, camera_model
from solmap.photogrammetry.archive.labels.label import Label
from solmap.photogrammetry.archive.missions import Mission
from solmap.photogrammetry.archive.tables.vector_files import VectorFile, best_poses, lsl_tree
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.cameras.photogrammetric import photogrammetric
from solmap.photogrammetry.errors import FrameError, LabelError
from solmap.photogrammetry.frames import Frame, FrameKind, FrameTree, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.mars import MarsPoint, body_from_lsl


def mast_frame(stop: StopId, clock: float) -> Frame:
    """The head of the mast as it pointed for an exposure."""
    return Frame(FrameKind.MAST, (stop.site, stop.drive, int(clock)))


def rover_from_mast(label: Label, mission: Mission, mast: Frame, rover: Frame) -> Pose | None:
    """The mast's head in the rover frame, or None where the label does not say.

    Raises:
        LabelError: what it says is no pose.
    """
    group = mission.mast_group
    if label.get(group, "ORIGIN_ROTATION_QUATERNION") is None:
        return None
    quaternion = label.require_numbers(group, "ORIGIN_ROTATION_QUATERNION", 4)
    offset_m = label.require_numbers(group, "ORIGIN_OFFSET_VECTOR", 3)
    try:
        return Pose.of_quaternion(rover, mast, quaternion, offset_m)
    except FrameError as error:
        raise LabelError(f"{label.source}: {group}: {error}") from error


def rover_from_camera(camera: Camera, frame: Frame, rover: Frame) -> Pose:
    """The camera right, down, forward, of a model in the rover frame."""
    model = camera.perspective if isinstance(camera, Cahvore) else camera
    orientation = photogrammetric(model)
    return Pose(rover, frame, orientation.camera_from_frame.T, orientation.centre)


def frames_of_label(label: Label, mission: Mission, stop: StopId, clock: float) -> tuple[Pose, ...]:
    """Mast and camera of an image, each in its parent, for a tree that holds its rover.

    Raises:
        LabelError: the label has no camera model, or what it says is no pose.
    """
    camera = Frame(FrameKind.CAMERA, (stop.site, stop.drive, int(clock)))
    in_rover = rover_from_camera(camera_model(label), camera, stop.frame)
    mast = mast_frame(stop, clock)
    on_mast = rover_from_mast(label, mission, mast, stop.frame)
    if on_mast is None:
        return (in_rover,)
    return on_mast, on_mast.inverse @ in_rover


def mars_tree(
    files: Sequence[VectorFile], of_labels: Iterable[Pose], landing_point: MarsPoint | None
) -> FrameTree:
    """Everything that labels and files place, under the LSL and, with a landing point, under Mars.

    Poses of vector files go before those of labels, which are telemetry of one moment.
    """
    tree = lsl_tree([*of_labels, *best_poses(files)]).tree
    return tree if landing_point is None else tree.adding([body_from_lsl(landing_point)])
