"""Input and results of terrain mapping."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from solmap.photogrammetry.arrays import (
    Classes,
    Float64,
    GreyImage,
    Int32,
    Mask,
    ParallaxMap,
    Raster,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.height_bias import NO_BIAS, HeightBias
from solmap.photogrammetry.matching.records import SharedSigma
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid

PoseCovariance = Float64[np.ndarray, "6 6"]
"""Covariance of a rotation vector (radians) and a position (metres), both in the LSL."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainView:
    """One stereo pair as input of mapping: oriented, matched, with its left epipolar image."""

    pair_id: str
    instrument: str
    lsl_from_pair: Pose
    geometry: EpipolarPair
    parallax: ParallaxMap
    image: GreyImage
    mask: Mask
    sigma_px: ParallaxMap | None = None
    """Standard deviation of every parallax from matching; None where unknown."""
    shared: SharedSigma | None = None
    """The part of it common to all points of the view."""
    covariance: PoseCovariance | None = None
    """Covariance of the pose, relative to the held stop; None where treated as exact."""
    height_bias: HeightBias = NO_BIAS
    """Height bias of the ground around the stop."""


class GroundClass(IntEnum):
    """Origin of a terrain model cell's elevation."""

    UNSEEN = 0
    """Nothing was measured here or close enough: no elevation."""
    MEASURED = 1
    """The cell contains matched points."""
    INTERPOLATED = 2
    """Ground between neighbouring pixels of one continuous surface, closer than the set gap."""
    OCCLUDED = 3
    """Ground within reach and in the field of a pair, but hidden by nearer ground: no elevation."""


@dataclass(frozen=True, slots=True, eq=False)
class Dtm:
    """A digital terrain model: elevation above the tangent plane at the lander, metres."""

    grid: MapGrid
    elevation: Raster
    sigma_m: Raster
    """Standard deviation of the elevation, including that of the poses; NaN where there is none."""
    observations: Raster
    """Number of matched points in the cell."""
    ground: Classes
    """A `GroundClass` a cell."""
    pose_sigma_m: Raster | None = None
    """The part of `sigma_m` that comes from the poses and is common to neighbouring cells; None
    where poses are treated as exact."""

    def __post_init__(self) -> None:
        for name in ("elevation", "sigma_m", "observations", "ground", "pose_sigma_m"):
            layer = getattr(self, name)
            if layer is not None and layer.shape != self.grid.shape:
                raise TerrainError(
                    f"the {name} of a DTM of {self.grid.shape} cells is {layer.shape}"
                )

    def block_steps(self) -> Int32[np.ndarray, "block_rows block_cols"]:
        """1 for the blocks with an elevation, 0 for others."""
        rows, cols = (np.arange(0, count, BLOCK) for count in self.grid.shape)
        known = np.isfinite(self.elevation).astype(np.int32)
        return np.maximum.reduceat(np.maximum.reduceat(known, rows, axis=0), cols, axis=1)

    def part(self, rows: slice, cols: slice) -> Dtm:
        """A window of the model, inside its grid; with a step, not of all cells."""
        own = (rows, cols)
        pose = None if self.pose_sigma_m is None else self.pose_sigma_m[own]
        return Dtm(
            self.grid.window(rows, cols),
            self.elevation[own],
            self.sigma_m[own],
            self.observations[own],
            self.ground[own],
            pose,
        )
