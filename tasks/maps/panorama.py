"""Panorama: a mosaic of the images of a stop, with their adjusted orientations."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.archive.images.reading import ReadImage
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, single_image
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.rover_body import BODIES
from solmap.photogrammetry.terrain.orthophoto.colour import has_same_view
from solmap.photogrammetry.terrain.orthophoto.panorama import (
    Panorama,
    PanoramaImage,
    PanoramaParams,
    prepare_panorama,
)
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import StandingPlane
from solmap.photogrammetry.terrain.orthophoto.panorama_seams import registration
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import ImageFile, image_file, image_record, read_product_image
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.formats.documents.archives import read_matches, read_right_turn
from solmap.products.formats.raster.panorama import (
    Ground,
    blank_ground,
    brightness_blocks,
    write_panorama,
    write_panorama_ground,
)
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import pair_frame, turn_right_camera
from solmap.tasks.maps.dtms import read_stop_dtm
from solmap.tasks.maps.tags import raster_tags
from solmap.tasks.network.orientations import Orientation
from solmap.tasks.network.singles import ON_THE_MAST
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage

SUN_FILTER = 8
"""Pancam's solar filter, which transmits a hundred-thousandth."""


@dataclass(frozen=True, slots=True)
class OrientedFrame:
    """An image with its adjusted orientation."""

    id: str
    file: ImageFile
    matches: ProductRef | None
    """Matches of its pair; None for an image without partner."""
    orientation: Orientation

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """Its input products."""
        return (*self.file.inputs, *((self.matches,) if self.matches else ()))


def oriented_frames(
    entries: Iterable[ImageEntry],
    matches: Mapping[str, ProductRef],
    orientations: Iterable[Orientation],
    eye: Eye,
    workspace: Workspace,
) -> tuple[OrientedFrame, ...]:
    """The oriented images of one eye; only one of each pointing.

    Args:
        entries: The images of a stop.
        matches: Matches by pair.
        orientations: Of the stop's pairs and single images.
        eye: Which camera.
        workspace: To read labels from.
    """
    known = {orientation.pair_id: orientation for orientation in orientations}
    kept: list[RoverImage] = []
    frames = []
    once = (entry for entry in entries if entry.repeats is None)
    for entry in sorted(once, key=lambda entry: (entry.partner is None, entry.id)):
        pair = entry.id if entry.partner is None or entry.eye == Eye.LEFT else entry.partner
        if entry.instrument not in ON_THE_MAST or entry.eye != eye or pair not in known:
            continue
        image = image_record(entry, workspace)
        is_of_sun = image.instrument == "PANCAM" and image.filter_number == SUN_FILTER
        if is_of_sun or any(has_same_view(image, other) for other in kept):
            continue
        kept.append(image)
        frames.append(OrientedFrame(entry.id, image_file(entry), matches.get(pair), known[pair]))
    return tuple(frames)


@stage(task_run_name="panorama-{stop}")
def draw_panorama(
    stop: StopId,
    frames: tuple[OrientedFrame, ...],
    dtm: ProductRef | None,
    params: PanoramaParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Draw the panorama of a stop, and the distance to the ground in every direction."""
    inputs = (*((dtm,) if dtm else ()), *(ref for frame in frames for ref in frame.inputs))
    known = (params, landing, tuple(frame.orientation for frame in frames))
    origin = {"ORIGIN": landing.name} if landing.origin else {}
    panorama, ground = (
        Recipe(kind, stop_scope(stop), inputs, known)
        for kind in (ProductKind.PANORAMA, ProductKind.PANORAMA_GROUND)
    )

    @cache
    def prepare() -> tuple[Panorama, Ground]:
        made = _panorama(stop, frames, dtm, params, store)
        return made, blank_ground(made.grid)

    def write_image(path: Path) -> None:
        made, distances = prepare()
        pieces, tags = (
            brightness_blocks(made.blocks(), distances),
            raster_tags(panorama, store) | origin,
        )
        write_panorama(path, made, pieces, registration(made), ground.ref.digest, tags)

    def write_ground(path: Path) -> None:
        made, distances = prepare()
        if not np.isfinite(distances[1]).any():  # the panorama existed already
            deque(brightness_blocks(made.blocks(), distances), maxlen=0)
        write_panorama_ground(path, made, distances, raster_tags(ground, store) | origin)

    return store.make(panorama, write_image), store.make(ground, write_ground)


def _panorama(
    stop: StopId,
    frames: tuple[OrientedFrame, ...],
    dtm: ProductRef | None,
    params: PanoramaParams,
    store: ProductStore,
) -> Panorama:
    images, poses = [], []
    for frame in frames:
        one, lsl_from_rover = _read(frame, store)
        poses.append(lsl_from_rover)
        camera = one.image.camera.transform(lsl_from_rover)
        images.append(PanoramaImage.of(one.image.id, camera, one.pixels, one.mask))
    terrain = read_stop_dtm(dtm, store) if dtm else None
    return prepare_panorama(images, _standing_plane(poses[0], stop), params, terrain)


def _read(frame: OrientedFrame, store: ProductStore) -> tuple[ReadImage, Pose]:
    """An image with its pixels, and the adjusted pose of its label's rover frame."""
    read = read_product_image(frame.file, store)
    if frame.matches is None:
        geometry = _alone(read.image)
    else:
        path = store.path(frame.matches)
        geometry, _ = read_matches(path)
        if read.image.eye is Eye.RIGHT:
            read = turn_right_camera(read, read_right_turn(path))
    lsl_from_pair = frame.orientation.lsl_from(geometry.rover_from_pair.source)
    return read, lsl_from_pair @ geometry.rover_from_pair.inverse


def _alone(image: RoverImage) -> EpipolarPair:
    size = (image.samples, image.lines)
    return single_image(image.camera, size, image.stop.frame, pair_frame(image))


def _standing_plane(lsl_from_rover: Pose, stop: StopId) -> StandingPlane:
    """The plane under the wheels, in the local map."""
    body = BODIES.get(stop.mission)
    foot = np.array([[0.0, 0.0, body.ground_m if body else 0.0]])
    upright = MAP_FROM_LSL @ lsl_from_rover.rotation @ np.array([0.0, 0.0, -1.0])
    return StandingPlane(MAP_FROM_LSL @ lsl_from_rover.apply(foot)[0], upright)
