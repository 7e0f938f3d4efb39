"""Far ground: pairs of two stops matched as one wide-baseline stereo rig, and its terrain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.arrays import ObjectPoints, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye, StereoMatches, StopId
from solmap.photogrammetry.matching.resampling import resample
from solmap.photogrammetry.matching.stereo.wide_baseline import (
    WideBaselineImage,
    WideBaselineMatches,
    WideParams,
    match_wide_baseline,
    order_left_right,
    select_wide_pairs,
)
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.dtm.stop_dtm import FarDtmParams
from solmap.photogrammetry.terrain.dtm.stop_dtm import build_dtm as model_terrain
from solmap.products.catalogue.images import read_product_image
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.documents.archives import (
    StoredParallax,
    read_matches,
    write_dense,
    write_matches,
)
from solmap.products.formats.raster.raster import write_dtm
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import stored_parallax
from solmap.tasks.maps.tags import raster_tags
from solmap.tasks.network.orientations import OrientedPair, inputs_of
from solmap.tasks.scopes import pair_scope, stop_scope
from solmap.tasks.stage import stage

FEWEST_SHARED = 10
"""Fewest matches of far ground of one image that the other must show."""


@dataclass(frozen=True, slots=True)
class WidePair:
    """Two oriented pairs, and the matches between their left images, as products."""

    eyes: tuple[OrientedPair, OrientedPair]
    matches: ProductRef
    """The epipolar geometry of the wide pair, in the LSL."""
    parallax: ProductRef

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The input products of mapping."""
        return (*inputs_of(self.eyes), self.matches, self.parallax)

    @property
    def id(self) -> str:
        """Named after both pairs."""
        return wide_id(self.eyes)


def wide_id(eyes: tuple[OrientedPair, OrientedPair]) -> str:
    """The identifiers of both pairs."""
    return "-with-".join(eye.products.files.id for eye in eyes)


