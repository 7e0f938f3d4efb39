"""Correction of stereo rigs that differ from their calibration.

The baseline of a camera set may be longer by b than calibrated, and the right camera rotated by a
small rotation r against the left one. With u = (x_r - c_x)/f and v = (y - c_y)/f the parallax of a
point at depth Z is, to first order in r,

    p = f (B + b)/Z + f (r_y (1 + u^2) - r_z v - r_x u v)

so that with theta = (r_x, r_y, r_z, b) of every camera set the corrected parallaxes

    p - f (r_y (1 + u^2) - r_z v - r_x u v)

belong to rigs as calibrated with baselines B + b. The few theta extend the normal equations of the
network. For given theta the adjustment minimises over all other unknowns and leaves residuals v_p;
by the envelope theorem the reduced right-hand side is

    n(theta) = A' W v_p - P theta A = dp/dtheta, P weights of the prior

and its matrix, a Schur complement, is -dn/dtheta, found by differences of four adjustments for each
camera set. The solver itself needs no change.

Toe-in r_y changes near and far points differently and is determined by ties between pairs. A longer
baseline scales everything that the set sees and is determined only by telemetry or by another set.
Unknowns that the network does not determine keep the prior's value and standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    USED,
    AdjustedNetwork,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust
from solmap.photogrammetry.adjustment.solver.results import SIGNIFICANT
from solmap.photogrammetry.arrays import Float64, Vector3
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.alignment import RIG_ROTATION_SIGMA_DEG

BASELINE_SIGMA_M = 0.001
"""Prior standard deviation of the baseline: half a per cent of the Navcam's."""
UNKNOWNS = 4
"""Number of unknowns of a camera set: three angles and a length."""
PASSES = 3
"""Number of passes: a wrong rig makes good ties look like blunders, so they are tested again once
it is corrected."""
ROUNDS = 8
NEGLIGIBLE = 1e-3
"""Length of a step, in its own standard deviations, that ends the iteration."""
PROBE = 0.02
"""Step of the differences, in standard deviations of the prior: a hundredth of a pixel or two.
Rotations of a whole pixel would change which ties are placed, and with them the network."""
CURVED = 1e-3
"""Share of the largest eigenvalue of N that curvature of the equations may take from another one.
The prior alone makes all of them 1 in units of its weights; smaller ones result where ties changed
between two differences."""
SHARP = 1e-12
"""Tolerance of the adjustments that are differenced."""


@dataclass(frozen=True, slots=True, eq=False)
class RigCorrection:
    """The correction of one camera set."""

    instrument: str
    rotation: Vector3
    """Rotation vector of the right camera against the left, in the pair's frame (right, down,
    forward), radians."""
    baseline_m: float
    """Length of the baseline beyond its calibration."""
    covariance: Float64[np.ndarray, "4 4"]
    """Covariance of rotation (radians) and baseline (metres)."""

    @property
    def values(self) -> Float64[np.ndarray, " 4"]:
        """Rotation (radians) and baseline (metres)."""
        return np.append(self.rotation, self.baseline_m)

    @property
    def sigmas(self) -> Float64[np.ndarray, " 4"]:
        """Standard deviations of `values`."""
        return np.sqrt(np.diagonal(self.covariance))


def prior_sigmas(sets: int) -> Float64[np.ndarray, " k"]:
    """Prior standard deviations of the unknowns of a number of camera sets."""
    return np.tile([*3 * [np.radians(RIG_ROTATION_SIGMA_DEG)], BASELINE_SIGMA_M], sets)


@dataclass(frozen=True, slots=True, eq=False)
class RigCalibration:
    """The corrections of a network's camera sets, and the fit of the network with and without."""

    corrections: tuple[RigCorrection, ...]
    """Corrections by name of the camera set."""
    covariance: Float64[np.ndarray, "k k"]
    """Covariance of all their values together."""
    as_labelled: AdjustmentReport
    corrected: AdjustmentReport


