"""Which control cannot be true: data snooping of places in control frames.

With the whitened misclosure l of a stop's control at the solution, its derivatives A, the cofactors
Z of all unknowns and the weight w that it had (1; 0 if set aside; less than 1 under a robust loss),
what all other observations predict of it is tested as a whole,

    T^2 = l' [(I + (1 - w) A Z A') (I - w A Z A')]^-1 l             chi distributed

which is v' Q_vv^-1 v for w = 1. Of a frame only the worst is taken out a round, for a wrong place
bends what is near it; those that fit after all come back. Where one of two places that contradict
each other was taken out and nothing else checks the other, nothing tells which of them is wrong: it
goes too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc, gammainccinv

from solmap.photogrammetry.adjustment.collinearity import State
from solmap.photogrammetry.adjustment.control_equations import Control
from solmap.photogrammetry.adjustment.normals import control_weights
from solmap.photogrammetry.adjustment.params import AdjustmentParams
from solmap.photogrammetry.adjustment.problem import Problem
from solmap.photogrammetry.adjustment.residuals import CERTAIN, UNCHECKED
from solmap.photogrammetry.arrays import Float64, PerPoint

CHI_MEDIAN = {2: 1.177, 3: 1.538, 4: 1.832}
"""Median length of a standard normal vector of so many coordinates."""
ALONE = 0.05
"""Where so little of an error shows that what is left of a frame is not checked by the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class ControlTests:
    """How well every control agrees with all the rest."""

    length: PerPoint
    """T; zero where nothing checks it."""
    redundancy: PerPoint
    """Mean share of an error that shows in the residual."""
    gate: PerPoint
    """T beyond which it is a blunder."""

    def worst(self, control: Control) -> np.ndarray:
        """Numbers of the worst blunder of every frame, and of what cannot be told from it."""
        wrong = control.used & (self.length > self.gate) & ~control.is_datum
        doubtful = control.used & (self.redundancy < ALONE) & ~control.is_datum
        doubtful &= np.isin(control.frame, control.frame[~control.used])
        found = [np.flatnonzero(doubtful)]
        for frame in np.unique(control.frame[wrong]):
            mine = wrong & (control.frame == frame)
            found.append(np.flatnonzero(mine)[[self.length[mine].argmax()]])
        return np.concatenate(found)

    def fitting(self, control: Control) -> np.ndarray:
        """Numbers of what was set aside and fits after all."""
        return np.flatnonzero(~control.used & (self.length <= self.gate))


def stand_out(control: Control, state: State, params: AdjustmentParams) -> bool:
    """Whether some control is so far off that others could hide behind it, or is set aside."""
    far = np.linalg.norm(control.whitened(state), axis=1) > params.critical_value
    return bool((far | ~control.used).any())


def control_tests(
    problem: Problem,
    state: State,
    inverse: np.ndarray,
    params: AdjustmentParams,
    threshold: float | None = None,
) -> ControlTests:
    """Tests of all control at a solution; `threshold` is that of the robust loss."""
    control, places = problem.control, problem.control_places
    if control is None or places is None or not len(control.stop):
        none = np.zeros(0)
        return ControlTests(none, none, none)
    l, (of_stop, of_frame) = control.whitened(state), control.partials(state)
    A = np.concatenate([of_frame, of_stop], axis=2)
    predicted = A @ inverse[places] @ A.mT
    weight = control_weights(control, l, threshold)
    w, unit = weight[:, None, None], np.eye(l.shape[1])
    Q = unit - w * predicted
    spread = (unit + (1.0 - w) * predicted) @ (Q + UNCHECKED * unit)
    T = np.sqrt(np.maximum((l * np.linalg.solve(spread, l[:, :, None])[:, :, 0]).sum(axis=1), 0.0))
    checked = np.clip(np.diagonal(Q, axis1=1, axis2=2), 0.0, 1.0) * control.is_given
    count = control.is_given.sum(axis=1)
    redundancy = checked.sum(axis=1) / count
    T = np.where(checked.max(axis=1) > UNCHECKED, T, 0.0)
    return ControlTests(T, redundancy, _gates(T, redundancy, count, control, params))


def _gates(
    T: PerPoint,
    redundancy: PerPoint,
    count: np.ndarray,
    control: Control,
    params: AdjustmentParams,
) -> Float64[np.ndarray, " n"]:
    """As for ties (`gates`): alpha of `critical_value`, widened where all fit worse than stated."""
    gate = np.empty(len(T))
    chance = float(gammaincc(0.5, params.critical_value**2 / 2))
    median = np.array([CHI_MEDIAN[k] for k in count.tolist()])
    for frame in np.unique(control.frame):
        mine = control.frame == frame
        free = float((redundancy * count)[mine].sum())
        sure = 1.0 - CERTAIN * 1.17 / np.sqrt(max(free, 1.0))
        gate[mine] = max(1.0, sure * float(np.median((T / median)[mine])))
    for k in np.unique(count).tolist():
        gate[count == k] *= np.sqrt(2 * gammainccinv(k / 2, k * chance))
    return gate
