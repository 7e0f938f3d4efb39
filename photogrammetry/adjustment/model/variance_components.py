"""Variance components: the actual size of errors, by kind of observation.

The standard deviations of telemetry and matching are priors. The standard deviations of a kind of
observation are multiplied by a common factor f, estimated over the mission with the adjustment
itself (Helmert's estimate, simplified by Foerstner 1979): with the residuals v, weights p by the
priors and redundancy numbers r of all observations of the kind,

    f^2 = (nu + sum p v^2) / (nu + sum r) (1 + e),        e = 2 sum r / (nu + sum r)^2

since a residual's expected square is f^2 r / p. The prior has the weight of nu observations that
scatter as stated (an inverse chi-square distribution of f^2), so that with two or three stops f
stays near 1. The sums are random too, with the relative variance e: 1 + e makes the weight 1/f^2
unbiased. The adjustment is repeated until its factors are those that its residuals show.

Ties also have common errors: heights at one stop against another, parallaxes of a pair, shadows
that have moved. Residuals do not contain what is common; matching states it in the standard
deviations of ties. The factor of ties is therefore that of the coordinate that scatters most, of
samples, lines and parallaxes, as far as the difference is significant: the largest of three would
exceed their true factor by chance. Between stops it is never below 1, because residuals cannot show
that common errors are smaller than stated.

For observations that were marginalised (`marginal`) the sums of that moment are kept. Systematic
errors of the mast are never marginalised: their sums are always the present ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.arrays import Float64, Int32


class Component(StrEnum):
    """A kind of observation whose standard deviations are estimated."""

    POSITION = "telemetry position"
    HEADING_STEP = "heading step"
    HEADING = "measured heading"
    TILT = "tilt"
    POINTING = "mast pointing"
    MAST = "systematic mast errors"
    INTER_STEREO = "inter-stereo ties"
    IMAGE_MATCHED = "image-matched cross-site ties"
    SURFACE_MATCHED = "surface-matched cross-site ties"


COMPONENTS = tuple(Component)
TIES = COMPONENTS.index(Component.INTER_STEREO)
"""First component of ties; from here on components are numbered as in `Observations.kind`."""
SAME = 0.05
"""Factors that change by less, or by half of their own standard deviation, leave estimates and
covariances unchanged."""


def _sums() -> Float64[np.ndarray, "components 3"]:
    return np.zeros((len(COMPONENTS), 3))


def _share_by_chance(freedoms: np.ndarray) -> np.ndarray:
    """Relative standard deviation of a factor estimated from a number of residuals."""
    return 1.0 / np.sqrt(2 * freedoms)


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Squared residuals in units of the prior's variances, and the redundancy numbers behind them.

    By component and coordinate: sample, line and parallax of ties, the first alone of the others.
    """

    squares: Float64[np.ndarray, "components 3"] = field(default_factory=_sums)
    redundancy: Float64[np.ndarray, "components 3"] = field(default_factory=_sums)

    def __add__(self, other: Scatter) -> Scatter:
        return Scatter(self.squares + other.squares, self.redundancy + other.redundancy)

    def without_mast(self) -> Scatter:
        """Without the systematic errors of the mast."""
        others = np.array([[name is not Component.MAST] for name in COMPONENTS])
        return Scatter(self.squares * others, self.redundancy * others)

    def factors(self, freedoms: float) -> Float64[np.ndarray, " components"]:
        """Factors of the standard deviations; `freedoms` is nu."""
        squares, redundancy = self.squares.sum(axis=1), self.redundancy.sum(axis=1)
        together = np.sqrt((freedoms + squares) / (freedoms + redundancy))
        alone = np.sqrt((freedoms + self.squares) / (freedoms + self.redundancy))
        sure = 1.0 - _share_by_chance(freedoms + self.redundancy)
        largest = np.maximum(together, (np.where(self.redundancy > 0, sure, 0) * alone).max(axis=1))
        factors = largest * np.sqrt(1.0 + 2.0 * redundancy / (freedoms + redundancy) ** 2)
        factors[TIES + 1 :] = np.maximum(factors[TIES + 1 :], 1.0)
        return np.asarray(factors)


@dataclass(frozen=True, slots=True, eq=False)
class VarianceComponents:
    """The factors of an adjustment, and the sums they were estimated from."""

    factors: Float64[np.ndarray, " components"] = field(
        default_factory=lambda: np.ones(len(COMPONENTS))
    )
    """Used in the adjustment."""
    scatter: Scatter = field(default_factory=Scatter)
    """Scatter of all observations so far."""
    past: Scatter = field(default_factory=Scatter)
    """Scatter of those among them that were marginalised."""
    priors: Float64[np.ndarray, " components"] = field(
        default_factory=lambda: np.ones(len(COMPONENTS))
    )
    """Stated standard deviations: a fraction of the drive, degrees, and 1 for ties."""

    @property
    def sigmas(self) -> dict[Component, float]:
        """Standard deviations as used, in the units of the priors."""
        return dict(zip(COMPONENTS, (self.factors * self.priors).tolist(), strict=True))

    def begin(self, params: AdjustmentParams) -> VarianceComponents:
        """Initial components: the parameters' priors, and the sums known so far."""
        degrees = (params.azimuth_step_deg, params.azimuth_fine_deg, params.tilt_deg)
        priors = np.ones(len(COMPONENTS))
        priors[:TIES] = (params.slip, *degrees, params.pointing_deg, params.mast_deg)
        return replace(self, priors=priors).update(params.sigma_freedoms)

    def update(self, freedoms: float, scatter: Scatter | None = None) -> VarianceComponents:
        """Set the factors of all observations: marginalised ones, and others if given.

        Where `freedoms` is infinite, factors stay unchanged.
        """
        total = self.past.without_mast() + scatter if scatter else self.scatter
        factors = self.factors if np.isinf(freedoms) else total.factors(freedoms)
        return replace(self, factors=factors, scatter=total)

    def is_near(self, other: VarianceComponents, freedoms: float) -> bool:
        """Whether the factors are equal within what matters and what is known."""
        known = 0.5 * _share_by_chance(freedoms + self.scatter.redundancy.sum(axis=1))
        change = np.abs(np.log(self.factors / other.factors))
        return bool((change < np.maximum(SAME, known)).all())

    def apply(self, params: AdjustmentParams) -> AdjustmentParams:
        """The parameters with the estimated standard deviations of telemetry and pointing."""
        f = dict(zip(COMPONENTS, self.factors.tolist(), strict=True))
        return replace(
            params,
            slip=f[Component.POSITION] * params.slip,
            position_floor_m=f[Component.POSITION] * params.position_floor_m,
            azimuth_step_deg=f[Component.HEADING_STEP] * params.azimuth_step_deg,
            azimuth_fine_deg=f[Component.HEADING] * params.azimuth_fine_deg,
            tilt_deg=f[Component.TILT] * params.tilt_deg,
            pointing_deg=f[Component.POINTING] * params.pointing_deg,
            mast_deg=f[Component.MAST] * params.mast_deg,
        )

    def of_ties(self, kind: Int32[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Factors of observations of ties by their kinds."""
        return self.factors[TIES + kind]
