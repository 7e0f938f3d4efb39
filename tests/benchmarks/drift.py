"""Drift of a long traverse: telemetry, stepwise, sequential and overall adjustment.

    python tests/benchmarks/drift.py table.json docs/figures/drift.svg     (--stops 100 --seeds 3)

Open traverses of 26 m drives over rolling ground, simulated with wheel slip of 1 to 20 % (random,
per drive), gyroscopes that drift by 2 degrees a drive, a sun sighting (1 degree) at every tenth
stop, tilt to 0.3 degrees, mast pointing to 0.1 degrees and image coordinates to 0.3 px. Adjusted
with 7 ties a link, as in the paper's example, or with 20 and 6 more to the stop after the next;
with telemetry of the attitude, or without (standard deviations of 30 degrees).
"""

# ruff: noqa: T201 - a script that reports what it does
from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("svg")
import matplotlib.pyplot as plt

from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.modes.sequential import adjust_sequential
from solmap.photogrammetry.adjustment.modes.stepwise import adjust_stepwise
from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network

SLIPS = (0.01, 0.05, 0.1, 0.2)
TIES = {7: (7, 0), 26: (20, 6)}
MODES = ("telemetry", "stepwise", "sequential", "overall")
LOOSE_DEG = 30.0
RECENT = 10
"""Stops that a step needs at most: the window, and those that share ties with it."""


def params_of(slip, *, attitude):
    """The weights that the adjustment works with."""
    reported = AdjustmentParams(slip=slip)
    if attitude:
        return reported
    return replace(
        reported, tilt_deg=LOOSE_DEG, azimuth_fine_deg=LOOSE_DEG, azimuth_step_deg=LOOSE_DEG
    )


def stepwise(network, params):
    """Centres after every stop was added to those before, which stay."""
    previous = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[max(0, k - RECENT) : k + 1]))
        part = replace(part, stops=network.stops[: k + 1])
        previous, _ = adjust_stepwise(previous, part, [stop], params)
    return previous.stops


def sequential(network, params):
    """All stops as the mission has them: moved no more once they are marginalised."""
    previous = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[max(0, k - RECENT) : k + 1]))
        part = replace(part, stops=network.stops[: k + 1])
        previous, _ = adjust_sequential(previous, part, [stop], params)
    return previous.stops


def centres(stops):
    return np.array([stop.lsl_from_rover.translation_m for stop in stops])


def one(slip, ties, attitude, seed, stops):
    """Errors of one network in each mode: at the end in percent, and from stop to stop."""
    reported = AdjustmentParams(slip=slip)
    cross, far = TIES[ties]
    network, truth = simulate_network(
        np.random.default_rng([seed, round(1000 * slip), ties]), stops=stops, pairs_per_stop=8,
        cross_ties=cross, far_cross_ties=far, inter_ties=20, intra_ties=0, spacing_m=26.0,
        errors=TelemetryErrors.assumed_by(reported), fine_every=10,
    )  # fmt: skip
    params = params_of(slip, attitude=attitude)
    true = np.array([pose.translation_m for pose in truth.lsl_from_rover])
    length = np.linalg.norm(np.diff(true, axis=0), axis=1).sum()
    found = {
        "telemetry": network.stops,
        "stepwise": stepwise(network, params),
        "sequential": sequential(network, params),
        "overall": adjust_overall(network, params)[0].stops,
    }
    errors = {}
    for mode, adjusted in found.items():
        off = centres(adjusted) - true
        errors[mode] = {
            "end_percent": 100 * float(np.linalg.norm(off[-1]) / length),
            "worst_m": float(np.linalg.norm(off, axis=1).max()),
            "step_rms_m": float(np.sqrt((np.diff(off, axis=0) ** 2).sum(axis=1).mean())),
        }
    return {"slip": slip, "ties": ties, "attitude": attitude, "seed": seed,
            "length_m": float(length), "errors": errors}  # fmt: skip


def table(rows):
    """Medians and extremes over the seeds, as Markdown."""
    lines = [
        "| slip | ties a link | attitude | " + " | ".join(MODES) + " | overall, stop to stop |",
        "| --- " * (4 + len(MODES)) + "|",
    ]
    for attitude, ties, slip in product((False, True), TIES, SLIPS):
        some = [r for r in rows if (r["slip"], r["ties"], r["attitude"]) == (slip, ties, attitude)]
        if not some:
            continue
        cells = []
        for mode in MODES:
            v = [r["errors"][mode]["end_percent"] for r in some]
            cells.append(f"{np.median(v):.2f} ({min(v):.2f}-{max(v):.2f})")
        step = np.median([r["errors"]["overall"]["step_rms_m"] for r in some])
        known = "weighted in" if attitude else "none"
        lines.append(
            f"| {slip:.0%} | {ties} | {known} | " + " | ".join(cells) + f" | {step:.2f} m |"
        )
    return "\n".join(lines)


def figure(rows, path):
    """End error over slip, one panel for each number of ties and use of the attitude."""
    panels = list(product((7, 26), (False, True)))
    drawn, axes = plt.subplots(1, 4, figsize=(11, 3.2), sharey=True, layout="constrained")
    looks = {"telemetry": "k:", "stepwise": "C1s--", "sequential": "C0o-", "overall": "C2x-"}
    for axis, (ties, attitude) in zip(axes, panels, strict=True):
        for mode, look in looks.items():
            medians = []
            for slip in SLIPS:
                case = (slip, ties, attitude)
                same = [r for r in rows if (r["slip"], r["ties"], r["attitude"]) == case]
                same = [r["errors"][mode]["end_percent"] for r in same]
                medians.append(np.median(same) if same else np.nan)
            axis.plot(100 * np.array(SLIPS), medians, look, label=mode, markersize=4)
        axis.set(yscale="log", xlabel="slip, %", xticks=[1, 5, 10, 20])
        axis.set_title(f"{ties} ties a link, {'attitude' if attitude else 'no attitude'}", size=9)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("error at the end, % of the way")
    axes[0].set_yticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"], minor=False)
    axes[0].set_yticks([], minor=True)
    axes[0].legend(fontsize=8)
    drawn.savefig(path)


def main():
    """Run what is not in the table yet, then draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", type=Path)
    parser.add_argument("figure", type=Path)
    parser.add_argument("--stops", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=3)
    requested = parser.parse_args()
    rows = json.loads(requested.table.read_text()) if requested.table.exists() else []
    done = {(r["slip"], r["ties"], r["attitude"], r["seed"]) for r in rows}
    for seed, attitude, ties, slip in product(range(requested.seeds), (True, False), TIES, SLIPS):
        if (slip, ties, attitude, seed) in done:
            continue
        begun = time.process_time()
        rows.append(one(slip, ties, attitude, seed, requested.stops))
        requested.table.write_text(json.dumps(rows))
        ends = {mode: round(e["end_percent"], 3) for mode, e in rows[-1]["errors"].items()}
        print(f"{slip:.0%} {ties} {attitude} {seed}: {ends} {time.process_time() - begun:.0f} s",
              flush=True)  # fmt: skip
    print(table(rows))
    figure(rows, requested.figure)


if __name__ == "__main__":
    main()
