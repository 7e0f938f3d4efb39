"""Epipolar images of textured planes whose parallax is known at every pixel."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.matching.records import EpipolarImages

BORDER = 100
"""Texture beyond the image, so that parallax does not run off it."""


@cache
def spline_of_texture(seed: int, size: int) -> np.ndarray:
    """Spline coefficients of texture with unit contrast and detail of one to twelve pixels."""
    rng = np.random.default_rng(seed)
    octaves = (ndimage.gaussian_filter(rng.normal(size=(size, size)), k) * k for k in (0.8, 3, 12))
    texture = sum(octaves)
    return ndimage.spline_filter(texture / texture.std(), 3, mode="mirror")


@dataclass(frozen=True)
class Plane:
    """A textured plane of parallax at + per_sample x + per_line y, seen where `inside` is true."""

    inside: Callable[[np.ndarray, np.ndarray], np.ndarray]
    at: float
    per_sample: float = 0.0
    per_line: float = 0.0
    contrast: float = 200.0
    seed: int = 1

    def grey(self, x, y, size):
        """Texture glued to the plane."""
        place = [y + BORDER, x + BORDER]
        texture = spline_of_texture(self.seed, size + 2 * BORDER)
        return 1200.0 + self.contrast * ndimage.map_coordinates(
            texture, place, order=3, prefilter=False
        )


@dataclass(frozen=True)
class Scene:
    images: EpipolarImages
    parallax_px: np.ndarray
    """True parallax on the left grid."""
    seen_by_both: np.ndarray


@pytest.fixture
def scene():
    """A function that renders planes, later ones in front, with noise of known strength."""

    def render(planes, size=256, noise=10.0, focal_px=1200.0):
        y, x = np.mgrid[0:size, 0:size].astype(float)
        left, right, truth = np.zeros((3, size, size))
        in_left, in_right = np.zeros((2, size, size), int)
        for number, plane in enumerate(planes):
            parallax = plane.at + plane.per_sample * x + plane.per_line * y
            x_left = (x + plane.at + plane.per_line * y) / (1 - plane.per_sample)
            here, there = plane.inside(x, y), plane.inside(x_left, y)
            left = np.where(here, plane.grey(x, y, size), left)
            right = np.where(there, plane.grey(x_left, y, size), right)
            truth = np.where(here, parallax, truth)
            in_left, in_right = np.where(here, number, in_left), np.where(there, number, in_right)
        partner = np.rint(x - truth).astype(int)
        seen = (partner >= 0) & (
            np.take_along_axis(in_right, partner.clip(0, size - 1), axis=1) == in_left
        )
        rng = np.random.default_rng(7)
        geometry = EpipolarPair(
            Pose(rover_frame(1, 0), Frame(FrameKind.PAIR, (1,)), np.eye(3), np.zeros(3)),
            base_m=0.2,
            focal_px=focal_px,
            centre_px=((size - 1) / 2, (size - 1) / 2),
            samples=size,
            lines=size,
        )
        whole = np.ones((size, size), dtype=bool)
        noisy = [(i + rng.normal(size=i.shape) * noise).astype(np.float32) for i in (left, right)]
        images = EpipolarImages(geometry, noisy[0], whole, noisy[1], whole.copy())
        return Scene(images, truth, seen)

    return render


@pytest.fixture
def ground():
    """Level ground below a mast: parallax grows by 0.13 px a row."""
    return Plane(lambda _, y: y >= 0, at=4.0, per_sample=0.01, per_line=0.13)


@pytest.fixture
def rock():
    """The upright face of a rock in front of the ground."""
    return Plane(lambda x, y: (np.abs(x - 140) < 25) & (np.abs(y - 140) < 20), at=45.0, seed=2)


@pytest.fixture
def sky():
    """No texture above row 60."""
    return Plane(lambda _, y: y < 60, at=0.5, contrast=0.0)
