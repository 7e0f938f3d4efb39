"""The common interface of camera models."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from solmap.photogrammetry.arrays import Directions, ImagePoints, ObjectPoints, Vector3
from solmap.photogrammetry.frames import Pose


@runtime_checkable
class CameraModel(Protocol):
    """Maps between image and object space; `Cahv`, `Cahvor`, `Cahvore`, `BrownConrady`, `Fisheye`.

    A model is in one frame, usually that of the rover; the model itself does not store which.
    """

    @property
    def centre(self) -> Vector3:
        """The projection centre C, metres."""

    def project(self, points: ObjectPoints) -> ImagePoints:
        """Image of object points; rows of points behind the camera are NaN."""

    def rays(self, image_points: ImagePoints) -> Directions:
        """Unit directions from the camera through image points."""

    def ray_origins(self, image_points: ImagePoints) -> ObjectPoints:
        """Origins of these rays, metres: the centre, unless the entrance pupil moves."""

    def transform(self, target_from_model: Pose) -> CameraModel:
        """The same camera, expressed in the target frame of a pose."""
