"""Plots as SVG whose bytes depend on what they show and on nothing else."""

from __future__ import annotations

import io

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK, FAINT = "#222222", "#9a9a9a"
TELEMETRY_BLUE, ADJUSTED_RED = "#1769e0", "#e02d25"
"""The paper's colours of both traverses (its figure 7), as the viewer draws them."""

mpl.rcParams["svg.hashsalt"] = "solmap"  # names of clip paths: from this, or else from chance


def png(figure: Figure) -> bytes:
    """The figure as PNG, 150 dots an inch, free of frames' upper and right edges."""
    _without_frames(figure)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_figure(buffer, format="png", dpi=150, metadata={"Software": None})
    return buffer.getvalue()


def _without_frames(figure: Figure) -> None:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)


def svg(figure: Figure) -> bytes:
    """The figure as SVG, free of dates and of frames' upper and right edges."""
    _without_frames(figure)
    buffer = io.BytesIO()
    FigureCanvasSVG(figure).print_figure(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
