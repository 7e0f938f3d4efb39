"""Correction of a stereo bar that is not as it was calibrated.

The bar of a camera set may be longer by b than its calibration says, and the right camera turned by
a small rotation r against the left one. With u = (x_r - c_x)/f and v = (y - c_y)/f the parallax of
a point at depth Z then is, to first order in r,

    p = f (B + b)/Z + f (r_y (1 + u^2) - r_z v - r_x u v)

so that with theta = (r_x, r_y, r_z, b) of every camera set the corrected parallaxes

    p - f (r_y (1 + u^2) - r_z v - r_x u v)

belong to straight bars of length B + b. The few theta border the normal equations of the block. For
given theta the adjustment minimises over all else and leaves residuals v_p; by the envelope theorem
the right-hand side of what remains is

    n(theta) = A' W v_p - P theta          A = dp/dtheta, P weights of the prior

and its matrix, the Schur complement of the border, is -dn/dtheta, which four adjustments a camera
set give by differences. Nothing is asked of the solver but to solve.

What can be seen: a toe-in r_y changes near and far points differently and shows in ties between
stops; a longer bar scales everything the set sees and shows only against telemetry or against
another set. What cannot be seen stays at the prior, and the covariance says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import USED, AdjustedNetwork
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId, TiePoints

COLUMNS = 4
"""Three angles and a length."""
PASSES = 3
"""A bent bar makes good ties look like blunders: they are looked for again once it is straight."""
ROUNDS = 8
NEGLIGIBLE = 1e-3
"""A step shorter than this, in its own standard deviations, ends the iteration."""
PROBE = 0.02
"""Step of the differences, in standard deviations of the prior: a hundredth of a pixel or two. With
bends of a whole pixel other ties are placed, and it is another network."""
LEAST_KNOWN = 0.5
"""Least eigenvalue of N in units of the prior's weights: the prior alone makes it 1, and less comes
of a network that jumped."""
SHARP = 1e-12
"""Tolerance of the adjustments whose differences are taken."""
UNLIMITED = 1e6
"""Blunders were taken out before; from here on nothing is to be set aside."""


@dataclass(frozen=True, slots=True)
class RigParams:
    """What calibration leaves open of a stereo bar."""

    turn_deg: float = 0.05
    """Standard deviation of the right camera's rotation, per axis: what thermal bending and years
    on Mars were found to do to archived models."""
    base_m: float = 0.001
    """Standard deviation of the bar's length: half a per cent of the Navcam's."""

    def __post_init__(self) -> None:
        if not (self.turn_deg > 0 and self.base_m > 0):
            raise AdjustmentError(
                "turn_deg and base_m of a rig are standard deviations above zero; leave the rig "
                "correction out to trust the calibration"
            )


@dataclass(frozen=True, slots=True, eq=False)
class RigCorrection:
    """The correction of one camera set."""

    instrument: str
    turn: Float64[np.ndarray, 3]
    """Rotation vector of the right camera against the left, in the pair's frame, radians."""
    base_m: float
    """By how much the bar is longer."""
    covariance: Float64[np.ndarray, "4 4"]
    """Of turn (radians) and length (metres)."""


