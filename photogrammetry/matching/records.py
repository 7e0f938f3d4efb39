"""What matching hands on: epipolar images, matched pairs and the stops they were taken at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, GreyImage, Mask, ParallaxMap
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StereoMatches, StopId


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarImages:
    """Both images of a pair, resampled to its epipolar geometry; masks are True where usable."""

    geometry: EpipolarPair
    left: GreyImage
    left_mask: Mask
    right: GreyImage
    right_mask: Mask

    def __post_init__(self) -> None:
        size = (self.geometry.lines, self.geometry.samples)
        for name in ("left", "left_mask", "right", "right_mask"):
            shape = getattr(self, name).shape
            if shape != size:
                raise MatchingError(f"the {name} of an epipolar pair of {size} is {shape}")


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPair:
    """A stereo pair with all that was matched in it."""

    pair_id: str
    instrument: str
    images: EpipolarImages
    matches: StereoMatches
    parallax: ParallaxMap
    """Dense parallax on the grid of the left epipolar image."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchedStop:
    """All matched pairs of a stop, and where telemetry (or a former adjustment) says it stood."""

    stop: StopId
    pairs: tuple[MatchedPair, ...]
    lsl_from_rover: Pose
    covariance: Float64[np.ndarray, "6 6"]
    """Of the pose: rotation vector in the LSL (radians), then position in the LSL (metres)."""
