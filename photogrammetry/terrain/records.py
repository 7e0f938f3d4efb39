"""What terrain mapping works on and makes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from photogrammetry.arrays import Classes, GreyImage, Mask, ParallaxMap, Raster
from photogrammetry.cameras.epipolar import EpipolarPair
from photogrammetry.errors import TerrainError
from photogrammetry.frames import Pose
from photogrammetry.matching.dense import SharedSigma
from photogrammetry.terrain.grid import MapGrid


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


class GroundClass(IntEnum):
    """How a cell of a terrain model came by its elevation."""

    UNSEEN = 0
    """Nothing was measured here or near enough: no elevation."""
    MEASURED = 1
    """Matched points fall into the cell."""
    INTERPOLATED = 2
    """Between neighbouring pixels of one continuous surface, closer than the set gap."""


@dataclass(frozen=True, slots=True, eq=False)
class Dtm:
    """A digital terrain model: elevation above the tangent plane at the lander, metres."""

    grid: MapGrid
    elevation: Raster
    sigma_m: Raster
    """Standard deviation of the elevation; NaN where there is none."""
    observations: Raster
    """Number of matched points in the cell."""
    ground: Classes
    """A `GroundClass` a cell."""

    def __post_init__(self) -> None:
        for name in ("elevation", "sigma_m", "observations", "ground"):
            if getattr(self, name).shape != self.grid.shape:
                raise TerrainError(
                    f"the {name} of a DTM of {self.grid.shape} cells is {getattr(self, name).shape}"
                )
