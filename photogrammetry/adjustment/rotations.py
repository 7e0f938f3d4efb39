"""Small rotations, many at a time.

For a rotation vector m of length t, with [m] the matrix of the cross product,

    Exp(m)  = I + sin t / t [m] + (1 - cos t) / t^2 [m]^2                        (Rodrigues)
    Exp(m + dm) = Exp(J dm) Exp(m),   J = I + (1 - cos t)/t^2 [m] + (t - sin t)/t^3 [m]^2
"""

from __future__ import annotations

import numpy as np

from photogrammetry.arrays import Bool, Float64

SERIES = 1e-3
"""Below this angle the series of the trigonometric terms is exact to rounding."""


def cross_matrix(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """[v] with [v] w = v x w."""
    matrices = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    matrices[..., 0, 1], matrices[..., 0, 2] = -z, y
    matrices[..., 1, 0], matrices[..., 1, 2] = z, -x
    matrices[..., 2, 0], matrices[..., 2, 1] = -y, x
    return matrices


def rotation_of_vector(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """Exp(m)."""
    t = np.linalg.norm(vectors, axis=-1)[..., None, None]
    half = np.sinc(t / (2 * np.pi))
    m, square = cross_matrix(vectors), _square(vectors, t)
    return np.eye(3) + np.sinc(t / np.pi) * m + 0.5 * half**2 * square


def left_jacobian(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """J, which carries a change of the rotation vector to a rotation applied from the left."""
    t = np.linalg.norm(vectors, axis=-1)[..., None, None]
    m, square = cross_matrix(vectors), _square(vectors, t)
    small = t < SERIES
    safe = np.where(small, 1.0, t)
    third = np.where(small, 1 / 6 - t**2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + 0.5 * np.sinc(t / (2 * np.pi)) ** 2 * m + third * square


def _square(
    vectors: Float64[np.ndarray, "*n 3"], t: Float64[np.ndarray, "*n 1 1"]
) -> Float64[np.ndarray, "*n 3 3"]:
    """[m]^2 = m m' - t^2 I."""
    return vectors[..., :, None] * vectors[..., None, :] - t**2 * np.eye(3)


def along_arcs(
    centres: Float64[np.ndarray, "stops 3"],
    turn: Float64[np.ndarray, "stops 3"],
    shift: Float64[np.ndarray, "stops 3"],
    held: Bool[np.ndarray, " stops"],
) -> Float64[np.ndarray, "stops 3"]:
    """Centres of a traverse after linear corrections of its stops, taken along arcs.

    Each drive turns with the stops at its ends, D <- Exp(m) (D + dD - m x D); held stops stay.
    """
    drive, change = np.diff(centres, axis=0), np.diff(shift, axis=0)
    mean = (turn[1:] + turn[:-1]) / 2
    rest = drive + change - np.cross(mean, drive)
    arc = (rotation_of_vector(mean) @ rest[:, :, None])[:, :, 0] - drive - change
    off = np.concatenate([np.zeros((1, 3)), np.cumsum(arc, axis=0)])
    stays = np.flatnonzero(held)
    behind = np.maximum(np.searchsorted(stays, np.arange(len(off)), side="right") - 1, 0)
    datum = stays[behind] if len(stays) else np.zeros(len(off), dtype=np.int64)
    return centres + shift + off - off[datum]
