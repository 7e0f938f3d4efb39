"""Are sigmas true with control? `python -m tests.support.adjustment.control_statistics`.

Traverses of six stops, 5 pairs and 8 inter-stereo ties a stop, no tie across the third link; an
orbital image (10 m, 0.5 degrees, 0.1 % off) shows five stops to 0.1 m; the first attitude is as
wrong as telemetry says. Printed are e' C^-1 e / 6 of all stops but the first and of the last (1
where the stated covariances are true), and the plan error across the link without ties: by
telemetry alone, and with control.
"""

# ruff: noqa: T201 - a script that reports what it does
from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from solmap.photogrammetry.adjustment.model.network import MAP
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.modes.sequential import adjust_sequential
from tests.unit.adjustment.modes.test_control import GAP, PARAMS, errors, simulated


def main() -> None:
    """Print the means over some networks."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--networks", type=int, default=60)
    count = arguments.parse_args().networks
    everywhere, last, off = np.zeros((count, 2)), np.zeros((count, 2)), np.zeros((count, 2))
    for seed in range(count):
        network, truth, _ = simulated(500 + seed, stops=6, shown=(0, 1, 3, 4, 5), gap=GAP)
        overall, _ = adjust_overall(network, PARAMS)
        step = None
        for k, stop in enumerate(network.stop_ids):
            part = network.within(set(network.stop_ids[: k + 1]))
            step, _ = adjust_sequential(step, part, [stop], PARAMS)
        bare = replace(network, control=network.control[:1], frames=(MAP,))
        without, _ = adjust_overall(bare, PARAMS)
        for m, adjusted in enumerate((overall, step)):
            e = errors(adjusted, truth)
            each = [
                e[k] @ np.linalg.solve(stop.covariance, e[k]) / 6
                for k, stop in enumerate(adjusted.stops)
                if k
            ]
            everywhere[seed, m], last[seed, m] = np.mean(each), each[-1]
        ends = [errors(one, truth) for one in (without, overall)]
        off[seed] = [np.hypot(*(e[GAP, 3:5] - e[GAP - 1, 3:5])) for e in ends]
    low, high = (chi2.ppf(q, 6 * count) / (6 * count) for q in (0.025, 0.975))
    print(f"{count} networks; true means of the last stop lie in {low:.2f} to {high:.2f} (95 %)")
    print(f"overall: all stops {everywhere[:, 0].mean():.2f}, the last {last[:, 0].mean():.2f}")
    print(f"sequential: all stops {everywhere[:, 1].mean():.2f}, the last {last[:, 1].mean():.2f}")
    median = np.median(off, axis=0)
    print(
        f"error across the gap, median: {median[0]:.2f} m without, {median[1]:.2f} m with control"
    )


if __name__ == "__main__":
    main()
