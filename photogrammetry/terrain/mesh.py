"""The mesh between neighbouring pixels of one surface.

Four neighbouring pixels make a quad. The quad is ground that was really seen when none of its sides
steps by more parallax than continuous ground does (see `ground`) nor is longer than a set gap.
Farther away the quads grow larger than the cells of the map, and samples inside them, bilinear
between the corners, tell which cells they cover and at what height.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Mask, ParallaxMap
from solmap.photogrammetry.terrain.ground import Planes3

Samples3 = Float32[np.ndarray, "3 n"]
"""East, north and up of samples of the surface, metres from the camera."""
SAMPLES_AT_ONCE = 2_000_000
"""Mesh samples held at one time: some tens of megabytes."""


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """Quads of continuous ground."""

    corner: np.ndarray
    """Their first corners: line and sample, counted along the lines of the image."""
    lines_m: Float32[np.ndarray, " n"]
    """Distance on the map between their lines."""
    samples_m: Float32[np.ndarray, " n"]
    """Distance on the map between their samples."""

    def __len__(self) -> int:
        return len(self.corner)


def continuous_quads(planes: Planes3, parallax: ParallaxMap, step_px: float, gap_m: float) -> Quads:
    """Quads none of whose sides steps by more than `step_px` of parallax or `gap_m` on the map."""
    with np.errstate(invalid="ignore"):
        down_step = np.abs(np.diff(parallax, axis=0)) <= step_px
        across_step = np.abs(np.diff(parallax, axis=1)) <= step_px
        down_m2, across_m2 = (_squared_steps(planes, axis) for axis in (0, 1))
        down_step &= down_m2 <= np.float32(gap_m**2)
        across_step &= across_m2 <= np.float32(gap_m**2)
    whole = down_step[:, :-1] & down_step[:, 1:] & across_step[:-1] & across_step[1:]
    row, col = np.nonzero(whole)
    return Quads(
        corner=row * parallax.shape[1] + col,
        lines_m=np.sqrt(np.maximum(down_m2[row, col], down_m2[row, col + 1])),
        samples_m=np.sqrt(np.maximum(across_m2[row, col], across_m2[row + 1, col])),
    )


def _squared_steps(planes: Planes3, axis: int) -> np.ndarray:
    """Squared distance on the map between neighbouring pixels along an axis of the image."""
    east, north = (np.diff(plane, axis=axis) for plane in planes[:2])
    return east * east + north * north


def in_a_quad(quads: Quads, shape: tuple[int, int]) -> Mask:
    """Pixels that are a corner of some quad: those that hang together with others."""
    corner = np.zeros(shape[0] * shape[1], dtype=np.bool_)
    for shift in (0, 1, shape[1], shape[1] + 1):
        corner[quads.corner + shift] = True
    return corner.reshape(shape)


@dataclass(frozen=True, slots=True, eq=False)
class MeshSamples:
    """Samples between the pixels of a mesh."""

    points: Samples3
    sag_m: Float32[np.ndarray, " n"]
    """Length that the ground between may stray over: L t (1 - t), L the spacing of the lines and
    t the place between them."""


def mesh_samples(planes: Planes3, quads: Quads, spacing_m: float) -> Iterator[MeshSamples]:
    """Samples that cover the quads which are wider than `spacing_m`, piece by piece.

    A quad is divided into as many parts as its sides need.
    """
    held: list[MeshSamples] = []
    count = 0
    for piece in _divided_quads(planes, quads, spacing_m):
        held.append(piece)
        count += len(piece.sag_m)
        if count > SAMPLES_AT_ONCE:
            yield _joined(held)
            held, count = [], 0
    if held:
        yield _joined(held)


def _joined(pieces: list[MeshSamples]) -> MeshSamples:
    return MeshSamples(
        np.concatenate([one.points for one in pieces], axis=1),
        np.concatenate([one.sag_m for one in pieces]),
    )


def _divided_quads(planes: Planes3, quads: Quads, spacing_m: float) -> Iterator[MeshSamples]:
    """Samples of the quads, those of equal division together."""
    down = np.ceil(np.maximum(1, quads.lines_m / spacing_m)).astype(np.int64)
    across = np.ceil(np.maximum(1, quads.samples_m / spacing_m)).astype(np.int64)
    wide = np.flatnonzero(down * across > 1)  # elsewhere the pixels themselves are close enough
    code = down[wide] * (int(across.max(initial=1)) + 1) + across[wide]
    order = wide[np.argsort(code, kind="stable")]
    _, starts = np.unique(np.sort(code), return_index=True)
    flat = planes.reshape(3, -1)
    for group in np.split(order, starts[1:]) if len(order) else ():
        parts = (int(down[group[0]]), int(across[group[0]]))
        piece = max(1, SAMPLES_AT_ONCE // (parts[0] * parts[1]))
        for first in range(0, len(group), piece):
            chosen = group[first : first + piece]
            corner, lines_m = quads.corner[chosen], quads.lines_m[chosen]
            yield _divide(flat, corner, lines_m, planes.shape[2], parts)


def _divide(
    flat: np.ndarray, corner: np.ndarray, lines_m: np.ndarray, width: int, parts: tuple[int, int]
) -> MeshSamples:
    """Bilinear samples at the middles of `parts` (down, across) of quads."""
    t = ((np.arange(parts[0], dtype=np.float32) + 0.5) / parts[0])[:, None]
    s = ((np.arange(parts[1], dtype=np.float32) + 0.5) / parts[1])[None, :]
    upper = _between(flat[:, corner, None], flat[:, corner + 1, None], s)
    lower = _between(flat[:, corner + width, None], flat[:, corner + width + 1, None], s)
    points = _between(upper[:, :, None, :], lower[:, :, None, :], t)
    bow = np.broadcast_to(t * (1 - t), parts).ravel()
    return MeshSamples(points.reshape(3, -1), (lines_m[:, None] * bow).ravel())


def _between(one: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Points at these shares of the way from one to the other."""
    return one + share * (other - one)
