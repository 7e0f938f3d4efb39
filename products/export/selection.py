"""Selection of products for an export: missions, sols, stops, kinds, and time of creation."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.errors import ProductError
from solmap.products.model import Layer, ProductKind, ProductRef, mission_of

MAPS, TRAVERSE, REPORTS = "maps", "traverse", "reports"
BY_DEFAULT = frozenset({MAPS, TRAVERSE, REPORTS})
EXCHANGE: Mapping[str, str] = {
    "colmap": (
        "cameras, images and tie points as a COLMAP model in text; its images are in "
        "`epipolar/`, its world is the map in metres east, north, up"
    ),
    "asp": (
        "cameras of the images in `epipolar/` for the Ames Stereo Pipeline: pinhole (.tsai), in "
        "metres of the map, and CSM states (.json), body-fixed"
    ),
    "isis": "tie points as an ISIS control network (PVL), body-fixed",
    "pds": "XYZ, range, normals and slope of every stereo pair (VICAR, with PDS4 labels)",
}
"""Files for other programs that are only exported on request, and their descriptions."""
EPIPOLAR = "epipolar"
"""Folder of the epipolar images of the exported cameras and tie points."""
_STOP = re.compile(r"(?:.*site)?0*(\d{1,6})(?:/|-drive|-)0*(\d{1,6})", re.ASCII)


def stop_named(text: str) -> tuple[int, int]:
    """Site and drive of a stop, from `10/100` or `mer2-site0010-drive0100`.

    Raises:
        ProductError: it does not name a stop.
    """
    found = _STOP.fullmatch(text.strip().lower())
    if found is None:
        raise ProductError(f"{text!r} does not name a stop; SITE/DRIVE is expected, such as 10/100")
    return int(found[1]), int(found[2])


@dataclass(frozen=True, slots=True)
class Selection:
    """A selection; empty parts select everything."""

    mission: str | None = None
    """A mission with all of its maps, or one of its maps."""
    sols: frozenset[int] | None = None
    stops: frozenset[tuple[int, int]] = frozenset()
    """Site and drive; if given, maps of regions and of whole missions are left out."""
    kinds: frozenset[str] = frozenset()
    """Kinds of layers, and words for several: `maps`, `traverse`, `reports` and `EXCHANGE`."""
    since: datetime | None = None
    """Earliest time of production."""

    def __post_init__(self) -> None:
        known = {*BY_DEFAULT, *EXCHANGE, *map(str, ProductKind)}
        for kind in sorted(self.kinds - known):
            words = ", ".join((*sorted(BY_DEFAULT), *EXCHANGE))
            raise ProductError(
                f"there is no kind {kind}; there are {words}, and kinds of layers such as dtm, "
                "orthophoto, slope, contours"
            )

    def has_map(self, name: str) -> bool:
        """Whether a map is selected."""
        return self.mission is None or self.mission.upper() in {name, mission_of(name)}

    def has(self, word: str) -> bool:
        """Whether `maps`, `traverse`, `reports` or one of `EXCHANGE` is selected."""
        return word in (self.kinds or BY_DEFAULT)

    def has_layer(self, layer: Layer) -> bool:
        """Whether a layer is selected."""
        of_kind = self.has(MAPS) or str(layer.ref.kind) in self.kinds
        return (
            of_kind
            and self.has_map(layer.mission)
            and (self.sols is None or not self.sols.isdisjoint(layer.sols))
            and (not self.stops or self._has_stop(layer.ref))
            and self._is_recent(layer.made_at)
        )

    def has_file(self, ref: ProductRef, sols: frozenset[int], made_at: str) -> bool:
        """Whether a product that is not a layer is selected; without sols, one of the mission."""
        return (
            (self.sols is None or not sols or not self.sols.isdisjoint(sols))
            and (not self.stops or not sols)
            and self._is_recent(made_at)
            and (ref.kind in self.kinds or self.has(REPORTS if sols else TRAVERSE))
        )

    def has_image(self, image: ImageEntry) -> bool:
        """Whether an image is selected."""
        return (self.sols is None or image.sol in self.sols) and (
            not self.stops or (image.site, image.drive) in self.stops
        )

    def _has_stop(self, ref: ProductRef) -> bool:
        found = _STOP.fullmatch(ref.scope.name)
        return (
            found is not None
            and "region" not in ref.scope.name
            and (int(found[1]), int(found[2])) in self.stops
        )

    def _is_recent(self, made_at: str) -> bool:
        made = datetime.fromisoformat(made_at)
        return self.since is None or _aware(made) >= _aware(self.since)


def _aware(moment: datetime) -> datetime:
    """A time without a zone is UTC."""
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
