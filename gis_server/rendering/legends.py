"""A legend as a picture, for clients that show no other."""

from __future__ import annotations

import cv2
import numpy as np

from solmap.gis_server.rendering.colours import palette_of
from solmap.gis_server.rendering.styles import Style, legend_of
from solmap.products.model import Layer

_BAR, _ROW, _TOP, _WIDTH = 24, 22, 30, 220
_INK, _PAPER = (40, 40, 40), 255
_FONT, _SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.42


def draw_legend(layer: Layer, style: Style) -> bytes:
    """PNG of the colours of a style with their values or the names of their classes."""
    legend = legend_of(layer, style) or {"stops": [], "unit": "", "classes": []}
    classes = [(one["name"], one["colour"]) for one in legend.get("classes", [])]
    stops = [(f"{value:.5g}", colour) for value, colour in reversed(legend["stops"])]
    rows = stops or classes
    picture = np.full((_TOP + _ROW * max(1, len(rows)) + 8, _WIDTH, 3), _PAPER, np.uint8)
    unit = f" ({legend['unit']})" if legend["unit"] else ""
    _write(picture, f"{style.title or layer.ref.kind}{unit}", 8, 18)
    for number, (text, colour) in enumerate(rows):
        top = _TOP + _ROW * number
        red, green, blue = palette_of((colour,) * 2)[1].tolist()
        picture[top : top + _ROW - (2 if classes else 0), 8 : 8 + _BAR] = blue, green, red
        _write(picture, text, 16 + _BAR, top + 15)
    if stops:
        _blend(picture, style, len(stops))
    return bytes(cv2.imencode(".png", picture)[1])


def _blend(picture: np.ndarray, style: Style, count: int) -> None:
    """A bar without steps, the low end below; every value stands at the middle of its row."""
    rows = _ROW * count
    share = np.clip((rows - _ROW / 2 - np.arange(rows)) / (rows - _ROW), 0.0, 1.0)
    colours = palette_of(style.colours)[np.rint(1 + 254 * share).astype(int)]
    picture[_TOP : _TOP + rows, 8 : 8 + _BAR] = colours[:, None, ::-1]


def _write(picture: np.ndarray, text: str, left: int, base: int) -> None:
    cv2.putText(picture, text, (left, base), _FONT, _SIZE, _INK, 1, cv2.LINE_AA)
