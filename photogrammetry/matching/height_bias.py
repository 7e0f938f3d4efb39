"""Height bias of stereo on ground seen at a grazing angle.

Between two crests a camera sees only the upper part of the ground, and matching interpolates the
hidden part along the line of sight. The surface of dense matching therefore lies above the ground,
more so at longer range and smaller viewing angle. In path-traced worlds the error in lines of the
image depends only on that angle, at 7, 11 and 15 m alike (0.52, 0.45, 0.36, 0.29 and 0.2 lines
where the tangent t is 0.045, 0.08, 0.125, 0.2 and 0.4):

    b l,        l = d / f (t / 0.1)^(-1/2)

with the distance d from the camera, the focal length f in pixels and the tangent t of the angle
between ray and surface. The bias b in lines at t = 0.1 grows with the relief of the ground: at 24
stops of eight path-traced worlds it is 0.25 to 1.16 and

    b = 0.40 r +- 0.15,        r in centimetres,

where r is the root mean square of the heights that remain between Gaussians of 0.2 and 0.4 m,
measured at 3 to 6 m, where noise is small. (0.37 r on the two of them that were used for
development, 0.43 r on all; a constant has an error of 0.23.) With this prior b is estimated from
two stops on either side of the same ground (`cross_site.surface_alignment`), and subtracted from
terrain models (`terrain.dtm`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Mask, Raster
from solmap.photogrammetry.matching import kernels

LEVEL_FACING = 0.1
"""Tangent of the angle between ray and facet at which the bias is b lines."""

LEAST_TANGENT = 0.03
"""Lower limit of the tangent; smaller ones are within the noise of slopes."""

LEAST_CHANGE = 0.15
"""Change of b that requires a new terrain model: 2 mm at 15 m in Navcam images."""


LINES_PER_METRE = 40.0
"""b by the relief of the ground,"""

RELIEF_SIGMA = 0.15
"""and its standard deviation."""

MOST_OF_PRIOR = 0.9
"""Largest standard deviation of an estimate, in those of its prior."""


@dataclass(frozen=True, slots=True)
class HeightBias:
    """Height bias b in lines, and its standard deviation; estimates include their prior."""

    lines: float = 0.0
    sigma: float = 0.0

    @classmethod
    def expected(cls, relief_m: float) -> HeightBias:
        """The prior of ground with this relief r; that of all ground where it is unknown (NaN)."""
        if not np.isfinite(relief_m):
            return USUAL_BIAS
        return cls(LINES_PER_METRE * relief_m, RELIEF_SIGMA)

    @classmethod
    def mean(cls, biases: Sequence[HeightBias]) -> HeightBias:
        """Mean of equally uncertain biases with a common error."""
        lines, sigma = np.mean([(one.lines, one.sigma) for one in biases], axis=0)
        return cls(float(lines), float(sigma))

    @classmethod
    def pooled(cls, estimates: Iterable[tuple[HeightBias, HeightBias]]) -> HeightBias:
        """Estimates combined, at least 0; that of all ground without any.

        Each is given with the prior that it includes; the mean of the priors counts once. Stated
        less certain than its prior, an estimate keeps a little of its own information.
        """
        used = [(one, prior) for one, prior in estimates if one.sigma > 0]
        if not used:
            return USUAL_BIAS
        common = cls.mean([prior for _, prior in used])
        weight, total = common.sigma**-2.0, common.lines * common.sigma**-2.0
        for one, prior in used:
            sigma = min(one.sigma, MOST_OF_PRIOR * prior.sigma)
            weight += sigma**-2.0 - prior.sigma**-2.0
            total += one.lines * sigma**-2.0 - prior.lines * prior.sigma**-2.0
        return cls(max(total / weight, 0.0), weight**-0.5)

    def differs_from(self, other: HeightBias) -> bool:
        """Whether the difference to another one requires a new terrain model."""
        return abs(self.lines - other.lines) > LEAST_CHANGE


NO_BIAS = HeightBias()

USUAL_BIAS = HeightBias(0.5, 0.29)
"""Mean and standard deviation of a uniform distribution from 0 to 1 line: of unknown ground."""


def metres_per_line(
    up: Raster,
    north_m: Float32[np.ndarray, " rows"],
    east_m: Float32[np.ndarray, " cols"],
    mast_m: float,
    focal_px: float,
) -> Raster:
    """Height bias for b = 1, metres; that of level ground where the slope is unknown.

    Args:
        up: Smoothed elevations, north up.
        north_m: Of the cells from the camera,
        east_m: and east.
        mast_m: Elevation of the camera.
        focal_px: Focal length, pixels.
    """
    cell_m = east_m[1] - east_m[0]
    camera = np.float32(mast_m), np.float32(focal_px), cell_m
    facing = np.float32(LEAST_TANGENT), np.float32(LEVEL_FACING)
    return kernels.metres_per_line(up, north_m, east_m, camera, facing)


def mean_of_known(raster: Raster, sigma_cells: float, least: float) -> Raster:
    """A raster smoothed by a Gaussian, NaN where known cells have less of its weight than this."""
    mean = np.full(raster.shape, np.nan, np.float32)
    known = np.isfinite(raster)
    part = _part_with(known, round(4 * sigma_cells) + 1)
    if part is None:
        return mean
    known, raster = known[part], raster[part]
    density = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma_cells)
    values = np.where(known, raster, np.float32(0))
    blurred = cv2.GaussianBlur(values, (0, 0), sigma_cells, dst=values)
    np.divide(blurred, np.maximum(density, 1e-6), out=blurred)
    blurred[density < least] = np.nan
    mean[part] = blurred
    return mean


def _part_with(known: Mask, margin: int) -> tuple[slice, slice] | None:
    """The rows and columns that hold all known cells, with a margin; None without any."""
    parts = []
    for axis, size in zip((1, 0), known.shape, strict=True):
        where = np.flatnonzero(known.any(axis=axis))
        if not len(where):
            return None
        parts.append(slice(max(int(where[0]) - margin, 0), min(int(where[-1]) + margin + 1, size)))
    return parts[0], parts[1]
