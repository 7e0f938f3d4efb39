"""Colour ramps, palettes and the index of a value in them.

Index 0 of a palette is transparent (not measured), 1 to 255 run from the low to the high end of
a range. viridis and inferno rise in lightness and read well without colour vision; twilight is
cyclic, so that directions of 359 and 1 degrees look alike; red-blue is light in the middle.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

LEVELS = 254
"""Steps between index 1 and index 255."""
Ramp = tuple[str, ...]
"""Colours, `#rrggbb`, evenly spaced over a range."""


def _ramp(colours: str) -> Ramp:
    return tuple(colours.split())


GREY = ("#000000", "#ffffff")
VIRIDIS = _ramp("#440154 #472d7b #3b528b #2c728e #21918c #28ae80 #5ec962 #addc30 #fde725")
INFERNO = _ramp("#000004 #210c4a #57106e #8a226a #bc3754 #e45a31 #f98e09 #f9cb35 #fcffa4")
RED_BLUE = _ramp("#67001f #b2182b #d6604d #f4a582 #f7f7f7 #92c5de #4393c3 #2166ac #053061")
TWILIGHT = _ramp("#e2d9e2 #95b5c7 #6276ba #592a8f #2f1436 #741e4f #b25652 #cca389 #e2d9e2")
RAMPS: dict[str, Ramp] = {
    "grey": GREY,
    "viridis": VIRIDIS,
    "inferno": INFERNO,
    "red-blue": RED_BLUE,
    "twilight": TWILIGHT,
}
"""By the name that tiles are asked for with."""


@lru_cache(maxsize=64)
def palette_of(ramp: Ramp) -> np.ndarray:
    """256 rows of red, green and blue; row 0 is never seen."""
    anchors = np.array([_rgb(colour) for colour in ramp], dtype=np.float64)
    at = np.linspace(0.0, 1.0, len(anchors))
    where = np.concatenate([[0.0], np.linspace(0.0, 1.0, LEVELS + 1)])
    channels = [np.interp(where, at, anchors[:, channel]) for channel in range(3)]
    palette = np.rint(np.column_stack(channels)).astype(np.uint8)
    palette.setflags(write=False)
    return palette


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def stretched(palette: np.ndarray, low: float, high: float) -> np.ndarray:
    """The palette of a picture whose indices `low` and `high` are its black and its white."""
    index = np.clip((np.arange(256) - low) / (high - low) * LEVELS + 1.5, 1, 255)
    return palette[index.astype(int)]


def indices_of(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Palette indices of float values; NaN becomes 0."""
    steps = (values - np.float32(low)) * np.float32(LEVELS / (high - low)) + np.float32(1.5)
    np.clip(steps, 1.0, 255.0, out=steps)
    np.copyto(steps, 0.0, where=np.isnan(steps))
    return steps.astype(np.uint8)
