"""Images with the orientations of the latest adjusted network, and their stereo partners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedPair
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId
from solmap.photogrammetry.matching.records import DenseMatches
from solmap.photogrammetry.matching.stereo.orientation import turn_in_place
from solmap.photogrammetry.terrain.measure.oriented_image import (
    OrientedImage,
    Pointing,
    StopPose,
)
from solmap.products.catalogue.catalogue import ImageEntry, latest_network
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.archives import (
    StoredParallax,
    read_matches,
    read_right_turn,
)
from solmap.products.formats.documents.network import NetworkProduct, cached_whole_network
from solmap.products.model import ProductKind, ProductRef, Scope, ScopeLevel

_CACHED_NETWORKS = 2
_CACHED_MATCHES = 20
"""Pairs whose dense matches are kept in memory, about 8 MB each."""
_CACHED_IMAGES = 4096
"""Oriented images kept in memory, 4 kB each; never invalidated, because networks and images never
change."""
_ORIENTED: dict[tuple[Path, ProductRef, ImageEntry], OrientedImage] = {}
_LABEL_POINTING_SIGMA = float(np.radians(AdjustmentParams().pointing_deg))
"""Standard deviation of a pointing from a label, radians."""


@dataclass(frozen=True, slots=True, eq=False)
class StereoPartners:
    """The stereo pair of an image: geometry, cameras and dense matches."""

    pair_id: str
    geometry: EpipolarPair
    left: CameraModel
    """Camera model of the stored left image from its label, in the rover frame."""
    right: CameraModel
    """The same for the right image, with its correction from matching."""
    dense: DenseMatches

    def camera(self, eye: str) -> CameraModel:
        """The camera of one eye."""
        return self.right if eye == Eye.RIGHT else self.left


@dataclass(frozen=True, slots=True, eq=False)
class OrientedMission:
    """The images of a mission, oriented with the latest network."""

    ref: ProductRef
    """Reference to the network product."""
    network: NetworkProduct
    stops: Mapping[StopId, StopPose]
    """Poses of the stops, in the order of the traverse."""
    pairs: Mapping[str, AdjustedPair]
    """Adjusted pairs and single images, by identifier."""
    workspace: Workspace

    @classmethod
    def latest(cls, mission: str, workspace: Workspace) -> OrientedMission:
        """The mission with its latest adjustment.

        Raises:
            ProductNotFoundError: it has not been adjusted yet.
        """
        ref = latest_network(mission, workspace.catalogue)
        network = cached_whole_network(ref, workspace.store)
        return cls(ref, network, *_stops_and_pairs(network), workspace)

    def pair_of(self, entry: ImageEntry) -> AdjustedPair | None:
        """The adjusted pair, or single image, of an image."""
        return self.pairs.get(entry.id) or self.pairs.get(entry.partner or "")

    def record(self, entry: ImageEntry) -> RoverImage:
        """The image's record.

        If it is a right image, its camera is corrected by the rotation found in matching.
        """
        return matched_record(entry, self.workspace)

    def oriented_image(self, entry: ImageEntry) -> OrientedImage:
        """The image with its camera in the LSL, oriented by the latest network.

        Raises:
            ProductNotFoundError: its stop is not in the network.
        """
        key = (self.workspace.store.root, self.ref, entry)
        known = _ORIENTED.get(key)
        if known is None:
            known = _ORIENTED[key] = self._orient(entry)
            while len(_ORIENTED) > _CACHED_IMAGES:
                _ORIENTED.pop(next(iter(_ORIENTED)), None)
        return known

    def _orient(self, entry: ImageEntry) -> OrientedImage:
        pose = self.stops.get(entry.stop_id)
        if pose is None:
            raise ProductNotFoundError(
                f"{entry.id} was taken at {entry.stop}, which is not in the latest network of "
                f"{entry.mission}; process sol {entry.sol} of the mission (`solmap run`)"
            )
        pair = self.pair_of(entry)
        if pair is None:
            return OrientedImage.of(
                self.record(entry), pose, Pointing.of_label(_LABEL_POINTING_SIGMA)
            )
        pointing = Pointing(pair.pointing, pair.pointing_covariance)
        return OrientedImage.of(self.record(entry), pose, pointing)

    def stereo_partners(self, entry: ImageEntry) -> StereoPartners | None:
        """The matched pair of an image; None if it has no partner or was not matched."""
        return stereo_partners(entry, self.workspace)


def matched_record(entry: ImageEntry, workspace: Workspace) -> RoverImage:
    """An image's record.

    If it is a right image, its camera is corrected by the rotation found in matching.
    """
    image = image_record(entry, workspace)
    matches = matches_of(entry, workspace) if entry.eye == Eye.RIGHT else None
    rotation = _right_rotation(workspace.store.path(matches)) if matches else None
    if rotation is None:
        return image
    camera = turn_in_place(image.camera, image.stop.frame, np.array(rotation))
    return replace(image, camera=camera)


def matches_of(entry: ImageEntry, workspace: Workspace) -> ProductRef | None:
    """The matches of an image's pair; None if there are none."""
    pair_id = entry.id if entry.eye == Eye.LEFT else entry.partner
    scope = Scope(ScopeLevel.PAIR, (pair_id or "").lower())
    digest = workspace.catalogue.latest(scope.name, ProductKind.MATCHES)
    return None if digest is None else ProductRef(ProductKind.MATCHES, scope, digest)


def geometry_of(matches: ProductRef, workspace: Workspace) -> EpipolarPair:
    """The geometry in which a pair was matched."""
    return _geometry(workspace.store.path(matches))


def stereo_partners(entry: ImageEntry, workspace: Workspace) -> StereoPartners | None:
    """The matched pair of an image; None if it has no partner or was not matched."""
    matches = matches_of(entry, workspace)
    if matches is None or entry.partner is None:
        return None
    digest = workspace.catalogue.latest(matches.scope.name, ProductKind.PARALLAX)
    if digest is None:
        return None
    other = workspace.catalogue.image(entry.partner)
    left, right = (entry, other) if entry.eye == Eye.LEFT else (other, entry)
    parallax = ProductRef(ProductKind.PARALLAX, matches.scope, digest)
    return StereoPartners(
        left.id,
        geometry_of(matches, workspace),
        matched_record(left, workspace).camera,
        matched_record(right, workspace).camera,
        _dense(workspace.store.path(parallax)),
    )


@lru_cache(maxsize=_CACHED_NETWORKS)
def _stops_and_pairs(
    network: NetworkProduct,
) -> tuple[dict[StopId, StopPose], dict[str, AdjustedPair]]:
    """Stops in the order of the traverse, and pairs by identifier, of a network."""
    adjusted = network.adjusted
    stops = {s.stop: StopPose(s.stop, s.lsl_from_rover, s.covariance) for s in adjusted.stops}
    return stops, {pair.pair_id: pair for pair in adjusted.pairs}


@lru_cache(maxsize=1024)
def _geometry(path: Path) -> EpipolarPair:
    return read_matches(path)[0]


@lru_cache(maxsize=1024)
def _right_rotation(path: Path) -> tuple[float, float, float] | None:
    return read_right_turn(path)


@lru_cache(maxsize=_CACHED_MATCHES)
def _dense(path: Path) -> DenseMatches:
    return StoredParallax.read(path).dense()
