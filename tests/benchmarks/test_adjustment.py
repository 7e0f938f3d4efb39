"""How long an adjustment takes, and next to SciPy's general solver on the same network.

Start: telemetry (cold), so the alignment, the search for blunders and all covariances are inside.
"""

import importlib
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

from solmap.photogrammetry.adjustment.initial.values import initialise
from solmap.photogrammetry.adjustment.model.collinearity import (
    Observations,
    State,
    misclosures,
)
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry, telemetry_misclosures
from solmap.photogrammetry.adjustment.modes.overall import _known_state, adjust_overall
from solmap.photogrammetry.adjustment.modes.stepwise import adjust_stepwise
from solmap.photogrammetry.adjustment.solver.gauss_newton import solve
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network
from tests.support.adjustment import bal, problems

PARAMS = AdjustmentParams()


def network_of(stops):
    """About 300 ties a stop, as the paper counts them."""
    return simulate_network(
        np.random.default_rng(stops), stops=stops, inter_ties=100, intra_ties=180
    )[0]


@pytest.mark.parametrize("stops", [2, 10, 50])
def test_adjusting_a_traverse_from_telemetry(benchmark, stops):
    network = network_of(stops)
    _, report = benchmark.pedantic(adjust_overall, (network, PARAMS), rounds=3)
    assert report.is_usable
    benchmark.extra_info["report"] = str(report)


def test_adding_a_stop_to_a_traverse_of_ten(benchmark):
    network = network_of(11)
    old = network.within(set(network.stop_ids[:10]))
    previous, _ = adjust_overall(old, PARAMS)
    _, report = benchmark.pedantic(
        adjust_stepwise, (previous, network, network.stop_ids[10:], PARAMS), rounds=3
    )
    assert report.is_usable


def test_the_example_of_the_paper(benchmark):
    """Two stops, 40 images, 7 cross-site, 99 inter- and 218 intra-stereo ties; 30 s in 2007."""
    network, _ = simulate_network(
        np.random.default_rng(38), stops=2, cross_ties=7, far_cross_ties=0, inter_ties=50,
        intra_ties=109, spacing_m=38.0,
    )  # fmt: skip
    problem, start = started(network)
    used = np.ones(len(problem.observations), dtype=bool)

    def adjusted():
        laid_out = Problem.of(problem.observations, problem.telemetry, problem.held, used)
        return solve(laid_out, start, PARAMS, robust=False)

    assert benchmark(adjusted).converged


@pytest.mark.parametrize("stops", [10, 50, 500])
def test_a_whole_mission_next_to_ceres(benchmark, stops):
    """Overall adjustment from near the minimum, as it starts after a sequential one.

    The same rigid rigs, ties, start and sum of squares; Ceres is not given the ties of single
    pairs, of which no pose depends. Processor time of both, in one run: ours with its layout, of
    Ceres the minimiser alone, with the settings under which it converges soonest.
    """
    peer = peer_or_skip("ceres_peer", "pycolmap", "pyceres")
    network = simulate_network(
        np.random.default_rng(stops), stops=stops, inter_ties=100, intra_ties=180,
        errors=TelemetryErrors(pointing_deg=0.0),
    )[0]  # fmt: skip
    problem = problems.warm(problems.simulated(network), np.random.default_rng(1))
    mine = benchmark.pedantic(problems.ours, (problem,), rounds=3)
    begin = time.process_time()
    problems.ours(problem)
    seconds = time.process_time() - begin
    theirs = peer.adjusted(problem)
    benchmark.extra_info["ratio of processor time"] = theirs.seconds / seconds
    benchmark.extra_info["ceres"] = theirs.report
    print(f"{stops} stops: {seconds:.3f} s against {theirs.seconds:.2f} s")  # noqa: T201
    print(f"{theirs.report}; relative {theirs.cost / mine.cost - 1:.1e}")  # noqa: T201
    assert mine.converged
    assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)


def test_the_whole_model_of_fifty_stops_next_to_gtsam(benchmark):
    """Mast pointings and telemetry too, from near the minimum; ours with its layout."""
    peer = peer_or_skip("gtsam_full", "gtsam")
    network = simulate_network(
        np.random.default_rng(10), stops=50, inter_ties=100, intra_ties=0
    )[0]  # fmt: skip
    problem = problems.warm(problems.aligned(network), np.random.default_rng(1))
    mine = benchmark.pedantic(problems.ours, (problem,), rounds=3)
    begin = time.process_time()
    problems.ours(problem)
    seconds = time.process_time() - begin
    theirs = peer.adjusted(problem)
    print(f"{seconds:.3f} s against {theirs.seconds:.2f} s, {theirs.report}")  # noqa: T201
    assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)


def test_a_problem_of_bal_next_to_ceres(benchmark):
    """The file that SOLMAP_BAL names, all nine unknowns of every camera free."""
    peer = peer_or_skip("ceres_peer", "pycolmap", "pyceres")
    if "SOLMAP_BAL" not in os.environ:
        pytest.skip("no file named: SOLMAP_BAL=problem-49-7776-pre.txt make bench")
    problem = bal.read_bal(Path(os.environ["SOLMAP_BAL"]))
    mine = benchmark.pedantic(bal.ours, (problem,), rounds=1)
    theirs = peer.adjusted_with_lenses(problem)
    print(f"{mine} against {theirs}")  # noqa: T201
    assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)


