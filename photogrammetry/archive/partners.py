"""Stereo partners, found by label.

Both shutters open together, so the frames of a pair have the same mission, instrument, motion
counter, kind of product and geometry, and clocks within a second. Either eye may be a sub-frame,
which its camera model includes. One exposure often has several products. It is one observation, so
one product of each eye and filter is used, even without a pair:

  - raw before linearised: rows of the archive's linearised images correspond only approximately;
  - of frames with different averaging the finest that together cover at least 90 percent of the
    view of any: all tiles at full resolution before the whole frame averaged, and that before some
    tiles;
  - the larger frames before sub-frames;
  - radiometrically corrected ones (RAD) first, then inverse-LUT (ILF, ISF, INN), EDR (EFF, ESF,
    EDN), anything else, of a pair the first kind that both eyes have;
  - of these the highest version of each.

Images of one exposure that do not contain each other's middle, such as tiles, are separate
observations: tiles of the same number form a pair.

Filters of a pair must have the same band (Pancam L2 with R2, L7 with R1), and zoom lenses the same
focal length. Every image without a pair is listed with the reason.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from solmap.photogrammetry.archive.file_names import camera_string, tile_number
from solmap.photogrammetry.archive.missions import mission_of_host
from solmap.photogrammetry.cameras.cahv import Cahv, interior_orientation
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.imagery import Eye, RoverImage, StereoPair

MAX_CLOCK_DIFFERENCE = 1.0
"""Seconds; the shutters of flight pairs open within the same millisecond."""

PRODUCT_ORDER = (
    *("RAD", "MRD", "RSD", "RFD", "IOF", "IFF", "CCD", "CFD"),  # radiometrically corrected
    *("ILF", "ILT", "EFF", "EDR"),
)
"""Order of preference for matching."""

FULL_FRAME = {"ESF": "EFF", "EDN": "EFF", "ISF": "ILF", "INN": "ILF", "SFL": "FFL", "DNL": "FFL"}
"""Sub-framed and down-sampled products, and the full-frame product of the same kind."""


SAME_COVERAGE = 0.9
"""Fraction of the view that frames of one averaging must cover to replace those of any other."""

Shot = TypeVar("Shot")


@dataclass(frozen=True, slots=True, eq=False)
class StereoPairing:
    """The pairs of a downlink, and the reason why every other frame has no partner."""

    pairs: tuple[StereoPair, ...]
    unpaired: dict[str, str]
    """Image id -> reason."""
    repeats: dict[str, str]
    """Image id -> id of the image of the same exposure that is used instead."""


def find_stereo_pairs(images: Sequence[RoverImage]) -> StereoPairing:
    """Pair the frames of every exposure."""
    pairs: list[StereoPair] = []
    unpaired: dict[str, str] = {}
    repeats: dict[str, str] = {}
    by_clock: dict[int, list[RoverImage]] = defaultdict(list)
    for image in images:
        by_clock[int(image.clock // MAX_CLOCK_DIFFERENCE)].append(image)
    for exposure in _exposures(images):
        found = _pairs(exposure)
        pairs += found
        used = [image for pair in found for image in (pair.left, pair.right)]
        paired_here = tuple(used)
        for image in sorted(exposure, key=_rank):
            if any(image is one for one in used):
                continue
            better = next((one for one in used if _is_same_observation(image, one)), None)
            if better is not None:
                repeats[image.id] = better.id
                unpaired[image.id] = (
                    f"{better.product_type} {better.id} of the same exposure is used instead"
                )
            else:
                used.append(image)
                near = paired_here or _around(image, by_clock)
                unpaired[image.id] = _why_alone(image, near)
    pairs.sort(key=lambda pair: (pair.left.clock, pair.left.id))
    paired = {image.id for pair in pairs for image in (pair.left, pair.right)}
    unpaired = {key: why for key, why in unpaired.items() if key not in paired}
    repeats = {key: better for key, better in repeats.items() if key in unpaired}
    return StereoPairing(tuple(pairs), unpaired, repeats)


def _around(image: RoverImage, by_clock: Mapping[int, list[RoverImage]]) -> list[RoverImage]:
    """The images taken at about the same time."""
    second = int(image.clock // MAX_CLOCK_DIFFERENCE)
    return [near for bin_ in (second - 1, second, second + 1) for near in by_clock.get(bin_, ())]


def _exposures(images: Sequence[RoverImage]) -> list[list[RoverImage]]:
    """Frames exposed together: groups along the clock, for each position and camera."""
    by_place: dict[tuple[object, ...], list[RoverImage]] = defaultdict(list)
    for image in images:
        by_place[image.stop, image.instrument, image.motion_counter].append(image)
    exposures: list[list[RoverImage]] = []
    for frames in by_place.values():
        exposures += group_by_clock(frames, lambda image: (image.clock, image.id))
    return exposures


def group_by_clock(
    frames: Iterable[Shot], when: Callable[[Shot], tuple[float, str]]
) -> list[list[Shot]]:
    """Groups of frames within `MAX_CLOCK_DIFFERENCE` of the first; `when` gives clock and name."""
    groups: list[list[Shot]] = []
    first = 0.0
    for frame in sorted(frames, key=when):
        clock, _ = when(frame)
        if not groups or clock - first > MAX_CLOCK_DIFFERENCE:
            groups.append([])
            first = clock
        groups[-1].append(frame)
    return groups


def _pairs(exposure: Sequence[RoverImage]) -> list[StereoPair]:
    """The frames of an exposure that are matched, by the order in the module's docstring."""
    worse = _resolution_ranks(exposure)
    candidates = [
        (left, right)
        for left in exposure
        if left.eye is Eye.LEFT
        for right in exposure
        if right.eye is Eye.RIGHT
        and _kind(right) == _kind(left)
        and right.is_linearised == left.is_linearised
        and camera_string(right.id) == camera_string(left.id)
        and _filters_agree(left, right)
        and _tiles_agree(left, right, worse)
    ]
    pairs: list[StereoPair] = []
    while candidates:
        pair = StereoPair(*min(candidates, key=lambda both: _preference(both[0], both[1], worse)))
        pairs.append(pair)
        candidates = [
            (left, right)
            for left, right in candidates
            if not (
                _is_same_observation(left, pair.left) or _is_same_observation(right, pair.right)
            )
        ]
    return pairs