def choose_wide_pairs(
    ones: Iterable[OrientedPair],
    others: Iterable[OrientedPair],
    params: WideParams,
    store: ProductStore,
) -> list[tuple[OrientedPair, OrientedPair]]:
    """The wide-baseline pairs of two stops that share far ground, chosen by their matches only."""
    sides: tuple[dict[str, list[_Outlook]], ...] = ({}, {})
    for side, pairs in zip(sides, (ones, others), strict=True):
        for pair in pairs:
            instrument = pair.products.files.instrument
            if "HAZCAM" not in instrument:  # hazard cameras look at the ground before the wheels
                side.setdefault(instrument, []).append(_Outlook.of(pair, store))
    return [
        (one.pair, other.pair)
        for instrument in sorted(sides[0].keys() & sides[1].keys())
        for one, other in select_wide_pairs(
            sides[0][instrument], sides[1][instrument], params.limits
        )
        if one.shares_far_ground(other, params.nearest_bases)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Outlook:
    """Position and view direction of an oriented pair, and the ground of its matches."""

    pair: OrientedPair
    geometry: EpipolarPair
    lsl_from_pair: Pose
    centre: Vector3
    view: Vector3
    ground: ObjectPoints
    """In the LSL, metres."""

    @classmethod
    def of(cls, pair: OrientedPair, store: ProductStore) -> _Outlook:
        geometry, matches = read_matches(store.path(pair.products.matches))
        pose = pair.orientation.lsl_from(geometry.rover_from_pair.source)
        half = np.array([(geometry.samples - 1) / 2, (geometry.lines - 1) / 2])
        ray = np.r_[(half - geometry.centre_px) / geometry.focal_px, 1.0]
        view = pose.rotation @ ray / np.linalg.norm(ray)
        ground = pose.apply(geometry.triangulate(matches.left, matches.parallax_px))
        return cls(pair, geometry, pose, pose.translation_m, view, ground)

    def shares_far_ground(self, other: _Outlook, nearest_bases: float) -> bool:
        """Whether the other image shows enough of this one's matches that are far enough away."""
        least_m = nearest_bases * np.linalg.norm(other.centre - self.centre)
        far = self.ground[np.linalg.norm(self.ground - self.centre, axis=1) >= least_m]
        image_points, _ = other.geometry.project(other.lsl_from_pair.inverse.apply(far))
        return int(other.geometry.shows(image_points).sum()) >= FEWEST_SHARED


@stage(task_run_name="wide-{one.orientation.pair_id}")
def match_wide_pair(
    one: OrientedPair, other: OrientedPair, params: WideParams, store: ProductStore
) -> WidePair:
    """Match the left images of two pairs at different stops, with their orientations."""
    eyes = (one, other)

    @cache
    def match() -> WideBaselineMatches:
        left, right = order_left_right(read_eye(one, store), read_eye(other, store))
        return match_wide_baseline(left, right, params)

    def write_geometry(path: Path) -> None:
        write_matches(path, match().images.geometry, StereoMatches.none(wide_id(eyes)))

    def write_parallax(path: Path) -> None:
        write_dense(path, match().dense)

    inputs = inputs_of(eyes)
    settings = (params, *(eye.orientation for eye in eyes))
    scope = pair_scope(wide_id(eyes))
    matches = Recipe(ProductKind.MATCHES, scope, inputs, settings)
    parallax = Recipe(ProductKind.PARALLAX, scope, inputs, settings)
    return WidePair(eyes, store.make(matches, write_geometry), store.make(parallax, write_parallax))


def read_eye(pair: OrientedPair, store: ProductStore) -> WideBaselineImage:
    """A pair as one image of a wide-baseline pair."""
    geometry, _ = read_matches(store.path(pair.products.matches))
    left = read_product_image(pair.products.files.left, store)
    lsl_from_pair = pair.orientation.lsl_from(geometry.rover_from_pair.source)
    return WideBaselineImage(
        pair_id=pair.products.files.id,
        image=left.pixels,
        mask=left.mask,
        camera=left.image.camera.transform(lsl_from_pair @ geometry.rover_from_pair.inverse),
        rig=geometry,
        lsl_from_rig=lsl_from_pair,
        parallax=stored_parallax(pair.products.parallax, store).parallax_px(),
    )


def read_wide_view(pair: WidePair, store: ProductStore) -> TerrainView:
    """A wide pair as a view of the ground."""
    geometry, _ = read_matches(store.path(pair.matches))
    left, _ = order_left_right(*(read_eye(eye, store) for eye in pair.eyes))
    of_left = next(eye for eye in pair.eyes if eye.products.files.id == left.pair_id)
    image, mask = resample(left.image, left.mask, left.camera, geometry, Eye.LEFT)
    dense = StoredParallax.read(store.path(pair.parallax)).dense()
    return TerrainView(
        pair_id=pair.id,
        instrument=pair.eyes[0].products.files.instrument,
        lsl_from_pair=geometry.rover_from_pair,
        geometry=geometry,
        parallax=dense.parallax_px,
        image=image,
        mask=mask,
        sigma_px=dense.sigma_px,
        shared=dense.shared,
        covariance=of_left.orientation.covariance_6x6,
    )


@stage(task_run_name="far-dtm-{stop}")
def build_far_dtm(
    stop: StopId,
    pairs: tuple[WidePair, ...],
    params: FarDtmParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Build the terrain model of the far ground seen by a stop together with earlier ones."""
    inputs = tuple(ref for pair in pairs for ref in pair.inputs)
    recipe = Recipe(ProductKind.FAR_DTM, stop_scope(stop), inputs, (params, landing))

    def write(path: Path) -> None:
        made = model_terrain([read_wide_view(pair, store) for pair in pairs], params)
        write_dtm(path, made, local_crs(landing), tags=raster_tags(recipe, store))

    return store.make(recipe, write)
