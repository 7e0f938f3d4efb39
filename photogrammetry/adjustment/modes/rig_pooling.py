"""One rotation of the right camera for every camera set, pooled over the stops of a mission.

Unknowns are theta = (r_x, r_y, r_z, b) of every camera set, as in `rig_calibration`. A stop s
contributes normal equations N_s theta = n_s, from two kinds of observations:

- vertical parallaxes of its pairs (`matching.stereo.orientation.RowCells`), which give r_x and r_z
  to a hundredth of a pixel and toe-in r_y only for a wide field of view;
- the ties between its pairs: near and far points, and those of another camera set, contradict each
  other under a wrong toe-in. `stop_normal_equations` takes them from `calibrate_rig`. Ties to other
  stops are left out: they may lie on shadows that have moved, which would bias toe-in.

The rig bends with temperature, and also irregularly. Each stop therefore has a rotation of its own,
linear in the temperature t_s of its cameras where labels give it,

    theta_s = theta + k (t_s - t) + d_s = D_s phi + d_s

T is the variance of d_s and K that of k, the same about every axis and estimated from r_x and r_z
of the stops; K is zero, and k not an unknown, where they do not correlate with temperature. Pooled:

    N = P + sum_s D_s' N_s (1 + T N_s)^-1 D_s          n = sum_s D_s' (1 + N_s T)^-1 n_s

and for stop s, with N_-s and n_-s the sums of all other stops,

    C_s = [N_s + (D_s N_-s^-1 D_s' + T)^-1]^-1

P holds the priors. That of toe-in is the spread of the rig's rotation about the other two axes,
since no cause bends it about one axis alone, plus the error of calibration on ground. Camera sets
on one mast share it, up to their difference about the other two axes.

A correction is applied where it is significant, and kept until its error is significant and large
enough to matter (`correction_to_apply`). The remainder, C_s and the difference to the applied one,
is a standard deviation common to all parallaxes of the camera set (`toe_in_sigma`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.linalg import block_diag

from solmap.photogrammetry.adjustment.model.network import Network
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.rig_calibration import (
    UNKNOWNS,
    calibrate_rig,
    prior_sigmas,
)
from solmap.photogrammetry.arrays import Float64, Vector3
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.matching.stereo.orientation import RowCells

SHARED_CELL_PX = 40.0
"""Side of an image cell within which ties have the same error; cells are distinguished where the
pairs of a stop share ties."""
CALIBRATION_SIGMA_RAD = float(np.radians(0.005))
"""Standard deviation of toe-in calibrated on ground: a tenth of a Navcam's pixel."""
HAZARD_CAMERA = "HAZCAM"
"""Parts of names of camera sets that are not on the mast."""
STANDS_OUT = 3.0
"""Standard deviations by which a rig must differ from its labels to be corrected, and its rows must
correlate with temperature to be modelled so."""
NEGLIGIBLE_PX = 0.02
"""Error of rows or parallaxes that does not justify matching again."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraRows:
    """Vertical parallaxes of a stop's pairs of one camera set."""

    cells: RowCells
    pairs: int
    focal_px: float
    """Focal length of the finest pair."""
    samples: int
    """Width of its images."""
    celsius: float | None = None
    """Temperature of the cameras, mean of the pairs; None where labels give none."""

    def effects_px(self, rotation: Vector3) -> Vector3:
        """Largest shift of points by a rotation about each axis, along or across rows."""
        return np.abs(rotation) * [self.focal_px, self.focal_px, self.samples / 2]


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations by ties of the corrections of camera sets, four unknowns each."""

    cameras: tuple[str, ...]
    N: Float64[np.ndarray, "k k"]
    n: Float64[np.ndarray, " k"]

    def placed_in(self, cameras: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """These equations among more camera sets."""
        at = np.concatenate(
            [UNKNOWNS * cameras.index(name) + np.arange(UNKNOWNS) for name in self.cameras]
        )
        N, n = np.zeros((UNKNOWNS * len(cameras),) * 2), np.zeros(UNKNOWNS * len(cameras))
        N[np.ix_(at, at)], n[at] = self.N, self.n
        return N, n


@dataclass(frozen=True, slots=True, eq=False)
class StopRig:
    """All observations of a stop about the stereo rigs."""

    rows: Mapping[str, CameraRows]
    """Rows by camera set."""
    ties: NormalEquations | None = None

    @property
    def cameras(self) -> tuple[str, ...]:
        """The camera sets with observations."""
        return (*self.rows, *(self.ties.cameras if self.ties else ()))

    def among(self, cameras: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """The normal equations of its ties, with the unknowns of more camera sets."""
        if self.ties:
            return self.ties.placed_in(cameras)
        size = UNKNOWNS * len(cameras)
        return np.zeros((size, size)), np.zeros(size)


@dataclass(frozen=True, slots=True, eq=False)
class RigRotation:
    """The rotation of a camera set's right camera at a stop, against its labels."""

    rotation: Vector3
    """Rotation vector in the pair's frame (right, down, forward), radians."""
    covariance: Float64[np.ndarray, "3 3"]

    @property
    def sigmas(self) -> Vector3:
        """Standard deviations."""
        return np.sqrt(np.diagonal(self.covariance))

    def toe_in_sigma(self, applied: Vector3) -> float:
        """Standard deviation of toe-in, radians, where another rotation is applied."""
        return float(np.hypot(self.sigmas[1], self.rotation[1] - applied[1]))