def calibrate_rig(
    network: Network,
    held: AbstractSet[StopId],
    instruments: Mapping[str, str],
    params: AdjustmentParams,
    start: AdjustedNetwork | None = None,
) -> RigCalibration:
    """Estimate the correction of every camera set of a network.

    Args:
        network: Stops, pairs and ties, as matched with the rigs of the labels.
        held: Stops that are held as the datum.
        instruments: Camera set by pair. Pairs that are not in it are not corrected.
        params: Of the adjustment.
        start: The previous adjustment, if any.

    Raises:
        AdjustmentError: no pair has a camera set, the network cannot be adjusted, or its normal
            equations are not positive definite.
    """
    sets = tuple(
        sorted({instruments[p.pair_id] for p in network.pairs if p.pair_id in instruments})
    )
    if not sets:
        raise AdjustmentError(
            f"no stereo pair with tie points is in the network of {len(network.stops)} stops: "
            "there is no rig to correct"
        )
    # otherwise a bent rig would enlarge all standard deviations
    params = replace(params, sigma_freedoms=np.inf)
    sigma = prior_sigmas(len(sets))
    theta, C, used = np.zeros(len(sigma)), np.diag(sigma**2), np.zeros(0, dtype=bool)
    reports: list[AdjustmentReport] = []
    for _ in range(PASSES):
        start, report = _adjust_or_raise(
            _with_theta(network, sets, instruments, theta), held, params, start
        )
        reports.append(report)
        before, used = used, start.ties.status == USED
        if np.array_equal(before, used):
            break
        border = _Border.of(network, start, held, sets, instruments, sigma, params)
        theta, C = border.solve(theta)
    else:
        bent = _with_theta(network, sets, instruments, theta)
        reports.append(_adjust_or_raise(bent, held, params, start)[1])
    columns = [slice(UNKNOWNS * k, UNKNOWNS * k + UNKNOWNS) for k in range(len(sets))]
    corrections = tuple(
        RigCorrection(name, theta[own][:3], float(theta[own][3]), C[own, own])
        for name, own in zip(sets, columns, strict=True)
    )
    return RigCalibration(corrections, C, reports[0], reports[-1])


def with_corrected_rigs(
    network: Network, instruments: Mapping[str, str], corrections: tuple[RigCorrection, ...]
) -> Network:
    """The network as measured with rigs as calibrated and baselines as estimated."""
    sets = tuple(correction.instrument for correction in corrections)
    theta = np.concatenate([correction.values for correction in corrections])
    return _with_theta(network, sets, instruments, theta)


def parallax_partials(network: Network) -> Float64[np.ndarray, "n 4"]:
    """Derivatives of all parallaxes by (r_x, r_y, r_z, b), in pixels per radian and per metre.

    Zero where no parallax was measured.
    """
    ties = network.ties
    shapes = {pair.pair_id: pair.geometry for pair in network.pairs}
    own = [shapes[name] for name in ties.pair_ids]
    f = np.array([shape.focal_px for shape in own])[ties.pair]
    centre = np.array([shape.centre_px for shape in own]).reshape(-1, 2)[ties.pair]
    base_m = np.array([shape.base_m for shape in own])[ties.pair]
    u = (ties.left[:, 0] - ties.parallax_px - centre[:, 0]) / f
    v = (ties.left[:, 1] - centre[:, 1]) / f
    A = np.column_stack([-f * u * v, f * (1 + u**2), -f * v, ties.parallax_px / base_m])
    return np.nan_to_num(A)


