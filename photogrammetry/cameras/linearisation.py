"""JPL's linearisation of 2002: the CAHV models of the archived FFL, RSL ... products.

Both cameras of a pair get a common image plane. Its axis is the mean of the two central rays r_1,
r_2, its rows are parallel to the baseline b = C_2 - C_1 (with the sign such that b.H_1 > 0)
projected along that axis,

    A = unit(r_1 + r_2)      v' = unit(A x b)      h' = unit(v' x A),

and its scales fit the field of view at the middles of the image edges: with s the smallest (Navcam)
or largest (Pancam) |A x ray| of both cameras over the left and right edges,

    h_s = sqrt((n/2 / s)^2 - (n/2)^2)        H = h_s h' + h_c A        h_c = (n - 1) / 2

for n samples, and likewise for V with the lines and the upper and lower edges. A is not quite
perpendicular to the base, so rows of such a pair correspond only approximately, and the pixels are
not square. Source: `cmod_cahvor_warp_models` of the MER era, checked against two archived labels.
Grey values are interpolated bilinearly; pixels outside the original are masked, where JPL writes 0.

Mapping uses `photogrammetry.cameras.epipolar` instead; this rule is for comparison with archived
products and for viewers that expect them.
"""

from __future__ import annotations

from enum import StrEnum

import cv2
import numpy as np

from solmap.photogrammetry.arrays import GreyImage, Mask, Vector3
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.errors import CameraError

WHOLE = 0.999
"""Weight of four usable neighbours, minus rounding."""


class Field(StrEnum):
    """Field of view of the common image plane."""

    SMALLEST = "smallest"
    """No empty edges; Navcam products."""
    LARGEST = "largest"
    """No pixel lost, empty edges; Pancam products."""


def linearise_pair(
    first: Cahvor, second: Cahvor, samples: int, lines: int, field: Field = Field.SMALLEST
) -> tuple[Cahv, Cahv]:
    """The CAHV models of both eyes, each with its own centre and one common image plane.

    Raises:
        CameraError: the cameras have no baseline, or no common field of view.
    """
    axis, down, right = _common_axes(first, second, samples, lines)
    cameras = (first, second)
    middle_sample, middle_line = (samples - 1) / 2, (lines - 1) / 2
    sides = np.array([[0.0, middle_line], [samples - 1.0, middle_line]])
    ends = np.array([[middle_sample, 0.0], [middle_sample, lines - 1.0]])
    h = _scale(cameras, axis, sides, samples, field) * right + middle_sample * axis
    v = _scale(cameras, axis, ends, lines, field) * down + middle_line * axis
    return Cahv(first.c, axis, h, v), Cahv(second.c, axis, h, v)


def linearise_image(
    image: GreyImage, mask: Mask, camera: Cahvor, linear: Cahv
) -> tuple[GreyImage, Mask]:
    """Resample an image as taken by a linear camera at the same position.

    Args:
        image: grey values of the original.
        mask: its usable pixels.
        camera: its camera model.
        linear: the model of the result, with the same size.

    Returns:
        Grey values, 0 where masked, and the mask of pixels to which only usable ones contribute.
    """
    lines, samples = image.shape
    x, y = np.meshgrid(np.arange(float(samples)), np.arange(float(lines)))
    rays = linear.rays(np.column_stack([x.ravel(), y.ravel()]))
    source = camera.project(camera.c + rays).reshape(lines, samples, 2).astype(np.float32)
    usable = mask.astype(np.float32)
    weight = cv2.remap(usable, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
    grey = cv2.remap(image, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
    whole = np.asarray(weight) > WHOLE
    return np.where(whole, grey, np.float32(0)), whole


def _common_axes(
    first: Cahvor, second: Cahvor, samples: int, lines: int
) -> tuple[Vector3, Vector3, Vector3]:
    """Unit vectors forward, down and right of the common image plane."""
    base = second.c - first.c
    if not np.linalg.norm(base) > 0:
        raise CameraError("two cameras at one position have no baseline to linearise along")
    base = base if base @ first.h >= 0 else -base
    middle = np.array([[samples / 2, lines / 2]])
    axis = _unit(first.rays(middle)[0] + second.rays(middle)[0])
    down = _unit(np.cross(axis, base))
    return axis, down, _unit(np.cross(down, axis))


def _scale(
    cameras: tuple[Cahvor, Cahvor], axis: Vector3, edges: np.ndarray, size: int, field: Field
) -> float:
    """Focal length in pixels at which the edge rays just fill `size` pixels."""
    sines = [np.linalg.norm(np.cross(axis, camera.rays(edges)), axis=1) for camera in cameras]
    sine = float(np.min(sines) if field is Field.SMALLEST else np.max(sines))
    if not 0 < sine < 1:
        raise CameraError(f"the edges of the pair lie {sine:.3g} (sine) from its mean axis")
    return size / 2 * float(np.sqrt(1 / sine**2 - 1))


def _unit(vector: Vector3) -> Vector3:
    return vector / np.linalg.norm(vector)
