"""Are sigmas true with control? `python -m tests.support.adjustment.control_statistics`.

Traverses of six stops, 5 pairs and 8 inter-stereo ties a stop, no tie across the third link; an
orbital image (10 m, 0.5 degrees, 0.1 % off) shows five stops to 0.1 m; the first attitude has the
errors that telemetry states. Printed are e' C^-1 e / 6 of all stops but the first and of the last
(1 where the stated covariances are true), and the plan error across the link without ties: by
telemetry alone, and with control.

With `--uncontrolled` traverses of three stops, whose first is the datum, and a mosaic without
stated accuracy: turned by up to 3 degrees, scaled by up to 1 %, shifted by up to 300 m, in which
stops are found as well as in rendered images. Printed are errors without and with it, how often
they are no larger with it, and how often that is so by the covariances: what a perfect adjustment
gains by an observation now and then takes a lucky estimate further from the truth.
"""

# ruff: noqa: T201 - a script that reports what it does
from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.network import MAP
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.modes.sequential import adjust_sequential
from solmap.photogrammetry.synthetic.mission import simulate_control
from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network
from solmap.tasks.mission.control import FrameParams
from tests.unit.adjustment.modes.test_control import GAP, PARAMS, errors, simulated

PLACE_M, AZIMUTH_DEG = 0.045, 0.06
"""Of a stop in an orbital image with cells of 0.25 m, as registration states them."""
DRAWS = 2000


@dataclass(frozen=True)
class InMosaic:
    """What a network's stops but the first are off, without and with a mosaic."""

    plan_m: np.ndarray
    """(2), RMS."""
    azimuth_deg: np.ndarray
    nees: np.ndarray
    """e' C^-1 e / 6, mean."""
    no_larger: np.ndarray
    """(2 stops, 2): whether plan error and azimuth error of each stop are no larger with it."""
    expected: np.ndarray
    """The chance of that by the covariances."""
    first_turned_deg: float
    refused: int


def in_mosaic(
    seed: int,
    turn_deg: float | None = None,
    params: FrameParams | None = None,
    **network_options: int,
) -> InMosaic:
    """A network without and with control in a mosaic that nobody controlled.

    `params`: its stated accuracy; none by default.
    """
    rng = np.random.default_rng(seed)
    options = {"stops": 3, "pairs_per_stop": 8, "cross_ties": 8, "far_cross_ties": 0,
               "inter_ties": 8, "intra_ties": 0, **network_options}  # fmt: skip
    network, truth = simulate_network(rng, errors=TelemetryErrors.assumed_by(PARAMS), **options)
    turn_deg = float(rng.uniform(-3, 3)) if turn_deg is None else turn_deg
    place = [*rng.uniform(-300, 300, 2), 0.0, np.radians(turn_deg), rng.uniform(-0.01, 0.01)]
    drawn = replace(MAP, name="orbit", place=np.array(place))
    stops = range(len(network.stops))
    orbit = simulate_control(
        rng, network, truth, stops, frame=drawn, sigma_m=PLACE_M, sigma_azimuth_deg=AZIMUTH_DEG
    )
    params = params or FrameParams()
    frame = params.frame("orbit", orbit.control)
    places = params.places_in(frame, orbit.control)
    both = network, with_control(network, [frame], places, PARAMS)
    (alone, _), (adjusted_with, report) = (adjust_overall(one, PARAMS) for one in both)
    adjusted = alone, adjusted_with
    e = np.array([errors(one, truth) for one in adjusted])
    nees = [
        np.mean([e[m, k] @ np.linalg.solve(stop.covariance, e[m, k]) / 6
                 for k, stop in enumerate(one.stops) if k])
        for m, one in enumerate(adjusted)
    ]  # fmt: skip
    return InMosaic(
        np.sqrt(np.square(e[:, 1:, 3:5]).sum(axis=2).mean(axis=1)),
        np.degrees(np.sqrt(np.square(e[:, 1:, 2]).mean(axis=1))),
        np.array(nees),
        np.column_stack(
            [np.diff(length(e[:, 1:]), axis=0)[0] <= 0 for length in (_plan, _azimuth)]
        ),
        np.array(
            [
                _chance_of_no_larger(rng, *(one.stops[k].covariance for one in adjusted))
                for k in range(1, len(alone.stops))
            ]
        ),
        float(np.degrees(np.abs(e[1, 0, :3]).max())),
        len(report.control_refused),
    )


def _plan(e: np.ndarray) -> np.ndarray:
    return np.hypot(e[..., 3], e[..., 4])


def _azimuth(e: np.ndarray) -> np.ndarray:
    return np.abs(e[..., 2])


def _chance_of_no_larger(
    rng: np.random.Generator, without: np.ndarray, with_it: np.ndarray
) -> tuple[float, float]:
    """Of plan and azimuth errors, by covariances: the gain does not depend on the other ones."""
    left = rng.multivariate_normal(np.zeros(6), with_it, DRAWS)
    values, axes = np.linalg.eigh(without - with_it)
    gain = rng.normal(size=(DRAWS, 6)) * np.sqrt(np.maximum(values, 0.0)) @ axes.T
    plan, azimuth = (
        float(np.mean(length(left) <= length(left + gain))) for length in (_plan, _azimuth)
    )
    return plan, azimuth


def print_in_mosaics(count: int) -> None:
    """Print what control in uncontrolled mosaics does to some networks."""
    found = [in_mosaic(seed) for seed in range(count)]
    for name in ("plan_m", "azimuth_deg"):
        without, with_it = np.array([getattr(one, name) for one in found]).T
        print(
            f"{name}: median {np.median(without):.3f} without, {np.median(with_it):.3f} with; "
            f"no larger with it in {(with_it <= without).mean():.0%} of the networks"
        )
    shares, expected = (
        np.mean([getattr(one, name) for one in found], axis=(0, 1))
        for name in ("no_larger", "expected")
    )
    print(f"of the stops in {shares[0]:.0%} (plan), {shares[1]:.0%} (azimuth)")
    print(f"by their covariances in {expected[0]:.0%} and {expected[1]:.0%}")
    nees = np.mean([one.nees for one in found], axis=0)
    print(f"e' C^-1 e / 6: {nees[0]:.2f} without, {nees[1]:.2f} with")


def main() -> None:
    """Print the means over some networks."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--networks", type=int, default=60)
    arguments.add_argument("--uncontrolled", action="store_true")
    requested = arguments.parse_args()
    count = requested.networks
    if requested.uncontrolled:
        print_in_mosaics(count)
        return
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
