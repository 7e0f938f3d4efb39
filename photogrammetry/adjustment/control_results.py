"""Control and its frames as the adjustment left them."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import State
from solmap.photogrammetry.adjustment.control import AdjustedControl, AdjustedFrame
from solmap.photogrammetry.adjustment.control_tests import ControlTests
from solmap.photogrammetry.adjustment.problem import Problem
from solmap.photogrammetry.adjustment.records import Network
from solmap.photogrammetry.adjustment.residuals import UNCHECKED


def adjusted_control(
    network: Network, problem: Problem, state: State, tests: ControlTests
) -> tuple[AdjustedControl, ...]:
    """What became of every control observation."""
    control = problem.control
    if control is None:
        return ()
    off = np.where(control.is_given, control.misclosures(state), np.nan)
    return tuple(
        AdjustedControl(
            one,
            bool(control.used[k]),
            off[k],
            float(tests.length[k]) if tests.redundancy[k] > UNCHECKED else float("nan"),
            float(tests.redundancy[k]),
            _note(off[k], tests, k, used=bool(control.used[k])),
        )
        for k, one in enumerate(network.control)
    )


def _note(off: np.ndarray, tests: ControlTests, k: int, *, used: bool) -> str:
    if not used and tests.length[k] <= tests.gate[k]:
        return "another one contradicts it, and nothing tells which of them is wrong"
    if not used:
        return (
            f"off by {off[0]:+.2f} m east and {off[1]:+.2f} m north, {tests.length[k]:.1f} "
            f"standard deviations where {tests.gate[k]:.1f} may be chance"
        )
    return "" if tests.redundancy[k] > UNCHECKED else "nothing checks it"


def adjusted_frames(
    network: Network, problem: Problem, state: State, inverse: np.ndarray
) -> tuple[AdjustedFrame, ...]:
    """Where every control frame lies."""
    if not network.frames:
        return ()
    unknowns = problem.unknowns
    C = inverse[problem.pattern.own(unknowns.frame_blocks, unknowns.frame_columns)]
    return tuple(
        AdjustedFrame(frame, state.frames[k], (C[k] + C[k].T) / 2)
        for k, frame in enumerate(network.frames)
    )