@dataclass(frozen=True, slots=True, eq=False)
class _Border:
    """The reduced normal equations of theta, after elimination of all other unknowns."""

    network: Network
    """The network without excluded blunders, rigs as calibrated."""
    held: AbstractSet[StopId]
    sets: tuple[str, ...]
    instruments: Mapping[str, str]
    sigma: Float64[np.ndarray, " k"]
    params: AdjustmentParams
    start: AdjustedNetwork
    is_of_set: tuple[np.ndarray, ...]
    """Rows of the ties of each camera set."""

    @classmethod
    def of(  # noqa: PLR0913, PLR0917 - the network, where it stands, and what is asked of it
        cls,
        network: Network,
        adjusted: AdjustedNetwork,
        held: AbstractSet[StopId],
        sets: tuple[str, ...],
        instruments: Mapping[str, str],
        sigma: np.ndarray,
        params: AdjustmentParams,
    ) -> _Border:
        """Of the observations that an adjustment used; none is set aside later."""
        good = replace(
            network,
            ties=select(network.ties, adjusted.ties.status == USED),
            control=tuple(one.control for one in adjusted.control if one.used),
        )
        number = _set_of_row(good, sets, instruments)
        of_set = tuple(np.flatnonzero(number == k) for k in range(len(sets)))
        all_count = replace(params, critical_value=np.inf, tolerance=SHARP, sigma_freedoms=np.inf)
        return cls(good, held, sets, instruments, sigma, all_count, adjusted, of_set)

    def right_side(
        self, theta: Float64[np.ndarray, " k"]
    ) -> tuple[Float64[np.ndarray, " k"], AdjustmentReport]:
        """n(theta), and the report of its adjustment."""
        bent = _with_theta(self.network, self.sets, self.instruments, theta)
        solved, report = adjust(bent, self.held, self.params, self.start, "rigs corrected")
        residuals = solved.ties.residuals_px[:, 2]
        weighted = np.nan_to_num(residuals / bent.ties.sigma_parallax_px**2)
        # at adjusted parallaxes: the noise of measured ones is that of the residuals, and their
        # product would make every baseline longer
        ties = replace(bent.ties, parallax_px=bent.ties.parallax_px - residuals)
        products = parallax_partials(replace(bent, ties=ties)) * weighted[:, None]
        sums = [products[rows].sum(axis=0) for rows in self.is_of_set]
        return np.concatenate(sums) - theta / self.sigma**2, report

    def solve(
        self, theta: Float64[np.ndarray, " k"]
    ) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, "k k"]]:
        """The theta at which n vanishes, and its covariance.

        As for all covariances of a network, a sigma0 significantly above one enlarges it.
        """
        n, report = self.right_side(theta)
        steps = np.diag(PROBE * self.sigma)
        N = np.array([(n - self.right_side(theta + step)[0]) / step.sum() for step in steps])
        scale = np.outer(self.sigma, self.sigma)
        known, axes = np.linalg.eigh((N + N.T) / 2 * scale)
        if known[0] < 1.0 - CURVED * known[-1]:
            raise AdjustmentError(
                f"the rigs of {', '.join(self.sets)} cannot be corrected: the ties in use change "
                "with each trial correction; match again with rows that correspond, or veto "
                "wrong ties by hand"
            )
        N = (axes * np.maximum(known, 1.0)) @ axes.T / scale
        for _ in range(ROUNDS):
            step = np.linalg.solve(N, n)
            theta = theta + step
            n, report = self.right_side(theta)
            if step @ N @ step < NEGLIGIBLE**2:
                break
        prior = np.diag(1.0 / self.sigma**2)
        return theta, np.linalg.inv((N - prior) / _variance_factor(report) + prior)


def _variance_factor(report: AdjustmentReport) -> float:
    """Sigma0 squared where significantly larger than one, else one."""
    cost = report.sigma0**2 * report.redundancy
    return report.sigma0**2 if cost > chdtri(report.redundancy, 1.0 - SIGNIFICANT) else 1.0


def _adjust_or_raise(
    network: Network,
    held: AbstractSet[StopId],
    params: AdjustmentParams,
    start: AdjustedNetwork | None,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    adjusted, report = adjust(network, held, params, start, "with present rigs")
    if not report.is_usable:
        raise AdjustmentError(f"{report}; a rig can be corrected only where a network is adjusted")
    return adjusted, report


def _with_theta(
    network: Network, sets: tuple[str, ...], instruments: Mapping[str, str], theta: np.ndarray
) -> Network:
    by_set = np.vstack([theta.reshape(len(sets), UNKNOWNS), np.zeros(UNKNOWNS)])
    # the last: without a camera set
    rotations = by_set[_set_of_row(network, sets, instruments), :3]
    shift = (parallax_partials(network)[:, :3] * rotations).sum(axis=1)
    longer = {name: float(by_set[k, 3]) for k, name in enumerate(sets)}
    pairs = tuple(
        replace(pair, geometry=replace(pair.geometry, base_m=pair.geometry.base_m + longer[name]))
        if (name := instruments.get(pair.pair_id)) is not None
        else pair
        for pair in network.pairs
    )
    ties = replace(network.ties, parallax_px=network.ties.parallax_px - shift)
    return replace(network, pairs=pairs, ties=ties)


def _set_of_row(
    network: Network, sets: tuple[str, ...], instruments: Mapping[str, str]
) -> np.ndarray:
    """Number of the camera set of every observation; -1 for pairs of none."""
    number = {name: k for k, name in enumerate(sets)}
    ties = network.ties
    own = [number.get(instruments.get(name, ""), -1) for name in ties.pair_ids]
    return np.array(own, dtype=np.int64)[ties.pair] if len(ties) else np.zeros(0, dtype=np.int64)
