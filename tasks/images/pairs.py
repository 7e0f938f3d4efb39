"""Stereo pairs as products: their files, and reading them with their matches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.archive.file_names import camera_string, tile_number
from solmap.photogrammetry.archive.images.reading import ReadImage
from solmap.photogrammetry.arrays import GreyImage, Mask
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.frames import Frame, FrameKind
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId
from solmap.photogrammetry.matching.records import EpipolarImages, MatchedPair, MatchedStop
from solmap.photogrammetry.matching.resampling import resample
from solmap.photogrammetry.matching.stereo.orientation import turn_in_place
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import (
    ImageFile,
    image_file,
    read_product_image,
    read_product_record,
)
from solmap.products.formats.documents.archives import (
    StoredParallax,
    read_matches,
    read_right_turn,
)
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore

CAMERAS = ("NAVCAM", "PANCAM", "MASTCAM", "FRONT_HAZCAM", "REAR_HAZCAM")
"""Instruments in the order that numbers a pair's frame."""
PAIRS_KEPT = 20
"""Pairs of which a process keeps what it computed: those of two stops."""
LEFT_KEPT = 40
"""Pairs of which a process keeps the left image, 5 MB each: those of three stops with Pancam."""
PARALLAXES_KEPT = LEFT_KEPT
"""Pairs of which a process keeps the parallax, 3 MB each."""
Turn = tuple[float, float, float]
"""A rotation vector in the rover frame, radians."""


@dataclass(frozen=True, slots=True)
class PairFiles:
    """The two images of a stereo pair, as products."""

    id: str
    """The left image's identifier identifies the pair."""
    stop: StopId
    sol: int
    instrument: str
    """The camera set, from `camera_set`: each has its own stereo rig."""
    left: ImageFile
    right: ImageFile

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The products on which the pixels of both depend."""
        return (*self.left.inputs, *self.right.inputs)


@dataclass(frozen=True, slots=True)
class PairProducts:
    """A matched stereo pair, as products."""

    files: PairFiles
    matches: ProductRef
    parallax: ProductRef

    @property
    def made(self) -> tuple[ProductRef, ProductRef]:
        """The products of matching."""
        return self.matches, self.parallax


def pairs_of(entries: Iterable[ImageEntry]) -> list[PairFiles]:
    """The stereo pairs among catalogued images, by identifier."""
    by_id = {entry.id: entry for entry in entries}
    pairs = []
    for entry in by_id.values():
        if entry.eye != Eye.LEFT or entry.partner not in by_id:
            continue
        left, right = image_file(entry), image_file(by_id[entry.partner])
        cameras = camera_set(entry)
        pairs.append(PairFiles(entry.id, entry.stop_id, entry.sol, cameras, left, right))
    return sorted(pairs, key=lambda pair: pair.id)


def camera_set(entry: ImageEntry) -> str:
    """The rig of an image: NAVCAM, NAVCAM B of two sets, MASTCAM 034 of a zoom lens."""
    return f"{entry.instrument} {camera_string(entry.id)}".strip()


def read_pair(pair: PairFiles, store: ProductStore) -> tuple[ReadImage, ReadImage]:
    """Both images of a pair, label and pixels."""
    return read_product_image(pair.left, store), read_product_image(pair.right, store)


def pair_frame(image: RoverImage) -> Frame:
    """The frame of the pair of a left image."""
    camera = CAMERAS.index(image.instrument) if image.instrument in CAMERAS else len(CAMERAS)
    exposure = (image.stop.site, image.stop.drive, camera, round(image.clock * 1000))
    tile = tile_number(image.id)
    return Frame(FrameKind.PAIR, (*exposure, tile) if tile else exposure)


def turn_right_camera(right: ReadImage, turn: Turn | None) -> ReadImage:
    """The right image, with its camera rotated by the rig correction `turn` if there is one."""
    return replace(right, image=_turned(right.image, turn))


def _turned(right: RoverImage, turn: Turn | None) -> RoverImage:
    if turn is None:
        return right
    return replace(right, camera=turn_in_place(right.camera, right.stop.frame, np.array(turn)))


def pair_geometry(left: RoverImage, right: RoverImage) -> EpipolarPair:
    """The epipolar geometry of a pair, in the rover frame of its stop."""
    geometry = epipolar_pair(
        left.camera,
        right.camera,
        (left.samples, left.lines),
        (right.samples, right.lines),
        left.stop.frame,
        pair_frame(left),
    )
    return replace(geometry, mast_in_rover=left.mast_in_rover)


@dataclass(frozen=True, slots=True, eq=False)
class LeftImage:
    """The left image of a pair in the pair's geometry; its arrays are read only."""

    record: RoverImage
    geometry: EpipolarPair
    grey: GreyImage
    mask: Mask


