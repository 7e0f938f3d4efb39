"""What registration works on and what it finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, Raster
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid


@dataclass(frozen=True, slots=True, eq=False)
class OrbitalImage:
    """A georeferenced orbital image on the local map, where its georeference claims it to lie."""

    grid: MapGrid
    brightness: Raster
    """NaN where it shows nothing."""

    def __post_init__(self) -> None:
        _check("brightness", self.brightness, self.grid)


@dataclass(frozen=True, slots=True, eq=False)
class OrbitalDtm:
    """A georeferenced orbital terrain model on the local map, where it claims to lie."""

    grid: MapGrid
    elevation: Raster
    """Metres above any level; NaN where unknown."""

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
    """How an orbital image must be moved to lie on the rover's map.

    A point that the georeference puts at p truly lies at c + (1 + `scale`) R (p - c) + t, with the
    centre c, the rotation R by `rotation_deg` counter-clockwise and t = (east, north).
    """

    east_m: float
    north_m: float
    rotation_deg: float
    centre_m: tuple[float, float]
    covariance: Float64[np.ndarray, "4 4"]
    """Of (east m, north m, rotation rad, scale)."""
    scale: float = 0.0
    """By how much it must be enlarged."""
    up_m: float | None = None
    """By which heights of an orbital terrain model must be raised; None for images."""
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
        """Where points of the orbital image truly lie, (east, north)."""
        return (points_m - self.centre_m) @ self._enlarged.T + self.centre_m + self._shift

    def apply_inverse(self, points_m: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n 2"]:
        """Where the orbital image puts what truly lies at points: `apply` undone."""
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
    """What came of a registration: a correction, or the reason why there is none."""

    correction: Correction | None
    reason: str
    """Why not; empty with a correction."""
    explained: float
    """Share of the orbital brightness, locally, that the rover's map explains at the best place."""
    runner_up: float
    """The same at the best place that is another one."""
    halves_apart_m: float
    """Distance between the places that both halves of the ground find on their own."""


def _check(name: str, raster: Raster, grid: MapGrid) -> None:
    if raster.shape != grid.shape:
        raise OrbitalError(f"the {name} has {raster.shape} cells on a grid of {grid.shape}")
