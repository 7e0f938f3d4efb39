"""The plane through points of unequal, correlated coordinates.

A point known with the covariance C lies off the plane n.P = d by n.P - d with the variance n'C n.
The plane that makes the points likeliest, whatever the true points are, minimises

    sum r^2,    r = (n.P - d) / sigma,    sigma^2 = n'C n

over unit normals n and distances d: total least squares with an ellipsoid a point. It is found by
Gauss-Newton. With t perpendicular to n, a small turn of n towards t changes r by t.Q/sigma,
where Q = P - C n r/sigma is the place on the plane that P most likely came from, and

    N = sum a a' / sigma^2,    a = (t1.Q, t2.Q, -1)

is the normal matrix. Replacing Q by P, as weighted least squares does, tilts the plane towards the
longest axes of the ellipsoids: the views. The inverse of N is the covariance of both angles and of
d once the part of N is taken off that noise makes by spreading the points within the plane,

    sum t' (C - C n n'C / sigma^2) t / sigma^2

for along a line or in one spot nothing else may be left; such points are refused. Where points
scatter by more than they claim the covariance is enlarged by sigma0^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Covariances3, Float64, ObjectPoints, PerPoint, Vector3
from solmap.photogrammetry.errors import TerrainError

SHARED_PX = 25.0
"""Side of the square of pixels whose dense parallaxes count as one for the tilt of a plane: three
matching windows. Against the truth of the rendered and of a simulated traverse planes of 0.3 to 1 m
are as far off as this has it; with one window they would claim half or a third of their error."""
LEAST_POINTS = 3
ROUNDS = 50
CONVERGED = 1e-10
"""Radians and extents of the points, by which the last round may have moved the plane."""
LARGEST_SIGMA = np.radians(15.0)
"""Standard deviation of the normal above which points are no plane but a line or a cloud."""
CHANCE = 4.0
"""Standard deviations, sqrt(2 / n) of it, by which noise may make more of the normal matrix."""
SINGULAR = 1e-12
"""Part of the largest eigenvalue below which another one is nothing."""

Covariance3 = Float64[np.ndarray, "3 3"]


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A plane fitted to points, (east, north, up) in metres."""

    centre: Vector3
    """Mean of the points, dropped onto the plane."""
    normal: Vector3
    """Unit normal, pointing up."""
    covariance: Covariance3
    """Of the normal, square radians: singular along the normal itself."""
    sigma_m: float
    """Standard deviation of the plane's place at its centre, along the normal."""
    rms_m: float
    """Root mean square distance of the points from the plane."""
    sigma0: float
    """Scatter of the points over what their covariances claim; 1 without redundancy."""
    points: int


def fit_plane(
    points: ObjectPoints, covariances: Covariances3, turning: Covariance3 | None = None
) -> PlaneFit:
    """The likeliest plane through points known with these covariances.

    Args:
        points: (east, north, up), metres.
        covariances: Of each point on its own, square metres.
        turning: Covariance of a small rotation (east, north, up; radians) that all points share,
            such as that of the camera's pointing; none by default.

    Raises:
        TerrainError: there are too few points, or they lie along a line.
    """
    if len(points) < LEAST_POINTS:
        raise TerrainError(
            f"a plane needs {LEAST_POINTS} points that are not on one line, not {len(points)}: "
            "pick more"
        )
    middle = points.mean(axis=0)
    P = points - middle
    extent = max(float(np.sqrt((P**2).sum(axis=1).mean())), 1e-9)
    n, d = _first_plane(P, covariances), 0.0
    for _ in range(ROUNDS):
        angles, shift = _step(*_normal_equations(P, covariances, n, d))
        n = n + angles @ _across(n)
        n /= np.linalg.norm(n)
        d += shift
        if max(np.abs(angles).max(), abs(shift) / extent) < CONVERGED:
            break
    off = P @ n - d
    sigma0 = _sigma0(off, covariances, n)
    N = _normal_equations(P, covariances, n, d)[0]
    noise = _made_by_noise(covariances, n)
    N[:2, :2] -= noise
    N /= max(1.0, sigma0**2)
    surely = N[:2, :2] - CHANCE * np.sqrt(2 / len(points)) * noise
    if not np.linalg.eigvalsh(surely)[0] > 1 / LARGEST_SIGMA**2:
        raise TerrainError(
            f"{len(points)} points over {extent:.3g} m (root mean square) do not hold a plane: it "
            "may turn about the line along which they lie; pick points to the side of it"
        )
    inverse = np.linalg.inv(N)
    t = _across(n)
    n, t, d = (n, t, d) if n[2] >= 0 else (-n, -t, -d)
    covariance = t.T @ inverse[:2, :2] @ t
    if turning is not None:
        cross = np.cross(np.eye(3), n)
        covariance = covariance + cross.T @ turning @ cross
    return PlaneFit(
        centre=middle + d * n,
        normal=n,
        covariance=covariance,
        sigma_m=float(np.sqrt(inverse[2, 2])),
        rms_m=float(np.sqrt(np.mean(off**2))),
        sigma0=sigma0,
        points=len(points),
    )


def _first_plane(P: ObjectPoints, covariances: Covariances3) -> Vector3:
    """Normal of the plane through points that weigh by their size of error, all round alike."""
    weight = 1 / np.trace(covariances, axis1=1, axis2=2)
    centred = P - np.average(P, axis=0, weights=weight)
    return np.linalg.eigh((weight[:, None] * centred).T @ centred)[1][:, 0]


def _across(n: Vector3) -> Float64[np.ndarray, "2 3"]:
    """Two unit vectors perpendicular to n and to each other."""
    least = np.eye(3)[np.argmin(np.abs(n))]
    first = np.cross(n, least)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(n, first)])


def _normal_equations(
    P: ObjectPoints, covariances: Covariances3, n: Vector3, d: float
) -> tuple[Covariance3, Vector3]:
    """Matrix and right-hand side for both angles and d."""
    towards = np.einsum("nij,j->ni", covariances, n)
    variance = towards @ n
    off = P @ n - d
    Q = P - towards * (off / variance)[:, None]
    a = np.column_stack([Q @ _across(n).T, -np.ones(len(P))])
    return (a / variance[:, None]).T @ a, -(a.T @ (off / variance))


def _step(N: Covariance3, right: Vector3) -> tuple[Float64[np.ndarray, " 2"], float]:
    """Solution of the normal equations; what they do not hold stays as it is."""
    step = np.linalg.pinv(N, rcond=SINGULAR, hermitian=True) @ right
    return step[:2], float(step[2])


def _made_by_noise(covariances: Covariances3, n: Vector3) -> Float64[np.ndarray, "2 2"]:
    """The part of the normal matrix of both angles that points in one spot would have, too."""
    t = _across(n)
    towards = np.einsum("nij,j->ni", covariances, n)
    variance = towards @ n
    along = towards @ t.T
    within = np.einsum("ai,nij,bj->nab", t, covariances, t)
    within -= along[:, :, None] * along[:, None, :] / variance[:, None, None]
    return np.sum(within / variance[:, None, None], axis=0)


def _sigma0(off: PerPoint, covariances: Covariances3, n: Vector3) -> float:
    redundancy = len(off) - LEAST_POINTS
    if redundancy < 1:
        return 1.0
    variance = np.einsum("i,nij,j->n", n, covariances, n)
    return float(np.sqrt(np.sum(off**2 / variance) / redundancy))
