"""When what a feature shows was seen: sols, and moments of UTC, from the images behind it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any

from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.model import Layer

Sols = tuple[int, int]
Times = tuple[str, str]


class FeatureTimes:
    """The images of a mission, asked when a feature of a layer was seen."""

    def __init__(self, images: Mapping[str, ImageEntry], layer: Layer) -> None:
        """Features that name neither sol nor image are as old as their layer."""
        self._images, self._layer = images, layer
        self._known: dict[tuple[Sols, str | None], Times | None] = {}

    def of(self, properties: Mapping[str, Any]) -> tuple[Sols | None, Times | None]:
        """First and last sol, and first and last start of the images behind a feature."""
        named = [properties.get("image"), *(properties.get("pairs") or ())]
        behind = [self._images[name] for name in named if name in self._images]
        own = properties.get("sol", properties.get("sols"))
        listed = [own] if isinstance(own, int) else own
        known = listed or [image.sol for image in behind] or self._layer.sols
        if not known:
            return None, None
        sols = min(known), max(known)
        return sols, times_of(behind) if behind else self._of_stop(sols, properties.get("stop"))

    def _of_stop(self, sols: Sols, stop: str | None) -> Times | None:
        """The images of some sols, and of a stop where one is named."""
        asked = sols, stop
        if asked not in self._known:
            self._known[asked] = times_of(
                image
                for image in self._images.values()
                if sols[0] <= image.sol <= sols[1] and stop in (None, image.stop)
            )
        return self._known[asked]


def times_of(images: Iterable[ImageEntry]) -> Times | None:
    """First and last start of images; None where no label tells it."""
    known = sorted(moment(image.start_time) for image in images if image.start_time)
    return (known[0], known[-1]) if known else None


@lru_cache(maxsize=65536)  # an image is behind many features
def moment(text: str) -> str:
    """A moment in the form that all of the index have: UTC with milliseconds.

    Raises:
        ValueError: it is no moment.
    """
    told = datetime.fromisoformat(text)
    utc = told.astimezone(UTC) if told.tzinfo else told.replace(tzinfo=UTC)
    return utc.isoformat(timespec="milliseconds").replace("+00:00", "Z")
