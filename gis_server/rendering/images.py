"""The rover's images in eight bits: raw, stretched, linearised, and as anaglyphs.

They are divided into tiles of 256 pixels: at the highest zoom a tile pixel is an image pixel; each
lower zoom halves the resolution, and zoom 0 is one tile. Grey values are cached in memory up to a
size limit, so that further tiles or stretches of an image are cheap; nothing is written to disk.

An anaglyph holds the left image in red and the right one in green and blue. Ground whose parallax
equals `Stretch.shift_px` coincides in both and appears in the screen plane.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from solmap.photogrammetry.arrays import EightBits, GreyImage
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.resampling import resample
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import ImageFile, image_file, read_product_image
from solmap.products.catalogue.oriented_images import geometry_of, matched_record, matches_of
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import OutsideCoverageError, ProductNotFoundError


class ArrayCache:
    """A cache of the most recently used arrays, limited in bytes."""

    def __init__(self, limit: int) -> None:
        """Hold at most `limit` bytes."""
        self._limit = limit
        self._arrays: OrderedDict[Hashable, np.ndarray] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
        """The array of a key, computed if it is not cached."""
        with self._lock:
            if key in self._arrays:
                self._arrays.move_to_end(key)
                return self._arrays[key]
        array = make()
        array.flags.writeable = False
        with self._lock:
            if key not in self._arrays:
                self._arrays[key] = array
                self._bytes += array.nbytes
            while self._bytes > self._limit and len(self._arrays) > 1:
                self._bytes -= self._arrays.popitem(last=False)[1].nbytes
        return array


TILE = 256
_DEPTHS = (255.0, 4095.0, 65535.0)
"""Largest values of 8, 12 and 16 bits."""
_CACHE = ArrayCache(128 << 20)
"""128 MiB: about fifteen Navcam pairs with their reduced levels."""


class Style(StrEnum):
    """How an image is shown."""

    RAW = "raw"
    """Raw values: black is 0, white the largest value of the bit depth."""
    STRETCHED = "stretched"
    """Radiometrically corrected values between two percentiles, or between two values."""
    LINEARISED = "linearised"
    """Resampled so that its rows match its partner's, as used for matching."""
    ANAGLYPH = "anaglyph"
    """Both linearised images of a pair, for red and cyan glasses."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """How grey values become brightness."""

    low_percent: float = 1.0
    high_percent: float = 99.0
    black: float | None = None
    """Value shown as black, instead of the low percentile."""
    white: float | None = None
    gamma: float = 1.0
    shift_px: float = 0.0
    """Parallax at which both images of an anaglyph coincide."""


@dataclass(frozen=True, slots=True)
class ImageView:
    """An image prepared for a style: its source planes."""

    style: Style
    planes: tuple[tuple[ImageEntry, str], ...]
    """One plane (grey), or two: the left for red, the right for green and blue.

    Each with the digest of its source."""
    workspace: Workspace

    @classmethod
    def of(cls, entry: ImageEntry, style: Style, workspace: Workspace) -> ImageView:
        """The view of an image in a style.

        Raises:
            ProductNotFoundError: the style needs a matched partner, and there is none.
        """
        if style in (Style.RAW, Style.STRETCHED):
            return cls(style, ((entry, entry.ref.digest),), workspace)
        matches = matches_of(entry, workspace)
        if matches is None or entry.partner is None:
            why = entry.unpaired_because or "its pair has not been matched"
            raise ProductNotFoundError(f"{entry.id} is not available as {style} image: {why}")
        source_digest = f"{entry.ref.digest}-{matches.digest}"
        if style is Style.LINEARISED:
            return cls(style, ((entry, source_digest),), workspace)
        other = workspace.catalogue.image(entry.partner)
        both = (entry, other) if entry.eye == Eye.LEFT else (other, entry)
        return cls(style, tuple((one_image, source_digest) for one_image in both), workspace)

    @property
    def size(self) -> tuple[int, int]:
        """(samples, lines) of the image."""
        lines, samples = self._plane(0).shape
        return samples, lines

    @property
    def max_zoom(self) -> int:
        """Zoom at which a pixel of a tile is one of the image."""
        return max(0, math.ceil(math.log2(max(self.size) / TILE)))

    def image(self, stretch: Stretch) -> EightBits:
        """The whole image."""
        samples, lines = self.size
        return self._draw((0, 0, samples, lines), 0, stretch)

    def tile(self, zoom: int, column: int, row: int, stretch: Stretch) -> EightBits:
        """A tile of the image; tiles at the image's right and lower edges are smaller.

        Raises:
            OutsideCoverageError: the image has no such tile.
        """
        halvings = self.max_zoom - zoom
        lines, samples = (math.ceil(n / 2 ** max(halvings, 0)) for n in self.size[::-1])
        left, top = column * TILE, row * TILE
        if halvings < 0 or left >= samples or top >= lines:
            raise OutsideCoverageError(
                f"there is no tile: column {column}, row {row} at zoom {zoom} "
                f"(zooms 0 to {self.max_zoom})"
            )
        box = (left, top, min(left + TILE, samples), min(top + TILE, lines))
        return self._draw(box, halvings, stretch)

    def _draw(self, box: tuple[int, int, int, int], halvings: int, stretch: Stretch) -> EightBits:
        left, top, right, bottom = box
        channels = []
        for number in range(len(self.planes)):
            level = self._level(number, halvings)
            shift = round(number * stretch.shift_px / 2**halvings)
            columns = np.arange(left, right) - shift
            inside = (columns >= 0) & (columns < level.shape[1])
            part = level[top:bottom][:, np.clip(columns, 0, level.shape[1] - 1)]
            bright = _brightness(part, *self._ends(number, stretch), stretch.gamma)
            channels.append(np.where(inside, bright, np.uint8(0)))
        if len(channels) == 1:
            return channels[0]
        return np.stack([channels[0], channels[1], channels[1]], axis=-1)

    def _key(self, number: int) -> tuple[str, str, str]:
        """Key of the grey values, shared by the linearised and anaglyph styles."""
        entry, source_digest = self.planes[number]
        is_unmatched_style = self.style in (Style.RAW, Style.STRETCHED)
        values = self.style if is_unmatched_style else Style.LINEARISED
        return entry.id, source_digest, str(values)

    def _plane(self, number: int) -> GreyImage:
        entry = self.planes[number][0]

        def compute_plane() -> GreyImage:
            if self.style is Style.RAW:
                return _raw(entry, self.workspace)
            return _grey(entry, self.style, self.workspace)

        return _CACHE.get(self._key(number), compute_plane)

    def _level(self, number: int, halvings: int) -> GreyImage:
        if halvings == 0:
            return self._plane(number)

        def halve() -> GreyImage:
            larger = self._level(number, halvings - 1)
            size = (math.ceil(larger.shape[1] / 2), math.ceil(larger.shape[0] / 2))
            return cv2.resize(larger, size, interpolation=cv2.INTER_AREA)

        return _CACHE.get((*self._key(number), halvings), halve)

    def _ends(self, number: int, stretch: Stretch) -> tuple[float, float]:
        """The values shown as black and as white."""
        if self.style is Style.RAW:
            largest = float(np.nanmax(self._plane(number), initial=0.0))
            return 0.0, next((depth for depth in _DEPTHS if largest <= depth), largest)

        def percentiles() -> np.ndarray:
            values = self._plane(number)
            known = values[np.isfinite(values)]
            percent = [stretch.low_percent, stretch.high_percent]
            return np.percentile(known, percent) if len(known) else np.array([0.0, 1.0])

        key = (*self._key(number), stretch.low_percent, stretch.high_percent)
        low, high = _CACHE.get(key, percentiles).tolist()
        low = low if stretch.black is None else stretch.black
        return low, high if stretch.white is None else stretch.white


def linearised_image(entry: ImageEntry, workspace: Workspace) -> GreyImage:
    """The linearised image, as used for matching; NaN where it has no valid pixel.

    Raises:
        ProductNotFoundError: it has no partner, or was not matched.
    """
    return ImageView.of(entry, Style.LINEARISED, workspace)._plane(0)  # noqa: SLF001 - of this module


def _raw(entry: ImageEntry, workspace: Workspace) -> GreyImage:
    """Values as stored, without decoding tables and flat-field correction."""
    return read_product_image(ImageFile(entry.ref), workspace.store).pixels


def _grey(entry: ImageEntry, style: Style, workspace: Workspace) -> GreyImage:
    """Grey values; NaN where the image has no valid pixel."""
    read = read_product_image(image_file(entry), workspace.store)
    if style is Style.STRETCHED:
        return np.where(read.mask, read.pixels, np.float32(np.nan))
    matches = matches_of(entry, workspace)
    assert matches is not None  # noqa: S101 - checked before
    camera = matched_record(entry, workspace).camera
    geometry = geometry_of(matches, workspace)
    image, mask = resample(read.pixels, read.mask, camera, geometry, Eye(entry.eye))
    return np.where(mask, image, np.float32(np.nan))


def _brightness(values: np.ndarray, low: float, high: float, gamma: float) -> EightBits:
    """Bytes between black and white; black where nothing was measured."""
    scaled = (values - np.float32(low)) / np.float32(max(high - low, 1e-6))
    scaled = np.clip(np.nan_to_num(scaled, nan=0.0), 0.0, 1.0)
    if gamma != 1.0:
        scaled = scaled ** np.float32(1.0 / gamma)
    return np.rint(scaled * np.float32(255.0)).astype(np.uint8)


def png_of(pixels: EightBits) -> bytes:
    """A grey or RGB image as PNG."""
    colours = pixels if pixels.ndim == 2 else pixels[:, :, ::-1]  # noqa: PLR2004 - OpenCV's order
    return cv2.imencode(".png", colours, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1].tobytes()
