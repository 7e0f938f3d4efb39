"""Plots as SVG whose bytes depend on what they show and on nothing else."""

from __future__ import annotations

import io

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK, FAINT = "#222222", "#9a9a9a"
TELEMETRY_BLUE, ADJUSTED_RED = "#1769e0", "#e02d25"
"""The paper's colours of both traverses (its figure 7), as the viewer draws them."""

mpl.rcParams["svg.hashsalt"] = "solmap"  # names of clip paths: from this, or else from chance


def svg(figure: Figure) -> bytes:
    """The figure as SVG, free of dates and of frames' upper and right edges."""
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    buffer = io.BytesIO()
    FigureCanvasSVG(figure).print_figure(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
