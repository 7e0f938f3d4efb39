"""Figures of networks and traverses (matplotlib), which show what means hide.

All are SVG or PNG without dates, so equal input gives equal bytes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, PathPatch
from matplotlib.path import Path

from solmap.photogrammetry.adjustment.model.adjusted_network import USED, AdjustedNetwork
from solmap.photogrammetry.adjustment.quality.network_quality import image_size_px, tied_rows
from solmap.photogrammetry.adjustment.quality.records import (
    CameraResiduals,
    PairCamera,
    Quality,
)
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId, TieKind
from solmap.photogrammetry.traverse.differences import Differences
from solmap.photogrammetry.traverse.records import Traverse

INK, FAINT = "#222222", "#9a9a9a"
TELEMETRY_BLUE, ADJUSTED_RED = "#1769e0", "#e02d25"
"""The paper's colours of both traverses (its figure 7), also used by the viewer."""

# names of clip paths: derived from this instead of random numbers
mpl.rcParams["svg.hashsalt"] = "solmap"


def png(figure: Figure) -> bytes:
    """The figure as PNG, 150 dots per inch, without upper and right frame edges."""
    _without_frames(figure)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_figure(buffer, format="png", dpi=150, metadata={"Software": None})
    return buffer.getvalue()


def _without_frames(figure: Figure) -> None:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)


def svg(figure: Figure) -> bytes:
    """The figure as SVG, without dates and without upper and right frame edges."""
    _without_frames(figure)
    buffer = io.BytesIO()
    FigureCanvasSVG(figure).print_figure(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


SIGMAS = 3.0
"""Size of error ellipses in standard deviations."""
MOST_ELLIPSES = 200
"""Stops beyond which only every n-th gets an ellipse."""
MOST_MARKS = 60
"""Stops beyond which they are drawn as a line without marks."""


def traverse_figure(
    telemetry: Traverse,
    corrected: Traverse,
    found: Differences,
    plan_covariances: Float64[np.ndarray, "points 2 2"] | None = None,
    form: Callable[[Figure], bytes] = svg,
    title: str = "",
) -> bytes:
    """Map, profile and differences of two traverses of the same stops, as SVG or PNG.

    Args:
        telemetry: By telemetry.
        corrected: As adjusted or localised.
        found: Their differences.
        plan_covariances: Of (east, north) of the corrected stops, square metres.
        form: `svg` or `png` of `photogrammetry.figures`.
        title: Above all of it.
    """
    figure = Figure(figsize=(9.0, 10.0), layout="constrained")
    if title:
        figure.suptitle(title)
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
        ylabel="telemetry minus corrected [m]",
        title=f"at the end {summary.end}; at worst {summary.worst}",
    )
    axes.title.set_fontsize("small")
    axes.legend(frameon=False)


T = TypeVar("T")

WARM, COOL = "#b5442a", "#2a6f97"
LONGEST = 4.0
"""Residual vectors are truncated at this multiple of the third quartile of their lengths."""
MOST_VECTORS = 1500
"""Most residual vectors in a plot: more would overlap."""


def network_figure(
    network: AdjustedNetwork, telemetry: Mapping[StopId, Pose], quality: Quality
) -> bytes:
    """The traverse by telemetry and as adjusted, its links and the stops' error ellipses."""
    figure, axes = _figure(7.0, 6.0)
    places = {s.stop: s.lsl_from_rover.translation_m for s in network.stops}
    reported = np.array([telemetry[s.stop].translation_m for s in network.stops])
    adjusted = np.array(list(places.values()))
    _draw_links(axes, places, quality)
    axes.plot(reported[:, 1], reported[:, 0], "--", color=FAINT, lw=1, label="telemetry")
    axes.plot(adjusted[:, 1], adjusted[:, 0], "-", color=INK, lw=1, label="adjusted")
    held = np.array([stop.held for stop in network.stops], dtype=bool)
    axes.plot(adjusted[held, 1], adjusted[held, 0], "s", color=INK, ms=5, label="held")
    scale = ellipse_scale(adjusted, quality)
    for stop in quality.stops:
        north, east, _ = places[stop.stop]
        width, height = (2 * scale * axis for axis in stop.ellipse_m)
        angle = 90.0 - stop.ellipse_azimuth_deg
        shape = Ellipse((east, north), width, height, angle=angle, fc="none", ec=WARM, lw=1)
        axes.add_patch(shape)
    axes.plot([], [], color=WARM, label=f"1-sigma ellipse, {scale:g} x")
    for stop in _some(quality.stops, 12):
        north, east, _ = places[stop.stop]
        axes.annotate(_short(stop.stop), (east, north), xytext=(5, 5), textcoords="offset points",
                      fontsize=7, color=INK)  # fmt: skip
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    axes.margins(0.12)
    axes.legend(frameon=False, fontsize=8)
    return svg(figure)


def ellipse_scale(places: np.ndarray, quality: Quality) -> float:
    """Round factor that enlarges ellipses: the largest to a tenth of the traverse."""
    largest = max((stop.ellipse_m[0] for stop in quality.stops), default=0.0)
    extent = float(np.ptp(places[:, :2], axis=0).max(initial=0.0)) or 10.0
    if not largest > 0:
        return 1.0
    digits = 10.0 ** np.floor(np.log10(0.1 * extent / largest))
    return float(max(1.0, digits * np.floor(0.1 * extent / largest / digits)))