def stop_normal_equations(
    network: Network,
    instruments: Mapping[str, str],
    applied: Mapping[str, Vector3],
    params: AdjustmentParams,
) -> NormalEquations:
    """Normal equations of the camera sets of a stop from the ties within it.

    Args:
        network: Of the stop alone.
        instruments: Camera set by pair.
        applied: Rotations of the right cameras before their pairs were matched.
        params: Of the adjustment.

    Raises:
        AdjustmentError: the network cannot be adjusted, or determines no correction.
    """
    found = calibrate_rig(network, set(network.stop_ids), instruments, params)
    cameras = tuple(one.instrument for one in found.corrections)
    theta = np.concatenate([one.values for one in found.corrections])
    weight = np.linalg.inv(found.covariance)
    N = _positive(weight - np.diag(prior_sigmas(len(cameras)) ** -2.0), len(cameras))
    before = np.concatenate([np.append(applied.get(name, np.zeros(3)), 0.0) for name in cameras])
    return NormalEquations(cameras, N, weight @ theta + N @ before)


def weigh_by_cells(ties: Ties) -> Ties:
    """Scale the ties of two pairs in one image cell to the total weight of a single tie.

    Their windows cover the same ground and have the same error where it is uneven: hundreds of ties
    of a Pancam pair lie on a few cells of a Navcam pair.
    """
    shares = np.ones(len(ties))
    for left in (ties.first_left, ties.second_left):
        cell = np.floor_divide(left, SHARED_CELL_PX)
        names = np.column_stack([ties.first, ties.second, cell])
        _, which, count = np.unique(names, axis=0, return_inverse=True, return_counts=True)
        shares = np.maximum(shares, count[which.ravel()])
    sigmas = [f.name for f in fields(ties) if "sigma" in f.name]
    return replace(ties, **{name: getattr(ties, name) * np.sqrt(shares) for name in sigmas})


def add_toe_in(ties: Ties, sigmas_px: Mapping[str, float]) -> Ties:
    """Ties between stops with the uncertainty of toe-in added, pixels by pair.

    All parallaxes of a camera set share it, so it is enlarged such that the mean of n ties has the
    same standard deviation.
    """
    shared = np.array([sigmas_px.get(name, 0.0) for name in ties.pair_ids]) * len(ties) ** 0.5
    return replace(
        ties,
        first_sigma_parallax_px=np.hypot(ties.first_sigma_parallax_px, shared[ties.first]),
        second_sigma_parallax_px=np.hypot(ties.second_sigma_parallax_px, shared[ties.second]),
    )