def calibrate_rig(
    network: Network,
    held: AbstractSet[StopId],
    instruments: Mapping[str, str],
    params: AdjustmentParams,
    rig: RigParams,
    start: AdjustedNetwork | None = None,
) -> tuple[RigCorrection, ...]:
    """The correction of every camera set in a network; `instruments` by pair.

    Raises:
        AdjustmentError: the network could not be adjusted with the bars as calibrated, or their
            normal equations are no sums of squares.
    """
    sets = tuple(sorted({instruments[pair.pair_id] for pair in network.pairs}))
    sigma = np.tile([*3 * [np.radians(rig.turn_deg)], rig.base_m], len(sets))
    theta, C, used = np.zeros(len(sigma)), np.diag(sigma**2), np.zeros(0, dtype=bool)
    for _ in range(PASSES):
        bent = _straightened(network, sets, instruments, theta)
        start, report = adjust(bent, held, params, start, "with bars as they stand")
        if not report.is_usable:
            raise AdjustmentError(f"{report}; a bar can be corrected only where a network stands")
        before, used = used, start.ties.status == USED
        if np.array_equal(before, used):
            break
        border = _Border(
            replace(network, ties=select(network.ties, used)), held, sets, instruments, sigma,
            replace(
                params, critical_value=UNLIMITED, gross=UNLIMITED, huber=UNLIMITED,
                false_share=1 / UNLIMITED, tolerance=SHARP, robust_tolerance=SHARP,
            ), start,
        )  # fmt: skip
        theta, C = border.solved(theta)
    columns = [slice(COLUMNS * k, COLUMNS * k + COLUMNS) for k in range(len(sets))]
    return tuple(
        RigCorrection(name, theta[own][:3], float(theta[own][3]), C[own, own])
        for name, own in zip(sets, columns, strict=True)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Border:
    """The normal equations of theta that are left when all else has been adjusted."""

    network: Network
    """Without what was set aside as blunders, bars as calibrated."""
    held: AbstractSet[StopId]
    sets: tuple[str, ...]
    instruments: Mapping[str, str]
    sigma: Float64[np.ndarray, " k"]
    params: AdjustmentParams
    start: AdjustedNetwork

    def right_side(self, theta: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """n(theta)."""
        bent = _straightened(self.network, self.sets, self.instruments, theta)
        solved, _ = adjust(bent, self.held, self.params, self.start, "bars corrected")
        ties = bent.ties
        weighted = np.nan_to_num(solved.ties.residuals_px[:, 2] / ties.sigma_parallax_px**2)
        products = parallax_partials(bent) * weighted[:, None]
        number = _set_of_row(ties, self.sets, self.instruments)
        sums = [products[number == k].sum(axis=0) for k in range(len(self.sets))]
        return np.concatenate(sums) - theta / self.sigma**2

    def solved(
        self, theta: Float64[np.ndarray, " k"]
    ) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, "k k"]]:
        """The theta that makes n vanish, and its covariance."""
        n = self.right_side(theta)
        steps = np.diag(PROBE * self.sigma)
        N = np.array([(n - self.right_side(theta + step)) / step.sum() for step in steps])
        N = (N + N.T) / 2
        if np.linalg.eigvalsh(N * np.outer(self.sigma, self.sigma)).min() < LEAST_KNOWN:
            raise AdjustmentError(
                f"the bars of {', '.join(self.sets)} cannot be corrected: the network jumps while "
                "they are bent; set larger bends right by vertical parallax first, or leave the "
                "rig correction out"
            )
        for _ in range(ROUNDS):
            step = np.linalg.solve(N, n)
            theta = theta + step
            n = self.right_side(theta)
            if step @ N @ step < NEGLIGIBLE**2:
                break
        return theta, np.linalg.inv(N)


def with_rig(
    network: Network, instruments: Mapping[str, str], corrections: tuple[RigCorrection, ...]
) -> Network:
    """The network as straight bars of the corrected lengths would have measured it."""
    sets = tuple(correction.instrument for correction in corrections)
    theta = np.array([[*c.turn, c.base_m] for c in corrections]).ravel()
    return _straightened(network, sets, instruments, theta)


def parallax_partials(network: Network) -> Float64[np.ndarray, "n 4"]:
    """Derivatives of the parallaxes of all observations by (r_x, r_y, r_z, b); zero without one."""
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


def _straightened(
    network: Network, sets: tuple[str, ...], instruments: Mapping[str, str], theta: np.ndarray
) -> Network:
    by_set = theta.reshape(len(sets), COLUMNS)
    number = _set_of_row(network.ties, sets, instruments)
    turns = by_set[number, :3]
    bent = (parallax_partials(network)[:, :3] * turns).sum(axis=1)
    longer = {name: float(by_set[k, 3]) for k, name in enumerate(sets)}
    pairs = tuple(
        replace(
            pair,
            geometry=replace(
                pair.geometry, base_m=pair.geometry.base_m + longer[instruments[pair.pair_id]]
            ),
        )
        for pair in network.pairs
    )
    ties = replace(network.ties, parallax_px=network.ties.parallax_px - bent)
    return Network(network.stops, pairs, ties)


def _set_of_row(
    ties: TiePoints, sets: tuple[str, ...], instruments: Mapping[str, str]
) -> np.ndarray:
    numbers = np.array([sets.index(instruments[name]) for name in ties.pair_ids], dtype=np.int64)
    return numbers[ties.pair] if len(ties) else np.zeros(0, dtype=np.int64)
