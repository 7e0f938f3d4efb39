"""Errors along a mission of 500 stops and 7 km: telemetry, images, images and orbital control.

    python -m tests.benchmarks.mission_errors table.json docs/figures/mission.svg  (--seeds 5)

Missions are those of `photogrammetry.synthetic.mission`: slip of 1 to 20 % by terrain, a sun
sighting (1 degree) at every tenth stop, 20 ties with the next stop and 6 with the one after, with
and without ten gaps of two drives. The adjustment has no information on the slips: it weights
telemetry with 10 % as ever. With control, every tenth stop and those at gaps are found to 0.25 m in
an orbital image; this is either the map itself, or it lies 10 m, 0.5 degrees and 0.1 % off (one
standard deviation each) and is placed by the adjustment; errors are then those in the image, where
users see the stops. Without control at gaps a stop inside depends on wheel counts.
"""

# ruff: noqa: T201 - a script that reports what it does
from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.network import MAP
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.synthetic.mission import GAP_DRIVES, MissionPlan, simulate_mission
from tests.benchmarks.drift import centres, stepwise

PLAN = MissionPlan(pairs_per_stop=8, inter_ties=20, intra_ties=0)
PARAMS = AdjustmentParams()
AT_GAPS_TOO_FEW = "control, none at gaps but every tenth"
LOOKS = {
    "telemetry": ("k", ":"),
    "stepwise": ("C1", "--"),
    "overall": ("C2", "-"),
    AT_GAPS_TOO_FEW: ("C4", ":"),
    "control in an image to be placed": ("C0", "--"),
    "control in the map": ("C3", "-"),
}
GOAL_M = 1.0
DRAWN_EVERY = 3


def in_image(places, frame, place):
    """East and north of places (north, east, down) as an image that lies at `place` shows them."""
    centre, (b, a) = np.array(frame.centre_m), place[3:5]
    similarity = np.array([[1 + a, -b], [b, 1 + a]])
    off = places[:, [1, 0]] - centre - place[:2]
    return centre + np.linalg.solve(similarity, off.T).T


def with_image(mission, frame, every=1):
    """Errors of stops in an orbital image, metres, and the outcome of its control."""
    control, number = mission.control, {stop: k for k, stop in enumerate(mission.network.stop_ids)}
    shown = [some for some in control.control if number[some.stop] % every == 0]
    network = with_control(mission.network, (frame,), shown, PARAMS)
    adjusted, report = adjust_overall(network, PARAMS)
    true = np.array([pose.translation_m for pose in mission.truth.lsl_from_rover])
    placed = {one.frame.name: one.place for one in adjusted.frames}
    found = in_image(centres(adjusted.stops), frame, placed[frame.name])
    off = found - in_image(true, frame, control.place)
    return np.linalg.norm(off, axis=1), report


def one(seed, plan):
    """Errors of one mission at every stop, by mode, metres in plan."""
    errors, used = {}, {}
    frames = {
        AT_GAPS_TOO_FEW: (MAP, plan.control_every),
        "control in the map": (MAP, 1),
        "control in an image to be placed": (None, 1),
    }
    for mode, (frame, every) in frames.items():
        mission = simulate_mission(np.random.default_rng([seed, plan.gaps]), plan, frame)
        errors[mode], report = with_image(mission, mission.control.frame, every)
        used[mode] = {"refused": list(report.control_refused), "sigma0": report.sigma0}
    true = np.array([pose.translation_m for pose in mission.truth.lsl_from_rover])
    found = {
        "telemetry": mission.network.stops,
        "stepwise": stepwise(mission.network, PARAMS),
        "overall": adjust_overall(mission.network, PARAMS)[0].stops,
    }
    for mode, stops in found.items():
        errors[mode] = np.linalg.norm((centres(stops) - true)[:, :2], axis=1)
    return {
        "seed": seed,
        "gaps": plan.gaps,
        "along_m": mission.along_m.tolist(),
        "untied": sorted(mission.untied),
        "errors_m": {mode: errors[mode].tolist() for mode in LOOKS},
        "control": used,
    }


