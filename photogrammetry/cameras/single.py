"""The ideal camera of a single image: square pixels, no distortion, rows level with the camera's.

An image without a stereo partner takes part in ties and adjustment as the left half of a pair whose
right half is never measured: axis A of the camera (right, down, forward = H', A x H', A), focal
length and size those of the original. `NO_BASE_M` stands where a pair has its base; it is the unit
of a parallax that nothing observes.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Directions, ImagePoints
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, border_points
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Frame, Pose

NO_BASE_M = 1.0
"""Any length would do."""
STEP_PX = 4.0
"""Over which directions are differenced in the middle of the image."""


def single_image(
    camera: CameraModel, size: tuple[int, int], rover: Frame, frame: Frame
) -> EpipolarPair:
    """The geometry that an image without partner is resampled to; `size` is (samples, lines).

    `camera` lives in the rover frame; the result covers all that the image shows.

    Raises:
        CameraError: the image spans 180 degrees or more.
    """
    middle = (np.array([size], dtype=np.float64) - 1.0) / 2.0
    steps = np.array([[0.0, 0.0], [-STEP_PX, 0.0], [STEP_PX, 0.0], [0.0, -STEP_PX], [0.0, STEP_PX]])
    ahead, left, right, above, below = camera.rays(middle + steps)
    across = right - left - ((right - left) @ ahead) * ahead
    x = across / np.linalg.norm(across)
    rotation = np.column_stack([x, np.cross(ahead, x), ahead])
    slopes = [
        np.linalg.norm(b / (b @ ahead) - a / (a @ ahead))
        for a, b in ((left, right), (above, below))
    ]
    focal_px = float(np.mean([2.0 * STEP_PX / slope for slope in slopes]))
    edge = _on_plane(camera.rays(border_points(size)) @ rotation, camera) * focal_px
    low, high = edge.min(axis=0), edge.max(axis=0)
    samples, lines = np.round(high - low).astype(int).tolist()
    return EpipolarPair(
        rover_from_pair=Pose(rover, frame, rotation, camera.centre),
        base_m=NO_BASE_M,
        focal_px=focal_px,
        centre_px=(float(-low[0]) - 0.5, float(-low[1]) - 0.5),
        samples=samples,
        lines=lines,
    )


def _on_plane(rays: Directions, camera: CameraModel) -> ImagePoints:
    """Where rays meet the plane at distance one."""
    if (rays[:, 2] <= 0).any():
        raise CameraError(
            f"the camera at {camera.centre} sees more than 180 degrees: no plane holds its image"
        )
    return rays[:, :2] / rays[:, 2:]