def _resolution_ranks(exposure: Sequence[RoverImage]) -> dict[str, int]:
    """Image id -> rank of its averaging; frames of rank 0 are preferred."""
    if len({(image.eye, image.filter_number) for image in exposure}) == len(exposure):
        return dict.fromkeys((image.id for image in exposure), 0)
    focal_px = {image.id: _focal_px(image) for image in exposure}
    longest = max(focal_px.values())
    levels = {name: round(math.log2(longest / focal)) for name, focal in focal_px.items()}
    if not any(levels.values()):
        return levels
    views: dict[int, dict[tuple[object, ...], float]] = defaultdict(lambda: defaultdict(float))
    for image in exposure:
        part = (image.eye, image.filter_number, tile_number(image.id))
        view = image.lines * image.samples / focal_px[image.id] ** 2
        shown = views[levels[image.id]]
        shown[part] = max(shown[part], view)
    total = {level: sum(shown.values()) for level, shown in views.items()}
    enough = SAME_COVERAGE * max(total.values())
    order = sorted(total, key=lambda level: (total[level] < enough, level))
    return {name: order.index(level) for name, level in levels.items()}


def _focal_px(image: RoverImage) -> float:
    """Focal length, which averaging shortens; 1 for cameras other than CAHV, never averaged."""
    camera = image.camera
    if not isinstance(camera, Cahv | Cahvor | Cahvore):
        return 1.0
    return interior_orientation(camera.a, camera.h, camera.v).hs


def _tiles_agree(left: RoverImage, right: RoverImage, ranks: Mapping[str, int]) -> bool:
    """Whether both show the same part of the detector; averaged frames are cut otherwise."""
    tiles = tile_number(left.id), tile_number(right.id)
    return tiles[0] == tiles[1] and (tiles[0] == 0 or ranks[left.id] == ranks[right.id])


