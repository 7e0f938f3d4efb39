"""Frames, the poses between them, and the tree they form.

A rover's images pass through a chain of right-handed Cartesian frames (Di et al. 2008, section 2):

    pair    origin at the left camera, x along the stereo base, y down, z along the view
    rover   origin between the middle wheels, x forward, y right, z down
    site    origin where the site was declared, x north, y east, z down
    LSL     landing site local: the site frame at the lander (site 0)

A pose is the rigid motion that transforms a point of its source frame to its target frame,

    p_target = R p_source + t,      R = R(q),  q = (s, v1, v2, v3)  scalar first,

and is written `target_from_source`, so that chains cancel: `lsl_from_site @ site_from_rover`.
With q the quaternion of the label, R(q) is JPL's matrix (named frame into its reference frame):

    R = [[1-2(v2²+v3²),  2(v1v2-s v3),  2(v1v3+s v2)],
         [2(v1v2+s v3),  1-2(v1²+v3²),  2(v2v3-s v1)],
         [2(v1v3-s v2),  2(v2v3+s v1),  1-2(v1²+v2²)]]
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from math import isfinite
from typing import Any

import numpy as np

from solmap.photogrammetry.arrays import (
    Directions,
    Float64,
    ObjectPoints,
    Quaternion,
    Rotation,
    Vector3,
)
from solmap.photogrammetry.errors import FrameError


class FrameKind(StrEnum):
    """What a frame is fixed to."""

    PAIR = "pair"
    CAMERA = "camera"
    MAST = "mast"
    ROVER = "rover"
    LOCAL_LEVEL = "local level"
    SITE = "site"
    LSL = "lsl"


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame, with the counters that distinguish it from others of its kind.

    `index` is (site, drive) for the rover, (site,) for a site, empty for the LSL, and (site, drive,
    spacecraft clock, ...) or another identifier for a camera or stereo pair.
    """

    kind: FrameKind
    index: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.kind}[{', '.join(map(str, self.index))}]" if self.index else str(self.kind)


LSL = Frame(FrameKind.LSL)


def site_frame(site: int) -> Frame:
    """The frame of a site."""
    return Frame(FrameKind.SITE, (site,))


def rover_frame(site: int, drive: int) -> Frame:
    """The frame of the rover at (site, drive)."""
    return Frame(FrameKind.ROVER, (site, drive))


UNIT_TOLERANCE = 0.01
"""Labels with two decimals still give a quaternion of unit length within it."""


@cache
def _scipy_rotation() -> type[Any]:
    """SciPy's rotations, imported when first used, because file listings do not need them."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - takes 0.3 s

    return Rotation


def rotation_of_quaternion(quaternion: Quaternion) -> Rotation:
    """Rotation matrix of a quaternion, scalar first; normalised here, since labels are rounded."""
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1.0) <= UNIT_TOLERANCE:
        raise FrameError(f"{quaternion} is not a unit quaternion: its length is {norm:.3g}")
    return _scipy_rotation().from_quat(quaternion / norm, scalar_first=True).as_matrix()


def quaternion_of_rotation(rotation: Rotation) -> Quaternion:
    """Unit quaternion of a rotation matrix, scalar first and not negative."""
    return _scipy_rotation().from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


def rotation_of_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Rotation:
    """R = Rz(yaw) Ry(pitch) Rx(roll), in radians: the rover's attitude in its site."""
    return _scipy_rotation().from_euler("ZYX", [yaw, pitch, roll]).as_matrix()


def roll_pitch_yaw_of_rotation(rotation: Rotation) -> tuple[float, float, float]:
    """(roll, pitch, yaw) in radians; yaw is the azimuth of the x axis, clockwise from north."""
    yaw, pitch, roll = _scipy_rotation().from_matrix(rotation).as_euler("ZYX")
    return float(roll), float(pitch), float(yaw)


def read_only(
    values: Iterable[float] | np.ndarray, shape: tuple[int, ...], what: str | Callable[[], str]
) -> np.ndarray:
    """A read-only float64 copy of `values`, checked to be finite and of the given shape."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not all(map(isfinite, array.ravel().tolist())):
        name = what if isinstance(what, str) else what()
        raise FrameError(f"{name} must be {shape} finite numbers, not {array.tolist()}")
    array.setflags(write=False)
    return array


ORTHONORMAL = 1e-9
"""Largest deviation of the scalar products of a rotation's rows from zero and one."""