def table(rows):
    """Medians and extremes over the seeds, as Markdown."""
    lines = [
        "| | gaps | at the end, % of the way | at the end | worst stop | stops off by over 1 m |",
        "| --- " * 6 + "|",
    ]
    for mode, gaps in product(LOOKS, sorted({row["gaps"] for row in rows})):
        if mode == AT_GAPS_TOO_FEW and not gaps:
            continue  # there is no difference
        some = [np.array(row["errors_m"][mode]) for row in rows if row["gaps"] == gaps]
        way = np.mean([row["along_m"][-1] for row in rows])
        end, worst = [e[-1] for e in some], [e.max() for e in some]
        over = 100 * np.mean([(e > GOAL_M).mean() for e in some])
        percent = [100 * e / way for e in end]
        cells = [f"{spread(percent, 3)}", f"{spread(end, 2)} m", f"{spread(worst, 2)} m"]
        lines.append(f"| {mode} | {gaps or 'none'} | " + " | ".join(cells) + f" | {over:.1f} % |")
    return "\n".join(lines)


def spread(values, digits):
    """Median and extremes."""
    low, middle, high = np.percentile(values, [0, 50, 100])
    return f"{middle:.{digits}f} ({low:.{digits}f}-{high:.{digits}f})"


def figure(rows, path):
    """Error over the way, median and extremes of the seeds; one panel without gaps and one with."""
    kinds = sorted({row["gaps"] for row in rows})
    drawn, axes = plt.subplots(
        1, len(kinds), figsize=(10, 3.8), sharey=True, layout="constrained", squeeze=False
    )
    for axis, gaps in zip(axes[0], kinds, strict=True):
        some = [row for row in rows if row["gaps"] == gaps]
        drawn_at = slice(None, None, DRAWN_EVERY)
        way = np.array(some[0]["along_m"])[drawn_at] / 1000
        for mode, (colour, style) in LOOKS.items():
            if mode == AT_GAPS_TOO_FEW and not gaps:
                continue
            errors = np.array([row["errors_m"][mode] for row in some])[:, drawn_at]
            axis.fill_between(way, errors.min(0), errors.max(0), color=colour, alpha=0.12, lw=0)
            axis.plot(way, np.median(errors, axis=0), style, color=colour, label=mode, lw=1.2)
        axis.axhline(GOAL_M, color="grey", lw=0.6)
        axis.set(yscale="log", xlabel="way, km", ylim=(0.02, 1000), xlim=(0, way[-1]))
        axis.set_title(f"{gaps} gaps of {GAP_DRIVES} drives" if gaps else "no gaps", size=9)
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("error of a stop in plan, m")
    drawn.legend(*axes[0, -1].get_legend_handles_labels(), fontsize=7, ncols=3,
                 loc="outside lower center")  # fmt: skip
    drawn.savefig(path)


def main():
    """Run what is not in the table yet, then draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", type=Path)
    parser.add_argument("figure", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--stops", type=int, default=PLAN.stops)
    requested = parser.parse_args()
    plan = replace(
        PLAN, stops=requested.stops, distance_m=PLAN.distance_m * requested.stops / PLAN.stops
    )
    rows = json.loads(requested.table.read_text()) if requested.table.exists() else []
    done = {(row["seed"], row["gaps"]) for row in rows}
    for seed, gaps in product(range(requested.seeds), (0, plan.gaps)):
        if (seed, gaps) in done:
            continue
        begun = time.process_time()
        rows.append(one(seed, replace(plan, gaps=gaps)))
        requested.table.write_text(json.dumps(rows))
        worst = {mode: round(max(e), 2) for mode, e in rows[-1]["errors_m"].items()}
        print(f"{seed} {gaps}: worst {worst} m, {rows[-1]['control']}, "
              f"{time.process_time() - begun:.0f} s", flush=True)  # fmt: skip
    print(table(rows))
    figure(rows, requested.figure)


if __name__ == "__main__":
    main()