def growth_figure(quality: Quality) -> bytes:
    """Standard deviations of the stops along the traverse."""
    figure, axes = _figure(7.0, 2.8)
    way = [stop.driven_m for stop in quality.stops]
    axes.plot(way, [s.ellipse_m[0] for s in quality.stops], "o-", color=WARM, ms=3, lw=1,
              label="major axis on the map")  # fmt: skip
    axes.plot(way, [s.ellipse_m[1] for s in quality.stops], "o-", color=COOL, ms=3, lw=1,
              label="minor axis")  # fmt: skip
    axes.plot(way, [s.sigma_down_m for s in quality.stops], "o-", color=FAINT, ms=3, lw=1,
              label="down")  # fmt: skip
    axes.set(xlabel="driven, m", ylabel="standard deviation, m")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)
    return svg(figure)


def residual_figure(
    network: AdjustedNetwork, cameras: Mapping[str, PairCamera], found: CameraResiduals
) -> bytes:
    """Residual vectors in the image plane of a camera, and their means by cell."""
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    size = image_size_px(cameras, found.instrument)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    _draw_vectors(left, network, tied_rows(network.ties, cameras, found.instrument), size)
    _draw_means(figure, right, found, size)
    for axes in (left, right):
        axes.set(xlim=(0, size), ylim=(size, 0), aspect="equal", xlabel="sample, px")
    left.set_ylabel("line, px")
    return svg(figure)


def statistics_figure(network: AdjustedNetwork) -> bytes:
    """Standardised residuals against the normal distribution, and the redundancy numbers."""
    figure = Figure(figsize=(9.0, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    ties = network.ties
    used = ties.status == USED
    w = ties.standardised[used]
    w = w[np.isfinite(w)]
    edges = np.linspace(-5, 5, 51)
    if len(w):
        left.hist(np.clip(w, -5, 5), edges, density=True, color=COOL, alpha=0.7)
    left.plot(edges, np.exp(-(edges**2) / 2) / np.sqrt(2 * np.pi), color=INK, lw=1)
    left.set(xlabel="standardised residual (line: normal)", ylabel="density")
    kinds = np.array([str(kind) for kind in ties.kinds], dtype=str)[ties.observations.point]
    for kind, colour in ((TieKind.INTER_STEREO, COOL), (TieKind.CROSS_SITE, WARM)):
        rows = used & (kinds == str(kind))
        numbers = ties.redundancy[rows][np.isfinite(ties.residuals_px[rows])]
        if len(numbers):
            right.hist(numbers, np.linspace(0, 1, 41), density=True, histtype="step",
                       color=colour, label=str(kind))  # fmt: skip
            right.legend(frameon=False, fontsize=8)
    right.set(xlabel="redundancy number", ylabel="density")
    return svg(figure)


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def _draw_links(axes: Axes, places: Mapping[StopId, np.ndarray], quality: Quality) -> None:
    """Links between stops, wider for more ties."""
    lines = [[places[a][[1, 0]], places[b][[1, 0]]] for a, b in quality.links]
    widths = [0.5 + np.log10(max(count, 1)) for count in quality.links.values()]
    axes.add_collection(LineCollection(lines, linewidths=widths, colors=COOL, alpha=0.35))
    axes.plot([], [], color=COOL, alpha=0.35, lw=2, label="links, wider with more ties")


def _draw_vectors(axes: Axes, network: AdjustedNetwork, rows: np.ndarray, size: int) -> None:
    """Residuals by kind of tie, those of cross-site ties in colour; the longest are truncated."""
    rows = np.array(_some(rows.tolist(), MOST_VECTORS), dtype=np.int64)
    seen = network.ties.observations
    v = network.ties.residuals_px[rows, :2]
    length = np.linalg.norm(v, axis=1)
    usual = max(float(np.percentile(length, 75)) if len(length) else 1.0, 1e-3)
    times = 0.03 * size / usual
    ends = seen.left[rows] + times * v * np.minimum(1.0, LONGEST * usual / length)[:, None]
    lines = np.stack([seen.left[rows], ends], axis=1)
    across = np.array([network.ties.kinds[k] == TieKind.CROSS_SITE for k in seen.point[rows]])
    for some, colour in ((~across, INK), (across, WARM)):
        drawn = lines[some].reshape(-1, 2)  # one path has fewer bytes than many
        codes = np.tile(np.array([Path.MOVETO, Path.LINETO], Path.code_type), len(drawn) // 2)
        axes.add_patch(PathPatch(Path(drawn, codes), fill=False, ec=colour, lw=0.5))
    axes.set_title(f"residuals, {times:.0f} times larger (red: cross-site)", fontsize=9)


def _draw_means(figure: Figure, axes: Axes, found: CameraResiduals, size: int) -> None:
    n = len(found.grid)
    cells = np.array([[c or (np.nan,) * 3 for c in row] for row in found.grid])
    bound = max(float(np.nanmax(np.abs(cells[:, :, 2]), initial=0.0)), 1e-3)
    shown = axes.imshow(cells[:, :, 2], cmap="RdBu_r", vmin=-bound, vmax=bound, alpha=0.7,
                        extent=(0, size, size, 0))  # fmt: skip
    figure.colorbar(shown, ax=axes, shrink=0.8, label="mean parallax residual, px")
    middle = (np.arange(n) + 0.5) * found.cell_px
    x, y = np.meshgrid(middle, middle)
    longest = float(np.nanmax(np.hypot(cells[:, :, 0], cells[:, :, 1]), initial=1e-3))
    axes.quiver(x, y, cells[:, :, 0], cells[:, :, 1], angles="xy", scale_units="xy",
                scale=longest / (0.8 * found.cell_px), width=0.004, color=INK)  # fmt: skip
    axes.set_title(f"means by cell; longest arrow {longest:.2f} px", fontsize=9)


def _some(items: Sequence[T], most: int) -> list[T]:
    """At most that many of the items, evenly spread, including the last."""
    if len(items) <= most:
        return list(items)
    return [items[round(k)] for k in np.linspace(0, len(items) - 1, most)]


def _short(stop: StopId) -> str:
    return f"{stop.site}-{stop.drive}"
