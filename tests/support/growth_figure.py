"""A figure of the results of `mission_growth`: does a late stop cost more than an early one?

`python -m tests.support.growth_figure walk.jsonl docs/figures/growth.png` draws it and prints a
table.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

PARTS = {
    "gather": "labels, telemetry, window",
    "match": "matches and ties looked up",
    "adjust": "network adjusted and kept",
    "orient": "orientations chosen",
    "publish": "published",
}
AT_ONCE = 15
"""Sols that a median is taken over."""


def figures_of(path: Path) -> list[dict[str, float]]:
    """What was measured, a record a sol."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def columns(rows: list[dict[str, float]], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Sols and figures of one name, of the sols that have it."""
    found = [(row["sol"], row[name]) for row in rows if name in row]
    sols, figures = np.array(found, dtype=float).reshape(-1, 2).T
    return sols, figures


def medians(sols: np.ndarray, figures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians of this many sols each."""
    count = max(len(sols) // AT_ONCE, 1)
    groups = zip(np.array_split(sols, count), np.array_split(figures, count), strict=True)
    return np.array([(np.median(at), np.median(of)) for at, of in groups]).T


def image(rows: list[dict[str, float]]) -> Figure:
    """Seconds, memory and documents by sol."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    seconds, memory, sizes = figure.subplots(3, 1, sharex=True)
    alone = [row for row in rows if not row["report_s"]]
    below = 0.0
    for part, title in PARTS.items():
        sols, spent = medians(*columns(alone, f"{part}_cpu_s"))
        seconds.fill_between(sols, below, below + spent, label=title, alpha=0.8)
        below = below + spent
    seconds.set(ylabel="processor, s a sol", ylim=(0, None))
    seconds.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8, ncols=3)
    peak = [row for row in alone if "sol_peak_mb" in row]
    memory.plot(*columns(peak, "sol_peak_mb"), ".", label="the most that a sol took")
    memory.plot(*columns(peak, "resident_mb"), "-", label="process before the sol")
    memory.set(ylabel="memory, MB", ylim=(0, None))
    memory.legend(fontsize=8)
    for kind in ("network", "orientations"):
        sizes.plot(*columns(rows, f"{kind}_kb"), label=f"{kind} of the sol")
    sizes.set(ylabel="document, kB", xlabel="sol, a stop each", ylim=(0, None))
    sizes.legend(fontsize=8)
    for axes in (seconds, memory, sizes):
        axes.grid(alpha=0.3)
    return figure


def main() -> None:
    """Draw the figure, and print the medians of the first and last sols."""
    rows = figures_of(Path(sys.argv[1]))
    figure = image(rows)
    FigureCanvasAgg(figure)
    figure.savefig(sys.argv[2], dpi=110)
    alone = [row for row in rows if not row["report_s"]]
    for name in (*(f"{part}_cpu_s" for part in PARTS), "sol_cpu_s", "network_kb"):
        sols, found = columns(alone, name)
        shown = [f"sol {at:.0f}: {of:.3f}" for at, of in np.transpose(medians(sols, found))]
        sys.stdout.write(f"{name}: {', '.join(shown)}\n")


if __name__ == "__main__":
    main()
