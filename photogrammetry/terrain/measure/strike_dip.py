"""Strike and dip of a plane with their standard deviations, and the plane inside an outline.

With the normal pointing up, n = (sin D sin A, sin D cos A, cos D) in (east, north, up): D is the
dip, A the azimuth of the dip, and the strike is A - 90 degrees (right-hand rule: looking along it,
the plane falls to the right). A horizontal error of the normal changes the strike by 1 / sin D of
it, so a level plane has no strike.

A plane is fitted to the ground inside an outline on a terrain model. Every measured cell inside is
a point with the variance of its elevation, and horizontally that of a uniform distribution over the
cell, cell^2 / 12. The part of the variance by poses moves and tilts all cells together and does not
scatter them, so it is subtracted. A cell shares its matches with its neighbours: where c^2 pixels
have a common error and the terrain model has counted its k points, w^2 at most, as one match, the
variance is multiplied by c^2 / k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from solmap.photogrammetry.arrays import Bool, Covariances3, Float64, ObjectPoints
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import PlaneFit, fit_plane
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass

SHARED_PX = 25.0
"""Side of the square of pixels whose dense parallaxes count as one for the tilt of a plane: three
matching windows. Compared with the truth of the rendered and of a simulated traverse this gives the
right errors for planes of 0.3 to 1 m; with one window a half or a third would be stated."""
LEVEL = 3.0
"""Standard deviations of the dip within which a plane counts as level, without strike."""
WINDOW_PX = 9.0
"""Pixels within this distance have a common error in the terrain model's standard deviation."""
Corners = Float64[np.ndarray, "n 2"]
"""(east, north) of an outline's corners in order, metres of the local map."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """Strike and dip, radians."""

    strike: float
    """Azimuth, clockwise from north, with the dip to the right."""
    dip: float
    """Dip below the horizontal, 0 to pi/2."""
    sigma_strike: float
    sigma_dip: float

    @property
    def dip_direction(self) -> float:
        """Azimuth of the steepest descent of the plane."""
        return float((self.strike + np.pi / 2) % (2 * np.pi))


def attitude(plane: PlaneFit) -> Attitude:
    """Strike and dip of a plane.

    Raises:
        TerrainError: the plane is level within its uncertainty, so it has no strike.
    """
    east, north, up = plane.normal
    dip = float(np.arctan2(np.hypot(east, north), up))
    azimuth = float(np.arctan2(east, north))
    along = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    downward = np.cross(along, plane.normal)
    sigma_along, sigma_dip = (
        float(np.sqrt(max(0.0, axis @ plane.covariance @ axis))) for axis in (along, downward)
    )
    if dip <= LEVEL * max(sigma_along, sigma_dip):
        raise TerrainError(
            f"the plane dips by {np.degrees(dip):.2f} +- {np.degrees(sigma_dip):.2f} degrees: it "
            "is level within its uncertainty, and its strike is undefined"
        )
    return Attitude(
        strike=float((azimuth - np.pi / 2) % (2 * np.pi)),
        dip=dip,
        sigma_strike=sigma_along / float(np.sin(dip)),
        sigma_dip=sigma_dip,
    )


@dataclass(frozen=True, slots=True)
class CellPlaneParams:
    """Parameters of fitting planes to cells."""

    shared_px: float = SHARED_PX
    """Pixels within this distance have a common error."""
    tilt_deg: float = 0.1
    """Standard deviation of the tilt common to all ground of a stop: that of adjusted stops."""


def plane_of_cells(dtm: Dtm, corners: Corners, params: CellPlaneParams) -> PlaneFit:
    """The plane of the measured cells with centres inside an outline.

    Raises:
        TerrainError: the outline is invalid, or contains too few measured cells or only a line of
            them.
    """
    inside = _inside(dtm, corners) & (dtm.ground == GroundClass.MEASURED)
    if not inside.any():
        west, south, east, north = dtm.grid.bounds
        raise TerrainError(
            f"no measured ground lies inside the outline of {len(corners)} corners; the terrain "
            f"model reaches from {west:.1f} to {east:.1f} m east and {south:.1f} to {north:.1f} m "
            "north"
        )
    points, covariances = _points(dtm, inside, params)
    turning = np.diag([np.radians(params.tilt_deg) ** 2] * 2 + [0.0])
    return fit_plane(points, covariances, turning)


def _inside(dtm: Dtm, corners: Corners) -> Bool[np.ndarray, "rows cols"]:
    if len(corners) < 3:  # noqa: PLR2004 - of a triangle
        raise TerrainError(f"an outline needs at least 3 corners, not {len(corners)}")
    outline = shapely.Polygon(corners)
    if not outline.is_valid:
        reason = shapely.is_valid_reason(outline)
        raise TerrainError(f"the outline crosses itself ({reason}); give its corners in order")
    east, north = np.meshgrid(*dtm.grid.centres())
    return np.asarray(shapely.contains_xy(outline, east, north))


def _points(
    dtm: Dtm, inside: Bool[np.ndarray, "rows cols"], params: CellPlaneParams
) -> tuple[ObjectPoints, Covariances3]:
    row, col = np.nonzero(inside)
    east, north = dtm.grid.centres()
    up, sigma = (layer[inside].astype(np.float64) for layer in (dtm.elevation, dtm.sigma_m))
    variance = sigma**2
    if dtm.pose_sigma_m is not None:
        variance = np.maximum(variance - dtm.pose_sigma_m[inside] ** 2, variance / 100)
    count = np.maximum(1.0, dtm.observations[inside].astype(np.float64))
    independent = np.minimum(count, WINDOW_PX**2)
    variance = variance * np.maximum(1.0, params.shared_px**2 / independent)
    covariances = np.zeros((len(up), 3, 3))
    covariances[:, [0, 1], [0, 1]] = dtm.grid.cell_m**2 / 12
    covariances[:, 2, 2] = variance
    return np.column_stack([east[col], north[row], up]), covariances