def test_covariances_of_fifty_stops_next_to_gtsam(benchmark):
    """All pose covariances at the minimum, linearisation and factor included on both sides."""
    peer = peer_or_skip("gtsam_peer", "gtsam")
    network = simulate_network(
        np.random.default_rng(50), stops=50, inter_ties=100, intra_ties=0,
        errors=TelemetryErrors(pointing_deg=0.0),
    )[0]  # fmt: skip
    problem = problems.simulated(network)
    state = problems.ours(problem).state
    mine = benchmark.pedantic(problems.covariances, (problem, state), rounds=3)
    theirs, seconds = peer.covariances(problem, state)
    benchmark.extra_info["ratio"] = seconds / benchmark.stats.stats.min
    sigma = np.sqrt(np.diagonal(theirs[1:], axis1=1, axis2=2))
    scale = sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose(mine[1:] / scale, theirs[1:] / scale, atol=1e-6)


def peer_or_skip(module, *packages):
    """A module that needs packages beyond the lock; `make peers` installs them."""
    for package in packages:
        pytest.importorskip(package, reason=f"{package} is not installed: make peers")
    return importlib.import_module(f"tests.support.adjustment.{module}")


def general_solver(problem, start):
    """SciPy's trust region on the same residuals, with the sparsity given and 2-point slopes."""
    observations, telemetry = problem.observations, problem.telemetry
    stops, pairs = len(start.centres), len(start.pointings)
    numbers = np.sort(problem.points)
    free = np.flatnonzero(~problem.held)

    def state_of(x):
        pose, rest = x[: 6 * len(free)].reshape(-1, 6), x[6 * len(free) :]
        turns, centres = np.zeros((stops, 3)), start.centres.copy()
        turns[free], centres[free] = pose[:, :3], start.centres[free] + pose[:, 3:]
        points = start.points.copy()
        points[numbers] = start.points[numbers] + rest[3 * pairs :].reshape(-1, 3)
        return State(
            rotation_of_vector(turns) @ start.rotations, centres,
            start.pointings + rest[: 3 * pairs].reshape(-1, 3), points,
        )  # fmt: skip

    def residuals(x):
        state = state_of(x)
        image = misclosures(state, observations, problem.rows) * observations.weight[problem.rows]
        reported = telemetry_misclosures(state, telemetry) * problem.link_weight
        pointing = state.pointings * telemetry.pointing_weight
        return np.concatenate(
            [np.nan_to_num(v, nan=1e6).ravel() for v in (image, reported, pointing)]
        )

    size = 6 * len(free) + 3 * pairs + 3 * len(numbers)
    found = least_squares(
        residuals, np.zeros(size), jac_sparsity=pattern_of(problem, free, numbers), x_scale="jac",
        max_nfev=100,
    )  # fmt: skip
    return 2 * found.cost, found.nfev


def pattern_of(problem, free, numbers):
    """Which residual depends on which unknown."""

    observations = problem.observations
    stops, pairs = len(problem.held), len(observations.pair_stop)
    place = {int(s): 6 * k for k, s in enumerate(free)}
    point = {int(p): 6 * len(free) + 3 * pairs + 3 * k for k, p in enumerate(numbers)}
    n = len(problem.rows)
    sparsity = lil_matrix(
        (3 * n + 6 * stops + 3 * pairs, 6 * len(free) + 3 * pairs + 3 * len(numbers)), dtype=int
    )
    for i, row in enumerate(problem.rows.tolist()):
        columns = [point[int(observations.point[row])]]
        pair = 6 * len(free) + 3 * int(observations.pair[row])
        sparsity[3 * i : 3 * i + 3, pair : pair + 3] = 1
        sparsity[3 * i : 3 * i + 3, columns[0] : columns[0] + 3] = 1
        stop = int(observations.stop[row])
        if stop in place:
            sparsity[3 * i : 3 * i + 3, place[stop] : place[stop] + 6] = 1
    for k in range(stops):
        for stop in (k - 1, k):
            if stop in place:
                rows = slice(3 * n + 6 * k, 3 * n + 6 * k + 6)
                sparsity[rows, place[stop] : place[stop] + 6] = 1
    for k in range(3 * pairs):
        sparsity[3 * n + 6 * stops + k, 6 * len(free) + k] = 1
    return sparsity


@pytest.mark.parametrize("stops", [2, 5])
def test_adjustment_and_general_solver_from_the_same_start(benchmark, stops):
    """Same residuals, same start (the alignment), same minimum; the ratio is of wall time."""
    network = simulate_network(
        np.random.default_rng(stops), stops=stops, inter_ties=20, intra_ties=0
    )[0]
    problem, start = started(network)
    ours = benchmark.pedantic(
        solve, (problem, start, PARAMS), {"robust": False}, rounds=3, warmup_rounds=1
    )
    begin = time.perf_counter()
    cost, evaluations = general_solver(problem, start)
    seconds = time.perf_counter() - begin
    benchmark.extra_info["ratio"] = seconds / benchmark.stats.stats.min
    benchmark.extra_info["evaluations"] = evaluations
    print(f"{stops} stops: {benchmark.stats.stats.min:.4f} s against {seconds:.2f} s")  # noqa: T201
    assert ours.converged
    assert ours.cost <= cost * (1 + 1e-6)


def started(network):
    """The problem without a search for blunders, at the alignment."""
    observations, telemetry = Observations.of(network), Telemetry.of(network, PARAMS)
    telemetry = replace(telemetry, mast=np.zeros((0, 3, 0)))  # peers have no systematic errors
    held = np.arange(len(network.stops)) == 0
    known, is_known = _known_state(network, telemetry, observations, None)
    state, *_ = initialise(observations, telemetry, held, PARAMS, known, is_known)
    used = np.isfinite(misclosures(state, observations, np.arange(len(observations)))).all(axis=1)
    return Problem.of(observations, telemetry, held, used), state
