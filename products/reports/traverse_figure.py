"""The traverse as people read it: map, vertical profile and accumulated differences (SVG)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.traverse.differences import Differences
from solmap.photogrammetry.traverse.records import Traverse
from solmap.products.reports.figures import ADJUSTED_RED, FAINT, INK, TELEMETRY_BLUE, svg

SIGMAS = 3.0
"""Error ellipses are drawn this many standard deviations large."""
MOST_ELLIPSES = 200
"""Of longer traverses only every n-th stop gets one."""
MOST_MARKS = 60
"""Stops of longer traverses are no marks but a line."""


def traverse_figure(
    telemetry: Traverse,
    corrected: Traverse,
    found: Differences,
    plan_covariances: Float64[np.ndarray, "points 2 2"] | None = None,
    form: Callable[[Figure], bytes] = svg,
) -> bytes:
    """Map, profile and differences of two traverses of the same stops, as SVG or PNG.

    Args:
        telemetry: What the rover believed.
        corrected: Where it was.
        found: Their differences.
        plan_covariances: Of (east, north) of the corrected stops, square metres.
        form: `svg` or `png` of `photogrammetry.figures`.
    """
    figure = Figure(figsize=(9.0, 10.0), layout="constrained")
    plan, profile, apart = figure.subplots(3, 1, height_ratios=(3, 1.4, 1.4))
    started = telemetry.starting_at(corrected.places_m[0])
    _plan(plan, started, corrected, plan_covariances)
    _profile(profile, started, corrected, found)
    _apart(apart, found)
    return form(figure)


def _plan(
    axes: Axes, telemetry: Traverse, corrected: Traverse, covariances: np.ndarray | None
) -> None:
    for traverse, colour in ((telemetry, TELEMETRY_BLUE), (corrected, ADJUSTED_RED)):
        marks = "o" if len(traverse) <= MOST_MARKS else ""
        east, north = traverse.places_m[:, 0], traverse.places_m[:, 1]
        label = f"{traverse.solution}, {traverse.length_m:.1f} m"
        axes.plot(east, north, "-", marker=marks, color=colour, lw=1.2, ms=3, label=label)
    if covariances is not None:
        for row in range(0, len(corrected), 1 + len(corrected) // MOST_ELLIPSES):
            axes.add_patch(_ellipse(corrected.places_m[row, :2], covariances[row]))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="east [m]", ylabel="north [m]")
    axes.legend(frameon=False)


def _ellipse(centre: np.ndarray, covariance: np.ndarray) -> Ellipse:
    variances, directions = np.linalg.eigh(covariance)
    minor, major = 2 * SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    angle = np.degrees(np.arctan2(directions[1, 1], directions[0, 1]))
    place = (float(centre[0]), float(centre[1]))
    return Ellipse(place, major, minor, angle=angle, fill=False, ec=ADJUSTED_RED, lw=0.6)


def _profile(axes: Axes, telemetry: Traverse, corrected: Traverse, found: Differences) -> None:
    for traverse, colour in ((telemetry, TELEMETRY_BLUE), (corrected, ADJUSTED_RED)):
        axes.plot(found.distance_m, traverse.places_m[:, 2], "-", color=colour, lw=1.2)
    axes.set(xlabel="distance travelled [m]", ylabel="elevation [m]")
    if not np.isfinite(found.offset_m[:, 2]).any():
        axes.text(0.5, 0.5, "no elevations to compare", color=FAINT, ha="center",
                  transform=axes.transAxes)  # fmt: skip


def _apart(axes: Axes, found: Differences) -> None:
    summary = found.summary()
    axes.plot(found.distance_m, found.horizontal_m, "-", color=INK, lw=1.2, label="in plan")
    if np.isfinite(found.offset_m[:, 2]).any():
        up = found.offset_m[:, 2]
        axes.plot(found.distance_m, up, "--", color=FAINT, lw=1.2, label="in elevation")
    axes.set(
        xlabel="distance travelled [m]",
        ylabel="telemetry off by [m]",
        title=f"at the end {summary.end}; at worst {summary.worst}",
    )
    axes.title.set_fontsize("small")
    axes.legend(frameon=False)
