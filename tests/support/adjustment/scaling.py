"""How the overall adjustment grows with the traverse.

`python -m tests.support.adjustment.scaling docs/figures/adjustment_scaling.png` draws it.
Networks of 10 to 2,000 stops, ten stereo pairs and about 306 ties each, with mast pointings and
telemetry. The start is the truth, as far from the minimum as the noise is large; the time is
processor time of layout and iteration, and of all covariances besides (linearised again), the
fastest of three runs, since other work shares the caches.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from solmap.photogrammetry.adjustment.model.collinearity import Observations, State
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.solver.gauss_newton import solve
from solmap.photogrammetry.adjustment.solver.normal_equations import LinearisationPoint, linearise
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.synthetic.networks import simulate_network
from tests.support.adjustment.problems import PARAMS

STOPS = (10, 50, 200, 500, 1000, 2000)
REPEATS = 3


def measured(stops):
    """Seconds of processor time and megabytes for one network."""
    network, truth = simulate_network(
        np.random.default_rng(stops), stops=stops, inter_ties=100, intra_ties=180
    )
    observations, telemetry = Observations.of(network), Telemetry.of(network, PARAMS)
    start = State(
        np.array([pose.rotation for pose in truth.lsl_from_rover]),
        np.array([pose.translation_m for pose in truth.lsl_from_rover]),
        truth.pointings,
        truth.points,
    )
    runs = [timed(observations, telemetry, start) for _ in range(REPEATS)]
    return {
        "stops": stops,
        "images": 2 * len(network.pairs),
        "ties": observations.points,
        **min(runs, key=lambda run: run["layout_s"] + run["iteration_s"]),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def timed(observations, telemetry, start):
    """One run."""
    used, held = np.ones(len(observations), dtype=bool), np.arange(len(start.centres)) == 0
    times = [time.process_time()]
    problem = Problem.of(observations, telemetry, held, used)
    times.append(time.process_time())
    solution = solve(problem, start, PARAMS, robust=False)
    times.append(time.process_time())
    linearise(problem, LinearisationPoint.of(problem, solution.state), None).factor.inverse()
    times.append(time.process_time())
    layout, iteration, covariance = np.diff(times).tolist()
    return {
        "iterations": solution.iterations,
        "converged": solution.converged,
        "layout_s": layout,
        "iteration_s": iteration,
        "covariances_s": covariance,
    }


def drawn(rows, path):
    """The figure: time against stops, both logarithmic, with lines of slope one."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    stops = np.array([row["stops"] for row in rows])
    adjust = np.array([row["layout_s"] + row["iteration_s"] for row in rows])
    covariances = np.array([row["covariances_s"] for row in rows])
    for seconds, label in ((adjust, "adjustment"), (covariances, "all covariances")):
        (line,) = axes.loglog(stops, seconds, "o-", label=label)
        per_stop = seconds[-1] / stops[-1]
        axes.loglog(stops, per_stop * stops, ":", color=line.get_color(), lw=1)
    axes.set_xlabel("stops (20 images and 306 ties each)")
    axes.set_ylabel("processor seconds")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend(title="dotted: proportional to stops")
    figure.savefig(path, dpi=120)


def main(figure):
    rows = []
    for stops in STOPS:
        rows.append(measured(stops))
        sys.stdout.write(json.dumps(rows[-1]) + "\n")
        sys.stdout.flush()
        drawn(rows, figure)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
