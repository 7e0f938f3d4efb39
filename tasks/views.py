"""Oriented stereo pairs: what adjustment hands to mapping."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedPair
from solmap.photogrammetry.frames import LSL, Frame, Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.resampling import resample
from solmap.photogrammetry.terrain.dtm.records import PoseCovariance, TerrainView
from solmap.photogrammetry.terrain.dtm.rover_body import without_rover
from solmap.products.catalogue.images import read_product_image
from solmap.products.formats.documents.archives import read_dense, read_matches
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore
from solmap.tasks.pairs import PairProducts


@dataclass(frozen=True, slots=True)
class Orientation:
    """Where a pair looks from: plain numbers, so that they are part of a product's recipe.

    A terrain model depends on the orientations of its own pairs and not on the network they come
    from; so a later stop that leaves them as they were leaves the model as it was.
    """

    pair_id: str
    rotation: tuple[float, ...]
    """`lsl_from_pair`, row by row."""
    translation_m: tuple[float, ...]
    covariance: tuple[float, ...] = ()
    """Of rotation vector (radians) and position (metres) in the LSL, row by row: stop and pointing
    together, against the held stop. Empty: the orientation is taken for true."""

    @classmethod
    def of(cls, pair: AdjustedPair) -> Orientation:
        """The adjusted orientation of a pair."""
        pose = pair.lsl_from_pair
        return cls(
            pair.pair_id,
            tuple(pose.rotation.ravel().tolist()),
            tuple(pose.translation_m.tolist()),
            tuple(pair.covariance.ravel().tolist()),
        )

    @property
    def covariance_6x6(self) -> PoseCovariance | None:
        """The covariance as a matrix; None where the orientation is taken for true."""
        return np.array(self.covariance).reshape(6, 6) if self.covariance else None

    def lsl_from(self, pair: Frame) -> Pose:
        """The orientation as the pose of a pair's frame."""
        rotation = np.array(self.rotation).reshape(3, 3)
        return Pose(LSL, pair, rotation, np.array(self.translation_m))


@dataclass(frozen=True, slots=True)
class OrientedPair:
    """A matched pair and where it looks from."""

    products: PairProducts
    orientation: Orientation

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The products that mapping reads."""
        return (*self.products.files.left.inputs, *self.products.made)


def inputs_of(pairs: Iterable[OrientedPair]) -> tuple[ProductRef, ...]:
    """All products that mapping with these pairs reads."""
    return tuple(ref for pair in pairs for ref in pair.inputs)


def read_views(pairs: Iterable[OrientedPair], store: ProductStore) -> list[TerrainView]:
    """The pairs as looks at the ground."""
    return [_read_view(pair, store) for pair in pairs]


def _read_view(pair: OrientedPair, store: ProductStore) -> TerrainView:
    """Only the left image is resampled: the right one has given its parallax."""
    files = pair.products.files
    geometry, _ = read_matches(store.path(pair.products.matches))
    left = read_product_image(files.left, store)
    dense = read_dense(store.path(pair.products.parallax))
    image, mask = resample(left.pixels, left.mask, left.image.camera, geometry, Eye.LEFT)
    view = TerrainView(
        pair_id=files.id,
        instrument=files.instrument,
        lsl_from_pair=pair.orientation.lsl_from(geometry.rover_from_pair.source),
        geometry=geometry,
        parallax=dense.parallax_px,
        image=image,
        mask=mask,
        sigma_px=dense.sigma_px,
        covariance=pair.orientation.covariance_6x6,
    )
    return without_rover(view, files.stop.mission)
