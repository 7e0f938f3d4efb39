"""Effects of optics, detector and coding on an image.

Light decreases towards the edges. With r the distance from the middle in half widths of the image,
the flat fields of Curiosity's Navcams (mean of both eyes, up to 0.03) are

    v(r) = 1 - 0.129 r^2 - 0.107 r^4 + 0.048 r^6,

0.91 at the middle of an edge on average, 0.66 in the corners. Dust on the optics darkens discs at
the same position in all images of a camera, smaller ones more. Pixels count electrons:

    DN = signal + noise,     variance = signal / 41.5 + 0.6^2     (full well 170,000 e-, 25 e-).

Finally, images are coded by wavelets to a number of bits per pixel, like ICER; here by JPEG 2000.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from solmap.photogrammetry.arrays import GreyImage, Int32
from solmap.photogrammetry.errors import PixelError
from solmap.photogrammetry.synthetic.lattice import stream_of

SHARPEST_PX = 0.43
"""Standard deviation of a point's image by the area of pixels and the sampling of the panorama
only."""
FALLOFF = (-0.129, -0.107, 0.048)
"""Coefficients of the vignetting, by even powers of the distance from the middle."""
DUST_PX = (1.5, 25.0)
"""Radii of dust specks on a full frame, distributed evenly over their logarithm."""
ELECTRONS_PER_DN = 41.5
READ_DN = 0.6
BRIGHTEST_DN = 4095
CONTAINER_BITS = 16
"""Bits of a pixel before coding, which define the coder's ratio."""


@dataclass(frozen=True, slots=True)
class CameraParams:
    """Imperfections common to all cameras."""

    psf_px: float = SHARPEST_PX
    """Standard deviation of the image of a point, including the pixel's own area."""
    vignetting: float = 0.0
    """Fraction of the vignetting of Curiosity's Navcams."""
    dust_specks: int = 0
    """Number of dust specks on every camera."""
    bits_per_pixel: float = 0.0
    """Bits per pixel of the wavelet coding; 0: none."""

    def __post_init__(self) -> None:
        if self.psf_px < SHARPEST_PX or not 0 <= self.bits_per_pixel <= CONTAINER_BITS:
            raise PixelError(
                f"psf_px must be at least {SHARPEST_PX} and bits_per_pixel at most "
                f"{CONTAINER_BITS}, not {self.psf_px} and {self.bits_per_pixel}"
            )


def expose(
    signal: GreyImage, transmission: GreyImage, averaging: int, rng: np.random.Generator
) -> Int32[np.ndarray, "lines samples"]:
    """The counts of the converter for a mean signal without noise."""
    signal = signal * transmission
    noise = rng.standard_normal(signal.shape, dtype=np.float32)
    share = np.float32(1 / (ELECTRONS_PER_DN * averaging**2))
    noise *= np.sqrt(np.maximum(signal, 0) * share + np.float32(READ_DN**2))
    signal += noise
    return np.clip(np.rint(signal), 1, BRIGHTEST_DN).astype(np.int32)


@lru_cache(maxsize=4)
def transmission(params: CameraParams, side: int, *name: int) -> GreyImage:
    """Fraction of the light that optics and dust transmit to every pixel of a camera.

    Args:
        params: of the optics.
        side: samples and lines of the image.
        name: of the camera; each has its own dust.
    """
    row, column = np.mgrid[:side, :side].astype(np.float32)
    middle = (side - 1) / 2
    square = ((row - middle) ** 2 + (column - middle) ** 2) / np.float32(middle**2)
    first, second, third = FALLOFF
    falloff = square * (first + square * (second + square * third))
    passed: GreyImage = (1 + params.vignetting * falloff).astype(np.float32)
    rng = stream_of(*name)
    for _ in range(params.dust_specks):
        radius_px = np.exp(rng.uniform(*np.log(DUST_PX))) * side / 1024
        line, sample = rng.uniform(0, side, 2)
        depth = rng.uniform(0.05, 0.25) * (DUST_PX[0] / radius_px) ** 0.5
        apart = ((row - line) ** 2 + (column - sample) ** 2) / radius_px**2
        passed *= 1 - np.float32(depth) / (1 + apart.astype(np.float32) ** 3)
    return passed


def compress(
    pixels: Int32[np.ndarray, "lines samples"], bits_per_pixel: float
) -> Int32[np.ndarray, "lines samples"]:
    """The image after wavelet coding and decoding."""
    share = [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, round(1000 * bits_per_pixel / CONTAINER_BITS)]
    _, coded = cv2.imencode(".jp2", pixels.astype(np.uint16), share)
    decoded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED))
    return np.clip(decoded, 1, BRIGHTEST_DN).astype(np.int32)