def pooled_rotations(stops: Mapping[str, StopRig]) -> dict[str, dict[str, RigRotation]]:
    """The rotation of every camera set at every stop, by stop and camera set."""
    cameras = sorted({name for stop in stops.values() for name in stop.cameras})
    if not cameras:
        return {name: {} for name in stops}
    size, turns = UNKNOWNS * len(cameras), np.tile([True, True, True, False], len(cameras))
    own, spreads = _rows_of_stops(stops, cameras)
    variances, slopes = (
        np.where(turns, np.repeat([getattr(one, name) for one in spreads], UNKNOWNS), 0.0)
        for name in ("alone", "per_kelvin")
    )
    parts: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name, stop in stops.items():
        N, n = stop.among(cameras)
        for camera, (N_rows, n_rows) in own[name].items():
            at = slice(start := UNKNOWNS * cameras.index(camera), start + 3)
            N[at, at] += N_rows
            n[at] += n_rows
        parts[name] = N, n
    T, eye, bends = np.diag(variances), np.eye(size), np.flatnonzero(slopes)
    kelvin = {name: [one.kelvin.get(name, 0.0) for one in spreads] for name in stops}
    D = {
        name: np.hstack([eye, np.diag(np.repeat(warmer, UNKNOWNS))[:, bends]])
        for name, warmer in kelvin.items()
    }
    shares = {
        name: (
            D[name].T @ N @ np.linalg.inv(eye + T @ N) @ D[name],
            D[name].T @ np.linalg.solve(eye + N @ T, n),
        )
        for name, (N, n) in parts.items()
    }
    prior = block_diag(_prior(own, cameras), np.diag(1.0 / slopes[bends]))
    N_all = prior + sum(N for N, _ in shares.values())
    n_all = sum(n for _, n in shares.values())
    found: dict[str, dict[str, RigRotation]] = {}
    for name, (N, n) in parts.items():
        others = np.linalg.inv(N_all - shares[name][0])
        mean = D[name] @ others @ (n_all - shares[name][1])
        weight = np.linalg.inv(D[name] @ others @ D[name].T + T)
        C = np.linalg.inv(N + weight)
        theta = C @ (n + weight @ mean)
        found[name] = {
            camera: RigRotation(theta[at], C[at, at])
            for k, camera in enumerate(cameras)
            if camera in stops[name].rows
            for at in [slice(UNKNOWNS * k, UNKNOWNS * k + 3)]
        }
    return found


def correction_to_apply(found: RigRotation, applied: Vector3, rows: CameraRows) -> Vector3:
    """Rotation to apply to the right camera: the present one, unless it is significantly wrong.

    Labels are kept unless they are significantly wrong; a correction is the estimate.
    """
    off = found.rotation - applied
    certain = 1.0 if applied.any() else STANDS_OUT
    is_wrong = (np.abs(off) > certain * found.sigmas) & (rows.effects_px(off) > NEGLIGIBLE_PX)
    return found.rotation if is_wrong.any() else applied


@dataclass(frozen=True, slots=True, eq=False)
class _Spread:
    """Variation of the rotation of a camera set from stop to stop."""

    alone: float = 0.0
    """T: unexplained variance, squared radians."""
    per_kelvin: float = 0.0
    """K: variance of the change with temperature; zero where not significant."""
    kelvin: Mapping[str, float] = field(default_factory=dict)
    """Temperature of a stop minus the mean of all stops with a temperature."""


