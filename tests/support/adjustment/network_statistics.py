"""Are stated sigmas true? `python -m tests.support.adjustment.network_statistics --networks 200`.

Simulated traverses (see `photogrammetry.synthetic.networks`; 5 pairs a stop, all errors normal with
the stated standard deviations), adjusted in each mode as if the stops came in one by one. Of the
last stop's errors e with stated covariance C, e' C^-1 e / 6 has mean 1 where C is true (NEES); 95 %
of such means over n networks lie in chi2(6 n) / 6 n. Blunders of 5 to 100 px are put into a share
of the cross-site observations; as most ties have two, nearly twice that share of them is wrong.
"""

# ruff: noqa: T201 - a script that reports what it does
from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedStop,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.modes.sequential import begin, extend
from solmap.photogrammetry.adjustment.modes.stepwise import adjust_stepwise
from solmap.photogrammetry.adjustment.solver.marginalisation import SolvedNetwork
from solmap.photogrammetry.adjustment.solver.normal_equations import LinearisationPoint, linearise
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.adjustment.solver.residuals import cofactors
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.synthetic.networks import (
    NetworkTruth,
    TelemetryErrors,
    simulate_network,
)

MODES = ("stepwise", "sequential", "overall")
PARAMS = AdjustmentParams(window_stops=2)
"""So short a window that stops leave it although the networks are small."""
AS_STATED = replace(PARAMS, sigma_freedoms=np.inf)
DETECTED = 7.5
"""Shift of an observation's test by a blunder that is found for certain: the gate of clean networks
(4.4 for three coordinates) and three standard deviations more."""


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of network."""

    cross_ties: int
    far_cross_ties: int
    blunders: float = 0.0
    stops: int = 5
    inter_ties: int = 10

    def simulated(self, seed: int) -> tuple[Network, NetworkTruth]:
        """One of them."""
        errors = TelemetryErrors.assumed_by(PARAMS)
        return simulate_network(
            np.random.default_rng(seed),
            pairs_per_stop=5,
            intra_ties=0,
            errors=errors,
            **asdict(self),
        )


CASES = (
    Case(7, 0),
    Case(10, 4),
    Case(20, 6),
    Case(20, 6, blunders=0.05),
    Case(20, 6, blunders=0.2),
)


@dataclass(frozen=True, slots=True)
class Found:
    """What was found of one network."""

    nees: tuple[float, float, float]
    """Of the last stop in each mode."""
    nees_if_known: float
    """Of the last stop, overall, with standard deviations taken as stated, which is true here."""
    earlier: float
    """Mean over all other stops, overall."""
    cost: float
    redundancy: int
    harmful_left: int
    """Blunders beyond the bound of detection that are still in use, overall."""
    moved: float
    """By how much, in standard deviations, blunders moved a pose at most, overall."""


def error(stop: AdjustedStop, pose: Pose) -> np.ndarray:
    """Rotation vector in the LSL and position, adjusted minus true."""
    turn = Rotation.from_matrix(stop.lsl_from_rover.rotation @ pose.rotation.T).as_rotvec()
    return np.array([*turn, *(stop.lsl_from_rover.translation_m - pose.translation_m)])


def nees(stop: AdjustedStop, pose: Pose) -> float:
    """Normalised squared error over its six degrees of freedom."""
    e = error(stop, pose)
    return float(e @ np.linalg.solve(stop.covariance, e)) / len(e)


def in_each_mode(network: Network) -> tuple[list[AdjustedStop], AdjustedNetwork, AdjustmentReport]:
    """The last stop in each mode, and all of the overall adjustment."""
    traverse, step = None, None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        traverse, _ = begin(part, PARAMS) if k == 0 else extend(traverse, part, [stop], PARAMS)
        step, _ = adjust_stepwise(step, part, [stop], PARAMS)
    overall, report = adjust_overall(network, PARAMS)
    return [step.stops[-1], traverse.stops[-1], overall.stops[-1]], overall, report


def found(case: Case, seed: int) -> Found:
    """One network of a kind, adjusted in each mode."""
    network, truth = case.simulated(seed)
    last, overall, report = in_each_mode(network)
    pairs = list(zip(overall.stops[1:-1], truth.lsl_from_rover[1:-1], strict=True))
    left, moved = _harm(network, truth, overall) if case.blunders else (0, 0.0)
    known = adjust_overall(network, AS_STATED)[0].stops[-1]
    return Found(
        tuple(nees(stop, truth.lsl_from_rover[-1]) for stop in last),
        nees(known, truth.lsl_from_rover[-1]),
        float(np.mean([nees(stop, pose) for stop, pose in pairs])),
        report.sigma0**2 * report.redundancy,
        report.redundancy,
        left,
        moved,
    )


def _harm(network: Network, truth: NetworkTruth, overall: AdjustedNetwork) -> tuple[int, float]:
    """Blunders beyond the bound that still act, and how far all of them move a pose."""
    good = truth.blunders == 0
    without, _ = adjust_overall(replace(network, ties=select(network.ties, good)), PARAMS)
    shifts = [
        np.abs(error(stop, other.lsl_from_rover) / np.sqrt(np.diagonal(stop.covariance))).max()
        for stop, other in zip(overall.stops[1:], without.stops[1:], strict=True)
    ]
    return int((shifts_of_tests(network, truth, overall) > DETECTED).sum()), float(max(shifts))


def shifts_of_tests(network: Network, truth: NetworkTruth, overall: AdjustedNetwork) -> np.ndarray:
    """By how much blunders in use shift the tests of their own observations: sqrt(g' Q_vv g)."""
    now = SolvedNetwork.of(overall, network, PARAMS)
    problem = Problem.of(now.observations, now.telemetry, now.held, now.used)
    linear = linearise(problem, LinearisationPoint.of(problem, now.state), None)
    inverse = linear.factor.inverse()
    size = (truth.blunders_px * now.observations.weight)[:, :, None]
    shifts = [np.zeros(0)]
    for tie, places in zip(linear.ties, problem.places, strict=True):
        g = size[tie.group.rows.T]
        C = cofactors(tie, inverse[places]).transpose(3, 2, 0, 1)
        shifts.append((g.mT @ C @ g).ravel())
    return np.sqrt(np.maximum(np.concatenate(shifts), 0.0))


def band(networks: int, level: float = 0.95) -> tuple[float, float]:
    """Where that share of the means of true sigmas lies."""
    tails = [(1 - level) / 2, (1 + level) / 2]
    low, high = chi2.ppf(tails, 6 * networks) / (6 * networks)
    return float(low), float(high)


def line(case: Case, results: Iterable[Found]) -> str:
    """A row of the table."""
    some = list(results)
    means = np.mean([result.nees for result in some], axis=0)
    cost, redundancy = (sum(getattr(r, name) for r in some) for name in ("cost", "redundancy"))
    cells = [f"{case.cross_ties} and {case.far_cross_ties}", f"{case.blunders:.0%}"]
    cells += [f"{mean:.2f}" for mean in (*means, np.mean([r.earlier for r in some]))]
    cells += [f"{np.sqrt(cost / redundancy):.3f}"]
    moved = np.quantile([r.moved for r in some], [0.5, 0.95])
    harm = f"{sum(r.harmful_left for r in some)}; {moved[0]:.2f}, {moved[1]:.2f}"
    return f"| {' | '.join([*cells, harm if case.blunders else '-'])} |"


def main() -> None:
    """Print the table, going on where a file of results ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--networks", type=int, default=200)
    requested = parser.parse_args()
    rows = json.loads(requested.results.read_text()) if requested.results.exists() else {}
    for number, case in enumerate(CASES):
        done = rows.setdefault(str(number), [])
        for seed in range(len(done), requested.networks):
            done.append(asdict(found(case, 100_000 * (number + 1) + seed)))
            requested.results.write_text(json.dumps(rows))
    low, high = band(requested.networks)
    print(f"NEES of {requested.networks} networks each; true sigmas: {low:.2f} to {high:.2f}\n")
    print("| ties | blunders | stepwise | sequential | overall | others | sigma0 | harm |")
    print("| --- " * 8 + "|")
    for number, case in enumerate(CASES):
        print(line(case, [Found(**row) for row in rows[str(number)]]))


if __name__ == "__main__":
    main()
