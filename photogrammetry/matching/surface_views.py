"""A pair's ground as facets: planes of its dense parallax, and the side from which they are seen.

A plane in space is a plane of parallax, n . X = 1 (`local_surface`). Here one is fitted about
pixels all over the image at once, from running sums, and read off wherever it is asked for. A facet
is seen under the angle whose sine is n . X / (|n| |X|). Rays that graze the ground meet crests, and
what the window makes of the step behind a crest is no ground at all; such facets are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solmap.photogrammetry.arrays import (
    Directions,
    Float32,
    Float64,
    ImagePoints,
    ObjectPoints,
    ParallaxMap,
    PerPoint,
    Rotation,
    Vector3,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, projection_partials
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.parallax_planes import EVERY, ParallaxPlanes, parallax_facets


@dataclass(frozen=True, eq=False)
class SurfaceView:
    """The facets of a pair, and where the pair stands in a common frame of two stops."""

    geometry: EpipolarPair
    rotation: Rotation
    """Of the pair in the common frame."""
    centre: Vector3
    """The left camera in the common frame, metres."""
    parallax: ParallaxMap
    half_px: int
    """Half the window of a facet."""

    @classmethod
    def of(
        cls, geometry: EpipolarPair, parallax: ParallaxMap, frame_from_pair: Pose, half_px: int
    ) -> SurfaceView:
        """A pair placed in the common frame."""
        return cls(
            geometry, frame_from_pair.rotation, frame_from_pair.translation_m, parallax, half_px
        )

    @cached_property
    def planes(self) -> Float32[np.ndarray, "4 rows cols"]:
        """Parallax, its gradient along sample and line, and residual, every `EVERY` pixels."""
        return parallax_facets(self.parallax, self.half_px)

    def at(self, points: ImagePoints) -> ParallaxPlanes:
        """The facets at image points; those outside the image have none."""
        _, rows, cols = self.planes.shape
        inside = self.geometry.shows(points)
        node = np.rint(np.where(inside[:, None], points, 0.0) / EVERY)
        node = np.minimum(node, (cols - 1, rows - 1))
        col, row = node.astype(np.int64).T
        parallax, along, down, residual = self.planes[:, row, col].astype(np.float64)
        parallax[~inside] = np.nan
        gradient = np.column_stack([along, down])
        return ParallaxPlanes(
            parallax + (gradient * (points - EVERY * node)).sum(axis=1), gradient, residual
        )

    def grid(self, step_px: int) -> ImagePoints:
        """Image points `step_px` apart where there is parallax."""
        line, sample = np.mgrid[
            step_px // 2 : self.geometry.lines : step_px,
            step_px // 2 : self.geometry.samples : step_px,
        ]
        known = self.parallax[line, sample] > 0
        return np.column_stack([sample[known], line[known]]).astype(np.float64)

    def place(self, points: ImagePoints, parallax_px: PerPoint) -> ObjectPoints:
        """Where image points lie in the common frame, metres."""
        in_pair = self.geometry.triangulate(points, parallax_px)
        return in_pair @ self.rotation.T + self.centre

    def by_place(self, in_pair: ObjectPoints) -> Float64[np.ndarray, "n 3 3"]:
        """Derivative of (sample, line, parallax) by places of the common frame, pixels per metre.

        `in_pair` are the places in the frame of the pair, metres.
        """
        g = self.geometry
        return projection_partials(in_pair, g.focal_px, g.base_m) @ self.rotation.T

    def normals(self, planes: ParallaxPlanes, points: ImagePoints) -> Directions:
        """Unit normals of facets in the common frame, away from the camera."""
        return unit(planes.normals(points, self.geometry)) @ self.rotation.T

    def facing(self, normals: Directions, places: ObjectPoints) -> PerPoint:
        """Sine of the angle under which facets are seen; below zero from behind."""
        return (normals * unit(places - self.centre)).sum(axis=1)


def unit(vectors: ObjectPoints) -> Directions:
    """Vectors of length one."""
    with np.errstate(invalid="ignore"):
        return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
