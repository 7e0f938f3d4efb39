"""Many small matrices and vectors, component by component: (3, 3, m) and (3, m).

With the many along the last axis numpy multiplies them several times faster than one by one.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Float64

Matrices = Float64[np.ndarray, "3 3 m"]
Vectors = Float64[np.ndarray, "3 m"]


def by_component(matrices: Float64[np.ndarray, "m 3 3"]) -> Matrices:
    """Many matrices, component by component."""
    return matrices.transpose(1, 2, 0).copy()


def turned(A: Matrices, v: Vectors) -> Vectors:
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


def crosses(v: Vectors) -> Matrices:
    """[v] of many vectors, with [v] w = v x w."""
    x, y, z = v
    none = np.zeros_like(x)
    return np.stack([none, -z, y, z, none, -x, -y, x, none]).reshape(3, 3, -1)


def crossed_rows(
    rows: Float64[np.ndarray, "3 3 *k m"], v: Vectors
) -> Float64[np.ndarray, "3 3 *k m"]:
    """Every row of many matrices times v, as vectors; of several of each v where there are k."""
    return cross(rows.swapaxes(0, 1), v).swapaxes(0, 1)
