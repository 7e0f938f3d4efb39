"""How somebody wants to see a layer: which of its styles, and with what sun, colours and limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

from solmap.gis_server.rendering.colours import RAMPS
from solmap.gis_server.rendering.styles import DEFAULT, Style, range_of, styles_of
from solmap.products.model import Layer


class UnknownLookError(Exception):
    """A layer cannot be shown as somebody asked for."""


@dataclass(frozen=True, slots=True)
class Look:
    """What was asked for; the defaults are those of the layers that are made once."""

    style: str = DEFAULT
    colours: str | None = None
    """Name of a ramp; the style's own by default."""
    low: float | None = None
    """Value of the first colour, in the layer's unit; the style's own by default."""
    high: float | None = None
    azimuth_deg: float = 315.0
    """Of the sun, clockwise from north. North-west, as on printed maps."""
    elevation_deg: float = 45.0
    """Of the sun above the horizon."""
    exaggeration: float = 1.0
    """Factor on heights, for shading only."""
    threshold_deg: float = 5.0
    """Tilt towards north from which on ground counts as facing north."""
    baseline_m: float | None = None
    """Length over which a slope is felt; three of the tile's cells by default."""
    interval_m: float | None = None
    """Between contours; chosen by the layer's range by default."""


def style_for(layer: Layer, look: Look) -> Style:
    """The style of a layer with the colours and range that were asked for.

    Raises:
        ProductNotFoundError: the layer has no tiles.
        UnknownLookError: it has no such style, or there are no such colours.
    """
    styles = styles_of(layer.ref.kind)
    if look.style not in styles:
        raise UnknownLookError(f"{layer.id} has no style {look.style}; it has {', '.join(styles)}")
    style = styles[look.style]
    if look.colours is None and look.low is None and look.high is None:
        return style
    if style.is_classes or style.is_colour:
        raise UnknownLookError(
            f"{layer.id} has colours of its own: leave out colours, low and high"
        )
    low, high = range_of(style, layer)
    ends = low if look.low is None else look.low, high if look.high is None else look.high
    if not ends[0] < ends[1]:
        raise UnknownLookError(
            f"low={ends[0]:g} is not below high={ends[1]:g}; the range of {layer.id} is {low:g} to "
            f"{high:g}"
        )
    return replace(style, colours=_ramp_of(look.colours, style), range=ends)


def _ramp_of(name: str | None, style: Style) -> tuple[str, ...]:
    if name is None:
        return style.colours
    if name not in RAMPS:
        raise UnknownLookError(f"there are no colours {name}; there are {', '.join(RAMPS)}")
    return RAMPS[name]
