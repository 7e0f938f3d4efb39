"""Masked normalised cross-correlation in the frequency domain (Padfield 2012).

For every shift at once, over the n cells that both pictures have seen,

    c = (sum(a b) - sum(a) sum(b) / n) / sqrt(variances of a and b over the same cells).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy import fft

from solmap.photogrammetry.arrays import Float
from solmap.photogrammetry.matching.birds_eye import Channel

Spectrum: TypeAlias = np.ndarray
"""Half of a real picture's discrete Fourier transform, complex."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Fourier transforms of a channel's value, its square and its weight."""

    value: Spectrum
    square: Spectrum
    weight: Spectrum

    @classmethod
    def of(
        cls, channel: Channel, shape: tuple[int, int], weight: Spectrum | None = None
    ) -> Spectra:
        """Transforms over `shape`; channels over the same cells share that of the weight."""
        value, square = (fft.rfft2(k, shape) for k in (channel.value, channel.value**2))
        return cls(value, square, fft.rfft2(channel.weight, shape) if weight is None else weight)


def masked_correlation(
    fixed: Channel, moved: Channel, reach: int
) -> tuple[Float[np.ndarray, "rows cols"], Float[np.ndarray, "rows cols"]]:
    """Correlation coefficient and number of common cells, for every shift of `moved` over `fixed`.

    Entry (reach + i, reach + j) belongs to a shift of i rows down and j columns right.
    """
    rows, cols = (fft.next_fast_len(n + reach, real=True) for n in fixed.value.shape)
    one, other = (Spectra.of(c, (rows, cols)) for c in (fixed, moved))
    common = np.maximum(lagged(one.weight, other.weight, reach, cols), 1.0)
    return coefficient(one, other, common, reach, cols), common


def lagged(a: Spectrum, b: Spectrum, reach: int, cols: int) -> Float[np.ndarray, "lags lags"]:
    """sum(a(x) b(x - lag)) for lags of up to `reach` cells each way."""
    every = fft.irfft2(a * np.conj(b), (a.shape[0], cols))
    lags = np.arange(-reach, reach + 1)
    return every[np.ix_(lags, lags)]


def coefficient(
    one: Spectra, other: Spectra, common: Float[np.ndarray, "lags lags"], reach: int, cols: int
) -> Float[np.ndarray, "lags lags"]:
    """Correlation coefficient over the common cells at every lag."""
    pairs = (
        (one.value, other.value),
        (one.value, other.weight),
        (one.weight, other.value),
        (one.square, other.weight),
        (one.weight, other.square),
    )
    ab, a, b, aa, bb = (lagged(*pair, reach, cols) for pair in pairs)
    variance_a = np.maximum(aa - a**2 / common, 1e-3)
    variance_b = np.maximum(bb - b**2 / common, 1e-3)
    return (ab - a * b / common) / np.sqrt(variance_a * variance_b)