def _rows_of_stops(
    stops: Mapping[str, StopRig], cameras: Sequence[str]
) -> tuple[dict[str, dict[str, tuple[np.ndarray, np.ndarray]]], list[_Spread]]:
    """Normal equations of the rows of every stop and camera set; spreads of the camera sets.

    The cells of all stops together show the error of the lens model.
    """
    own: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {name: {} for name in stops}
    spreads: list[_Spread] = []
    for camera in cameras:
        rows = {name: stop.rows[camera] for name, stop in stops.items() if camera in stop.rows}
        if not rows:
            spreads.append(_Spread())
            continue
        factor = RowCells.together([one.cells for one in rows.values()]).variance_factor
        for name, one in rows.items():
            N, n = one.cells.normal_equations()
            own[name][camera] = N / factor, n / factor
        measured = {name: one.celsius for name, one in rows.items() if one.celsius is not None}
        mean = float(np.mean([*measured.values()])) if measured else 0.0
        kelvin = {name: celsius - mean for name, celsius in measured.items()}
        warmer = np.array([kelvin.get(name, 0.0) for name in rows])
        spreads.append(
            _Spread(*_variances_between([own[name][camera] for name in rows], warmer), kelvin)
        )
    return own, spreads


def _variances_between(
    stops: Sequence[tuple[np.ndarray, np.ndarray]], kelvin: Float64[np.ndarray, " stops"]
) -> tuple[float, float]:
    """T and K, by r_x and r_z with toe-in left free."""
    if len(stops) < 2:  # noqa: PLR2004 - of one value there is no spread
        return 0.0, 0.0
    P = np.diag(prior_sigmas(1)[:3] ** -2.0)
    C = np.array([np.linalg.inv(N + P) for N, _ in stops])
    seen = np.array([one @ n for one, (_, n) in zip(C, stops, strict=True)])[:, ::2]
    noise = np.diagonal(C, axis1=1, axis2=2)[:, ::2].mean(axis=0)
    weight = noise**-2.0 / (noise**-2.0).sum()  # of a variance

    def alone(variance: np.ndarray) -> float:
        return max(0.0, float(weight @ (variance - noise)))

    seen = seen - seen.mean(axis=0)
    free, square = len(stops) - 2, float(kelvin @ kelvin)
    if free > 0 and square > 0:
        slope = kelvin @ seen / square
        left = (seen - np.outer(kelvin, slope)).var(axis=0, ddof=0) * len(stops) / free
        by_chance = np.maximum(left, noise) / square
        K = float(weight @ (slope**2 - STANDS_OUT**2 * by_chance))
        if K > 0:
            return alone(left), K
    return alone(seen.var(axis=0, ddof=1)), 0.0


def _prior(
    own: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]], cameras: Sequence[str]
) -> np.ndarray:
    """Weights of the priors.

    Toe-in is about as large as the other rotations. A bent mast affects its two camera sets
    equally, up to the difference of their other rotations.
    """
    C = np.diag(prior_sigmas(len(cameras)) ** 2)
    seen = np.array([_bend(one, own, C[:3, :3]) for one in cameras])
    on_mast = np.array([HAZARD_CAMERA not in one for one in cameras])
    for group in (on_mast, ~on_mast):
        if not group.any():
            continue
        mean = seen[group].mean(axis=0)
        at = UNKNOWNS * np.flatnonzero(group) + 1
        alone = np.mean((seen[group] - mean) ** 2) + CALIBRATION_SIGMA_RAD**2
        C[np.ix_(at, at)] = np.mean(mean**2) + alone * np.eye(len(at))
    return np.linalg.inv(C)


def _bend(
    camera: str,
    own: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]],
    C: np.ndarray,
) -> np.ndarray:
    """Rotation of a camera set about x and z by the rows of all stops, with toe-in left free."""
    rows = [stop[camera] for stop in own.values() if camera in stop]
    N, n = np.linalg.inv(C) + sum(N for N, _ in rows), sum((n for _, n in rows), np.zeros(3))
    return np.linalg.solve(N, n)[::2]


def _positive(N: np.ndarray, cameras: int) -> np.ndarray:
    """A matrix with negative eigenvalues, which differencing may cause, set to zero."""
    scale = prior_sigmas(cameras)
    values, vectors = np.linalg.eigh(N * np.outer(scale, scale))
    unit = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return unit / np.outer(scale, scale)
