"""Input and results of registration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, Raster
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid


@dataclass(frozen=True, slots=True, eq=False)
class OrbitalImage:
    """An orbital image on the local map, at the position of its georeference."""

    grid: MapGrid
    brightness: Raster
    """NaN where it has no data."""

    def __post_init__(self) -> None:
        _check("brightness", self.brightness, self.grid)


@dataclass(frozen=True, slots=True, eq=False)
class OrbitalDtm:
    """An orbital terrain model on the local map, at the position of its georeference."""

    grid: MapGrid
    elevation: Raster
    """Metres above any datum; NaN where unknown."""

    def __post_init__(self) -> None:
        _check("elevation", self.elevation, self.grid)


@dataclass(frozen=True, slots=True, eq=False)
class GroundMap:
    """What rovers mapped, in cells as large as the orbital image's; NaN where nothing was seen."""

    grid: MapGrid
    elevation: Raster
    brightness: Raster

    def __post_init__(self) -> None:
        _check("elevation", self.elevation, self.grid)
        _check("brightness", self.brightness, self.grid)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Correction that moves an orbital image to its position on the rover's map.

    A point at p by the georeference is truly at c + (1 + `scale`) R (p - c) + t, with the centre c,
    the rotation R by `rotation_deg` counter-clockwise and t = (east, north).
    """

    east_m: float
    north_m: float
    rotation_deg: float
    centre_m: tuple[float, float]
    covariance: Float64[np.ndarray, "4 4"]
    """Covariance of (east m, north m, rotation rad, scale)."""
    scale: float = 0.0
    """Change of scale."""
    up_m: float | None = None
    """Offset to be added to the heights of an orbital terrain model; None for images."""
    sigma_up_m: float | None = None

    @property
    def sigma_m(self) -> tuple[float, float]:
        """Standard deviations of east and north."""
        return float(np.sqrt(self.covariance[0, 0])), float(np.sqrt(self.covariance[1, 1]))

    @property
    def sigma_rotation_deg(self) -> float:
        """Standard deviation of the rotation."""
        return float(np.degrees(np.sqrt(self.covariance[2, 2])))

    def apply(self, points_m: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n 2"]:
        """True positions of points of the orbital image, (east, north)."""
        return (points_m - self.centre_m) @ self._enlarged.T + self.centre_m + self._shift

    def apply_inverse(self, points_m: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n 2"]:
        """Positions in the orbital image's georeference of true points: inverse of `apply`."""
        back = np.linalg.inv(self._enlarged)
        return (points_m - self.centre_m - self._shift) @ back.T + self.centre_m

    @property
    def _enlarged(self) -> Float64[np.ndarray, "2 2"]:
        c, s = np.cos(np.radians(self.rotation_deg)), np.sin(np.radians(self.rotation_deg))
        return (1 + self.scale) * np.array([[c, -s], [s, c]])

    @property
    def _shift(self) -> Float64[np.ndarray, " 2"]:
        return np.array([self.east_m, self.north_m])


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Result of a registration: a correction, or the reason why there is none."""

    correction: Correction | None
    reason: str
    """Reason; empty with a correction."""
    explained: float
    """Fraction of the local orbital brightness explained by the rover's map at the best
    position."""
    runner_up: float
    """Share explained at the best of the other positions."""
    halves_apart_m: float
    """Distance between the positions found separately by both halves of the ground."""


def _check(name: str, raster: Raster, grid: MapGrid) -> None:
    if raster.shape != grid.shape:
        raise OrbitalError(f"the {name} has {raster.shape} cells on a grid of {grid.shape}")
