"""The eyes of a wide instrument: which pairs of two stops look at the same far ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, ParallaxMap, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.frames import Pose

OriginalImage = Float32[np.ndarray, "rows cols"]
OriginalMask = Bool[np.ndarray, "rows cols"]
"""Of the image as taken, whose size is not that of the epipolar images."""


@dataclass(frozen=True, slots=True)
class InstrumentLimits:
    """Which two pairs make an instrument."""

    least_base_m: float = 2.0
    """Shorter bases are no gain over the bar in ground it maps itself."""
    largest_base_m: float = 40.0
    """Longer bases see the ground from too different sides until beyond what is asked for."""
    least_angle: float = float(np.deg2rad(30.0))
    """Between the base and either view: half of the base counts at 30 degrees."""
    largest_turn: float = float(np.deg2rad(30.0))
    """Between the views: two thirds of a Navcam's field, of which a third is then shared."""


@runtime_checkable
class Looking(Protocol):
    """What can be chosen for an eye: `WideEye` is one, and so is a pair that is not read yet."""

    @property
    def centre(self) -> Vector3:
        """Where it stands, in the LSL, metres."""

    @property
    def view(self) -> Vector3:
        """Direction of the middle of its image, in the LSL, of length one."""


L = TypeVar("L", bound=Looking)


@dataclass(frozen=True, slots=True, eq=False)
class WideEye:
    """A matched pair of a stop, of which the left image is one eye of the wide instrument."""

    pair_id: str
    image: OriginalImage
    """The left image as taken."""
    mask: OriginalMask
    camera: CameraModel
    """Its camera, in the LSL."""
    bar: EpipolarPair
    lsl_from_bar: Pose
    parallax: ParallaxMap
    """Dense parallax of the pair itself, on the grid of `bar`."""

    @property
    def size(self) -> tuple[int, int]:
        """Samples and lines of the image."""
        return self.image.shape[1], self.image.shape[0]

    @property
    def centre(self) -> Vector3:
        """Perspective centre of the left camera, in the LSL."""
        return self.camera.centre

    @property
    def view(self) -> Vector3:
        """Direction of the middle of the image, in the LSL."""
        middle = np.array([[(n - 1) / 2 for n in self.size]])
        return self.camera.rays(middle)[0]


def in_order(one: L, other: L) -> tuple[L, L]:
    """The two eyes, that on the left of what both look at first; down is the third axis."""
    forward = one.view + other.view
    right = np.array([-forward[1], forward[0], 0.0])
    return (one, other) if (other.centre - one.centre) @ right > 0 else (other, one)


def why_no_wide_pair(left: Looking, right: Looking, limits: InstrumentLimits) -> str | None:
    """What speaks against using two pairs as one instrument; None if nothing does."""
    base = right.centre - left.centre
    base_m = float(np.linalg.norm(base))
    if not limits.least_base_m <= base_m <= limits.largest_base_m:
        return f"a base of {base_m:.1f} m"
    turn = float(np.arccos(np.clip(left.view @ right.view, -1, 1)))
    if turn > limits.largest_turn:
        return f"views {np.rad2deg(turn):.0f} degrees apart"
    along = max(abs(float(eye.view @ base)) / base_m for eye in (left, right))
    if along > np.cos(limits.least_angle):
        return f"a view {np.rad2deg(np.arccos(min(along, 1.0))):.0f} degrees from the base"
    return None


def wide_pairs(
    ones: Sequence[L], others: Sequence[L], limits: InstrumentLimits
) -> list[tuple[L, L]]:
    """The pairs of two stops that make an instrument: every one with the other it agrees best with.

    Each comes in order, the left eye first.
    """
    chosen = []
    for one in ones:
        fit = [eye for eye in others if why_no_wide_pair(*in_order(one, eye), limits) is None]
        if fit:
            chosen.append(in_order(one, max(fit, key=lambda eye: float(eye.view @ one.view))))
    return chosen