def _is_proper_rotation(matrix: Rotation) -> bool:
    """Whether rows are orthonormal and right-handed; fast, for thousands of poses."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    off = max(
        abs(a * a + b * b + c * c - 1.0), abs(d * d + e * e + f * f - 1.0),
        abs(g * g + h * h + i * i - 1.0), abs(a * d + b * e + c * f),
        abs(a * g + b * h + c * i), abs(d * g + e * h + f * i),
    )  # fmt: skip
    return (
        off <= ORTHONORMAL and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    )


def _are_proper_rotations(matrices: Float64[np.ndarray, "n 3 3"]) -> bool:
    """Whether each of many matrices is a proper rotation."""
    off = np.abs(matrices @ matrices.mT.copy() - np.eye(3))  # NaN where anything is not finite
    a, b, c, d, e, f, g, h, i = matrices.reshape(-1, 9).T
    volume = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return bool((off <= ORTHONORMAL).all() and (volume > 0).all())


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """The motion from `source` to `target`: p_target = rotation p_source + translation_m."""

    target: Frame
    source: Frame
    rotation: Rotation
    translation_m: Vector3

    def __post_init__(self) -> None:
        rotation = read_only(self.rotation, (3, 3), lambda: f"the rotation of {self}")
        if not _is_proper_rotation(rotation):
            raise FrameError(f"the rotation of {self} is not a proper rotation matrix")
        object.__setattr__(self, "rotation", rotation)
        translation_m = read_only(self.translation_m, (3,), lambda: f"the translation of {self}")
        object.__setattr__(self, "translation_m", translation_m)

    def __str__(self) -> str:
        return f"{self.target}_from_{self.source}"

    @classmethod
    def many(
        cls,
        frames: Iterable[tuple[Frame, Frame]],
        rotations: Float64[np.ndarray, "n 3 3"],
        translations_m: Float64[np.ndarray, "n 3"],
    ) -> list[Pose]:
        """Poses by (target, source), checked all at once, because networks have thousands."""
        between = list(frames)
        if not (np.isfinite(translations_m).all() and _are_proper_rotations(rotations)):
            both = zip(between, rotations, translations_m, strict=True)
            # checking one by one raises the error of the wrong one
            return [cls(*ends, R, t) for ends, R, t in both]
        R, t = rotations.copy(), translations_m.copy()
        R.setflags(write=False)
        t.setflags(write=False)
        poses = []
        for (target, source), rotation, translation_m in zip(between, R, t, strict=True):
            pose = object.__new__(cls)
            object.__setattr__(pose, "target", target)
            object.__setattr__(pose, "source", source)
            object.__setattr__(pose, "rotation", rotation)
            object.__setattr__(pose, "translation_m", translation_m)
            poses.append(pose)
        return poses

    @classmethod
    def of_quaternion(
        cls, target: Frame, source: Frame, quaternion: Quaternion, translation_m: Vector3
    ) -> Pose:
        """The pose of a label: quaternion and origin of `source` given in `target`."""
        return cls(target, source, rotation_of_quaternion(quaternion), translation_m)

    @classmethod
    def identity(cls, target: Frame, source: Frame) -> Pose:
        """The pose of two frames that coincide."""
        return cls(target, source, np.eye(3), np.zeros(3))

    @property
    def quaternion(self) -> Quaternion:
        """The rotation as a quaternion, scalar first."""
        return quaternion_of_rotation(self.rotation)

    @property
    def inverse(self) -> Pose:
        """The inverse motion."""
        return Pose(
            self.source, self.target, self.rotation.T, -self.rotation.T @ self.translation_m
        )

    def apply(self, points: ObjectPoints) -> ObjectPoints:
        """Transform points of the source frame to the target frame, metres."""
        return points @ self.rotation.T + self.translation_m

    def turn(self, directions: Directions) -> Directions:
        """Rotate directions of the source frame to the target frame."""
        return directions @ self.rotation.T

    def __matmul__(self, other: Pose) -> Pose:
        if self.source != other.target:
            raise FrameError(
                f"{self.target}_from_{self.source} cannot follow {other.target}_from_{other.source}"
                f": {self.source} and {other.target} differ"
            )
        return Pose(
            self.target,
            other.source,
            self.rotation @ other.rotation,
            self.rotation @ other.translation_m + self.translation_m,
        )


@dataclass(frozen=True, slots=True)
class FrameTree:
    """Every frame's pose in its parent; frames are connected through their ancestors."""

    parent_from: Mapping[Frame, Pose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for frame, pose in self.parent_from.items():
            if pose.source != frame:
                raise FrameError(f"the pose filed under {frame} starts in {pose.source}")

    def with_poses(self, poses: Iterable[Pose]) -> FrameTree:
        """A tree that also holds `poses`, each of a frame in its parent; later ones win."""
        return FrameTree({**self.parent_from, **{pose.source: pose for pose in poses}})

    def pose(self, target: Frame, source: Frame) -> Pose:
        """`target_from_source`, through the nearest common ancestor.

        Raises:
            FrameError: no chain of poses connects the two; the message names the end of each chain.
        """
        up_from_source = self._ancestry(source)
        up_from_target = self._ancestry(target)
        for frame, ancestor_from_target in up_from_target.items():
            if frame in up_from_source:
                return ancestor_from_target.inverse @ up_from_source[frame]
        raise FrameError(
            f"{target} and {source} are not connected: the chain from {target} ends at "
            f"{list(up_from_target)[-1]}, the chain from {source} at {list(up_from_source)[-1]}"
        )

    def root_of(self, frame: Frame) -> Frame:
        """The last ancestor that the chain from `frame` reaches."""
        return list(self._ancestry(frame))[-1]

    def _ancestry(self, frame: Frame) -> dict[Frame, Pose]:
        """`ancestor_from_frame` for every ancestor of `frame`, itself first."""
        up = {frame: Pose.identity(frame, frame)}
        here = frame
        while here in self.parent_from:
            step = self.parent_from[here]
            if step.target in up:
                raise FrameError(f"the chain of frames from {frame} forms a loop at {here}")
            up[step.target] = step @ up[here]
            here = step.target
        return up