def _preference(
    left: RoverImage, right: RoverImage, ranks: Mapping[str, int]
) -> tuple[object, ...]:
    size = left.lines * left.samples + right.lines * right.samples
    newest = (-_version(left), -_version(right))
    apart = abs(left.clock - right.clock)
    worse = ranks[left.id] + ranks[right.id]
    return left.is_linearised, worse, -size, *_order(left), apart, newest, left.id, right.id


def _rank(image: RoverImage) -> tuple[object, ...]:
    """The same for a single image."""
    size = image.lines * image.samples
    return image.is_linearised, -size, *_order(image), -_version(image), image.id


def _order(image: RoverImage) -> tuple[int, str]:
    kind = _kind(image)
    return PRODUCT_ORDER.index(kind) if kind in PRODUCT_ORDER else len(PRODUCT_ORDER), kind


def _kind(image: RoverImage) -> str:
    """The product type of the corresponding full frame."""
    return FULL_FRAME.get(image.product_type, image.product_type)


def _version(image: RoverImage) -> int:
    """Version of a product: the last character of its name, 1-9 then A-Z."""
    last = image.id[-1:]
    return int(last, 36) if last.isascii() and last.isalnum() else 0


def _filters_agree(left: RoverImage, right: RoverImage) -> bool:
    """Whether both filters have the same band; true for cameras without filter wheel."""
    allowed = _allowed_filters(left).get(left.instrument)
    if allowed is None or left.filter_number is None or right.filter_number is None:
        return allowed != frozenset()
    return (left.filter_number, right.filter_number) in allowed


def _allowed_filters(
    image: RoverImage,
) -> Mapping[str, frozenset[tuple[int, int]]]:
    mission = mission_of_host(image.stop.mission)
    return mission.stereo_filters if mission else {}


def _is_same_observation(image: RoverImage, other: RoverImage) -> bool:
    """Whether images of one exposure show the same scene: one contains the middle of the other."""
    if (image.eye, image.filter_number) != (other.eye, other.filter_number):
        return False
    return _shows_middle(image, other) or _shows_middle(other, image)


def _shows_middle(image: RoverImage, other: RoverImage) -> bool:
    middle = np.array([[(other.samples - 1) / 2, (other.lines - 1) / 2]])
    sample, line = image.camera.project(other.camera.centre + other.camera.rays(middle))[0]
    return bool(0 <= sample < image.samples and 0 <= line < image.lines)


def _why_alone(  # noqa: PLR0911 - a reason each
    image: RoverImage, images: Sequence[RoverImage]
) -> str:
    """The reason why an image has no partner."""
    if image.eye is Eye.MONO:
        return f"{image.instrument} has one eye"
    other = Eye.RIGHT if image.eye is Eye.LEFT else Eye.LEFT
    near = [
        partner
        for partner in images
        if partner.eye is other
        and (partner.stop.mission, partner.instrument) == (image.stop.mission, image.instrument)
        and abs(partner.clock - image.clock) <= MAX_CLOCK_DIFFERENCE
    ]
    clock = int(image.clock)
    if not near:
        return f"no {other}-eye partner within {MAX_CLOCK_DIFFERENCE:.0f} s of clock {clock}"
    partner = near[0]
    if partner.motion_counter != image.motion_counter:
        return (
            f"the {other}-eye frame {partner.id} has the motion counter {partner.motion_counter}, "
            f"not {image.motion_counter}"
        )
    left, right = (image, partner) if image.eye is Eye.LEFT else (partner, image)
    if not _filters_agree(left, right):
        return (
            f"the filters of {left.id} (L{left.filter_number}) and {right.id} "
            f"(R{right.filter_number}) have different bands"
        )
    if camera_string(left.id) != camera_string(right.id):
        return (
            f"{left.id} was taken by camera set or focal length {camera_string(left.id)}, "
            f"{right.id} by {camera_string(right.id)}"
        )
    if tile_number(left.id) != tile_number(right.id):
        return f"no {other}-eye frame of its tile {tile_number(image.id)} beside {partner.id}"
    return f"the {other}-eye frame {partner.id} is {_shape(partner)}, this one {_shape(image)}"


def _shape(image: RoverImage) -> str:
    return f"{'a linearised' if image.is_linearised else 'a raw'} {image.product_type}"
