"""Rotations and products of many small matrices at once.

For a rotation vector m of length t, with [m] the matrix of the cross product,

    Exp(m)  = I + sin t / t [m] + (1 - cos t) / t^2 [m]^2                        (Rodrigues)
    Exp(m + dm) = Exp(J dm) Exp(m),   J = I + (1 - cos t)/t^2 [m] + (t - sin t)/t^3 [m]^2

Functions of rotation vectors take arrays (..., 3). `Matrices` (3, 3, m) and `Vectors` (3, m) are
kept component by component: with the many along the last axis numpy multiplies them several times
faster than one by one.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Bool, Covariances3, Float64

SERIES = 1e-3
"""Angle below which the series of the trigonometric terms is exact to rounding."""
_LEAST = 1e-300
"""An angle treated as zero."""
_UNIT = np.eye(3)
_AXES = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0],
                  [0, 0, 1, 0, 0, 0, -1, 0, 0],
                  [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=np.float64)  # fmt: skip
"""Cross product matrices of the axes, row by row."""


Matrices = Float64[np.ndarray, "3 3 m"]
Vectors = Float64[np.ndarray, "3 m"]


def cross_matrix(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """[v] with [v] w = v x w."""
    return (vectors @ _AXES).reshape(*vectors.shape, 3)


def rotation_of_vector(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """Exp(m)."""
    t = _lengths(vectors)
    half = t / 2
    sinc_half = np.sin(half) / half  # sin t / t and (1 - cos t) / t^2 follow from it
    rotations = sinc_half * np.cos(half) * cross_matrix(vectors)
    rotations += 0.5 * sinc_half**2 * _square(vectors, t)
    rotations += _UNIT
    return rotations


def left_jacobian(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """J, which carries a change of the rotation vector to a rotation applied from the left."""
    t = _lengths(vectors)
    half, safe = t / 2, np.maximum(t, SERIES)
    sinc_half = np.sin(half) / half
    third = np.where(t < SERIES, 1 / 6 - t**2 / 120, (safe - np.sin(safe)) / safe**3)
    jacobians = 0.5 * sinc_half**2 * cross_matrix(vectors)
    jacobians += third * _square(vectors, t)
    jacobians += _UNIT
    return jacobians


def inverse_left_jacobian(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """J^-1 = I - [m]/2 + (1 - t/2 cot t/2)/t^2 [m]^2, for t below a turn."""
    t = _lengths(vectors)
    safe = np.maximum(t, SERIES)
    third = np.where(t < SERIES, 1 / 12 + t**2 / 720, (1 - safe / 2 / np.tan(safe / 2)) / safe**2)
    return _UNIT - 0.5 * cross_matrix(vectors) + third * _square(vectors, t)


def _lengths(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 1 1"]:
    """Lengths, of which none is zero, so that one may divide by them."""
    return np.maximum(np.sqrt(np.vecdot(vectors, vectors)), _LEAST)[..., None, None]


def _square(
    vectors: Float64[np.ndarray, "*n 3"], t: Float64[np.ndarray, "*n 1 1"]
) -> Float64[np.ndarray, "*n 3 3"]:
    """[m]^2 = m m' - t^2 I."""
    return vectors[..., :, None] * vectors[..., None, :] - t**2 * _UNIT


def move_along_arcs(
    centres: Float64[np.ndarray, "stops 3"],
    turn: Float64[np.ndarray, "stops 3"],
    shift: Float64[np.ndarray, "stops 3"],
    held: Bool[np.ndarray, " stops"],
) -> Float64[np.ndarray, "stops 3"]:
    """Centres of a traverse after linear corrections of its stops, applied along arcs.

    Each drive rotates with the stops at its ends, D <- Exp(m) (D + dD - m x D); held stops stay.
    """
    drive, change = centres[1:] - centres[:-1], shift[1:] - shift[:-1]
    mean = (turn[1:] + turn[:-1]) / 2
    rest = drive + change - (cross_matrix(mean) @ drive[:, :, None])[:, :, 0]
    arc = (rotation_of_vector(mean) @ rest[:, :, None])[:, :, 0] - drive - change
    off = np.zeros_like(centres)
    arc.cumsum(axis=0, out=off[1:])
    stays = np.flatnonzero(held)
    behind = np.maximum(np.searchsorted(stays, np.arange(len(off)), side="right") - 1, 0)
    datum = stays[behind] if len(stays) else np.zeros(len(off), dtype=np.int64)
    return centres + shift + off - off[datum]


def by_component(matrices: Float64[np.ndarray, "m 3 3"]) -> Matrices:
    """Many matrices, component by component."""
    return matrices.transpose(1, 2, 0).copy()


def transform(A: Matrices, v: Vectors) -> Vectors:
    """A v of many matrices and vectors."""
    return np.einsum("ijm,jm->im", A, v)


def cross(v: Float64[np.ndarray, "3 *rows m"], w: Vectors) -> Float64[np.ndarray, "3 *rows m"]:
    """Cross products v x w."""
    (a, b, c), (x, y, z), crossed = v, w, np.empty(v.shape)
    np.subtract(b * z, c * y, out=crossed[0])
    np.subtract(c * x, a * z, out=crossed[1])
    np.subtract(a * y, b * x, out=crossed[2])
    return crossed


def product(A: Matrices, B: Matrices) -> Matrices:
    """A B of many matrices."""
    return np.einsum("ijm,jkm->ikm", A, B)


def cross_matrices(v: Vectors) -> Matrices:
    """[v] of many vectors, with [v] w = v x w."""
    x, y, z = v
    none = np.zeros_like(x)
    return np.stack([none, -z, y, z, none, -x, -y, x, none]).reshape(3, 3, -1)


def cross_rows(
    rows: Float64[np.ndarray, "3 3 *k m"], v: Vectors
) -> Float64[np.ndarray, "3 3 *k m"]:
    """Every row of many matrices times v, as vectors; of several of each v where there are k."""
    return cross(rows.swapaxes(0, 1), v).swapaxes(0, 1)


def inverses(S: Covariances3) -> Covariances3:
    """Inverses of many symmetric matrices: cofactors over the determinant.

    For matrices of three rows this is as exact as elimination and ten times as fast.
    """
    return inverses_by_component(by_component(S)).transpose(2, 0, 1).copy()


def inverses_by_component(S: Matrices) -> Matrices:
    """The same, component by component."""
    (a, b, c), (_, d, e), (_, _, f) = S
    inverse = np.empty_like(S)
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    inverse[1, 1], inverse[1, 2], inverse[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    inverse[1:, 0], inverse[2, 1] = inverse[0, 1:], inverse[1, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse *= 1.0 / np.einsum("im,im->m", S[0], inverse[0])
    return inverse
