"""What terrain mapping works on and makes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from solmap.photogrammetry.arrays import Classes, Float64, GreyImage, Mask, ParallaxMap, Raster
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.height_bias import NO_BIAS, HeightBias
from solmap.photogrammetry.matching.stereo.dense import SharedSigma
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

PoseCovariance = Float64[np.ndarray, "6 6"]
"""Of a rotation vector (radians) and a position (metres), both in the LSL."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainView:
    """One stereo pair's look at the ground: oriented, matched, with its left epipolar image."""

    pair_id: str
    instrument: str
    lsl_from_pair: Pose
    geometry: EpipolarPair
    parallax: ParallaxMap
    image: GreyImage
    mask: Mask
    sigma_px: ParallaxMap | None = None
    """Standard deviation of every parallax, as matching states it; None where it is not known."""
    shared: SharedSigma | None = None
    """The part of it that all points of the view share."""
    covariance: PoseCovariance | None = None
    """Of the pose, against the held stop; None where it is taken for true."""
    height_bias: HeightBias = NO_BIAS
    """By how much stereo draws the ground around the stop too high."""


class GroundClass(IntEnum):
    """How a cell of a terrain model came by its elevation."""

    UNSEEN = 0
    """Nothing was measured here or near enough: no elevation."""
    MEASURED = 1
    """Matched points fall into the cell."""
    INTERPOLATED = 2
    """Between neighbouring pixels of one continuous surface, closer than the set gap."""
    OCCLUDED = 3
    """Within reach and in the field of a pair, but behind nearer ground: no elevation."""


@dataclass(frozen=True, slots=True, eq=False)
class Dtm:
    """A digital terrain model: elevation above the tangent plane at the lander, metres."""

    grid: MapGrid
    elevation: Raster
    sigma_m: Raster
    """Standard deviation of the elevation, that of the poses included; NaN where there is none."""
    observations: Raster
    """Number of matched points in the cell."""
    ground: Classes
    """A `GroundClass` a cell."""
    pose_sigma_m: Raster | None = None
    """The part of `sigma_m` that comes from the poses and that neighbouring cells share; None where
    they are taken for true."""

    def __post_init__(self) -> None:
        for name in ("elevation", "sigma_m", "observations", "ground", "pose_sigma_m"):
            layer = getattr(self, name)
            if layer is not None and layer.shape != self.grid.shape:
                raise TerrainError(
                    f"the {name} of a DTM of {self.grid.shape} cells is {layer.shape}"
                )
