"""Errors of dense parallaxes by range, and in stated standard deviations, in simulated worlds.

    python -m tests.support.parallax_errors realistic-hills23 realistic-plains24

A pair of each of three stops is matched. Of every range: the median error in pixels, the root mean
square of means over 8 by 4 pixels, and the 68 % quantile of errors in stated standard deviations,
which is 1 where these are true.
"""

import sys
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.photogrammetry.synthetic.truth import true_parallax
from tests.support.simulated_stops import images_of
from tests.support.stop_networks import STOPS, simulated_world

RANGES_M = (2, 4, 6, 10, 20, 40)
FEWEST = 500
BLOCK_PX = (4, 8)
HEADING = "range, m: median error, means of 8 by 4, px; errors in stated standard deviations"


def pairs_of(name: str) -> Iterator[tuple[EpipolarImages, np.ndarray]]:
    """Epipolar images of a pair of each of three stops, and the parallax of the left one."""
    world = simulated_world(name).world()
    for number in range(STOPS):
        pair = 1 + 3 * number
        _, images = images_of(world, world.shot(number, pair))
        yield images, true_parallax(world, number, pair, images.geometry)


def figures(images: EpipolarImages, truth: np.ndarray) -> str:
    """The figures of a pair at every range."""
    found, geometry = match_densely(images), images.geometry
    error = found.parallax_px - truth
    range_m = geometry.focal_px * geometry.base_m / found.parallax_px
    down, across = BLOCK_PX
    lines, samples = error.shape[0] // down * down, error.shape[1] // across * across
    blocks = error[:lines, :samples].reshape(lines // down, down, -1, across).mean(axis=(1, 3))
    blocks_m = range_m[:lines:down, :samples:across]
    parts = []
    for near, far in pairwise(RANGES_M):
        here = np.isfinite(error) & (range_m >= near) & (range_m < far)
        some = np.isfinite(blocks) & (blocks_m >= near) & (blocks_m < far) & (abs(blocks) < 1)
        if here.sum() > FEWEST:
            off = np.abs(error[here])
            sigmas = np.quantile(off / found.sigma_px[here], 0.683)
            mean = np.sqrt((blocks[some] ** 2).mean())
            parts.append(f"{near}-{far}: {np.median(off):.3f}, {mean:.3f}; {sigmas:.2f}")
    return " | ".join(parts)


if __name__ == "__main__":
    print(HEADING)  # noqa: T201 - figures are what this makes
    for name in sys.argv[1:]:
        for pair in pairs_of(name):
            print(f"{name}: {figures(*pair)}", flush=True)  # noqa: T201