@lru_cache(maxsize=LEFT_KEPT)
def read_left(pair: PairFiles, turn: Turn | None, store: ProductStore) -> LeftImage:
    """The left image of a pair in its geometry, which depends on both cameras.

    Args:
        pair: The images.
        turn: Rotation of the right camera relative to its label.
        store: The store that contains them.
    """
    left = read_product_image(pair.left, store)
    right = _turned(read_product_record(pair.right, store), turn)
    geometry = pair_geometry(left.image, right)
    grey, mask = resample(left.pixels, left.mask, left.image.camera, geometry, Eye.LEFT)
    return LeftImage(left.image, geometry, _read_only(grey), _read_only(mask))


@lru_cache(maxsize=PAIRS_KEPT)
def read_epipolar(pair: PairFiles, turn: Turn | None, store: ProductStore) -> EpipolarImages:
    """Both images of a pair in its geometry; their arrays are read only."""
    left = read_left(pair, turn, store)
    right = turn_right_camera(read_product_image(pair.right, store), turn)
    grey, mask = resample(right.pixels, right.mask, right.image.camera, left.geometry, Eye.RIGHT)
    return EpipolarImages(left.geometry, left.grey, left.mask, _read_only(grey), _read_only(mask))


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


@lru_cache(maxsize=PARALLAXES_KEPT)
def stored_parallax(parallax: ProductRef, store: ProductStore) -> StoredParallax:
    """The dense parallax of a pair, kept as it is stored."""
    return StoredParallax.read(store.path(parallax))


def clear_right_images() -> None:
    """Free the memory of the right images that are kept: maps need the left ones only."""
    read_epipolar.cache_clear()


def clear_images() -> None:
    """Free the memory of the images and parallaxes that are kept."""
    read_left.cache_clear()
    clear_right_images()
    stored_parallax.cache_clear()


def read_matched_pair(pair: PairProducts, store: ProductStore) -> MatchedPair:
    """A pair with its epipolar images and all its matches."""
    path = store.path(pair.matches)
    turn = read_right_turn(path)
    left = read_left(pair.files, turn, store)

    def read_right() -> tuple[GreyImage, Mask]:
        images = read_epipolar(pair.files, turn, store)
        return images.right, images.right_mask

    return MatchedPair(
        pair_id=pair.files.id,
        instrument=pair.files.instrument,
        geometry=left.geometry,
        left=left.grey,
        left_mask=left.mask,
        read_right=read_right,
        matches=read_matches(path)[1],
        parallax=stored_parallax(pair.parallax, store).parallax_px(),
        sun=left.record.sun,
    )


def read_matched_stop(
    telemetry: StopPrior,
    covariance: np.ndarray,
    pairs: Sequence[PairProducts],
    store: ProductStore,
) -> MatchedStop:
    """All matched pairs of a stop, with the pose of telemetry."""
    matched = tuple(read_matched_pair(pair, store) for pair in pairs)
    return MatchedStop(telemetry.stop, matched, telemetry.lsl_from_rover, covariance)
