"""Wide: two pairs of different stops matched as one stereo instrument, for far ground."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from prefect import task
from prefect.cache_policies import NO_CACHE

from photogrammetry.imagery import Eye, StereoMatches
from photogrammetry.matching.resampling import resample
from photogrammetry.matching.wide_eyes import WideEye, in_order
from photogrammetry.matching.wide_stereo import WideMatches, WideParams, match_wide
from photogrammetry.terrain.records import TerrainView
from products.arrays import read_dense, read_matches, read_parallax, write_dense, write_matches
from products.model import ProductKind, ProductRef, Recipe
from products.store import ProductStore
from tasks.images import read_product_image
from tasks.scopes import pair_scope
from tasks.views import OrientedPair


@dataclass(frozen=True, slots=True)
class WidePair:
    """Two oriented pairs, and what was matched between their left images, as products."""

    eyes: tuple[OrientedPair, OrientedPair]
    matches: ProductRef
    """The geometry of the instrument, given in the LSL."""
    parallax: ProductRef

    @property
    def id(self) -> str:
        """Named after both pairs."""
        return wide_id(self.eyes)


def wide_id(eyes: tuple[OrientedPair, OrientedPair]) -> str:
    """The identifiers of both pairs."""
    return "-with-".join(eye.products.files.id for eye in eyes)


@task(cache_policy=NO_CACHE, task_run_name="wide-{one.orientation.pair_id}")
def match_wide_pair(
    one: OrientedPair, other: OrientedPair, params: WideParams, store: ProductStore
) -> WidePair:
    """Match the left images of two pairs at different stops, as they are oriented."""
    eyes = (one, other)

    @cache
    def matched() -> WideMatches:
        left, right = in_order(read_eye(one, store), read_eye(other, store))
        return match_wide(left, right, params)

    def write_geometry(path: Path) -> None:
        nothing = StereoMatches(wide_id(eyes), np.empty((0, 2)), np.empty(0), np.empty(0))
        write_matches(path, matched().images.geometry, nothing)

    def write_parallax(path: Path) -> None:
        write_dense(path, matched().dense)

    inputs = tuple(ref for eye in eyes for ref in eye.inputs)
    settings = (params, *(eye.orientation for eye in eyes))
    scope = pair_scope(wide_id(eyes))
    matches = Recipe(ProductKind.MATCHES, scope, inputs, settings)
    parallax = Recipe(ProductKind.PARALLAX, scope, inputs, settings)
    return WidePair(eyes, store.make(matches, write_geometry), store.make(parallax, write_parallax))


def read_eye(pair: OrientedPair, store: ProductStore) -> WideEye:
    """A pair as one eye of a wide instrument."""
    geometry, _ = read_matches(store.path(pair.products.matches))
    left = read_product_image(pair.products.files.left, store)
    lsl_from_pair = pair.orientation.lsl_from(geometry.rover_from_pair.source)
    return WideEye(
        pair_id=pair.products.files.id,
        image=left.pixels,
        mask=left.mask,
        camera=left.image.camera.moved(lsl_from_pair @ geometry.rover_from_pair.inverse),
        bar=geometry,
        lsl_from_bar=lsl_from_pair,
        parallax=read_parallax(store.path(pair.products.parallax)),
    )


def read_wide_view(pair: WidePair, store: ProductStore) -> TerrainView:
    """A wide pair as a look at the ground."""
    geometry, _ = read_matches(store.path(pair.matches))
    left, _ = in_order(*(read_eye(eye, store) for eye in pair.eyes))
    image, mask = resample(left.image, left.mask, left.camera, geometry, Eye.LEFT)
    dense = read_dense(store.path(pair.parallax))
    return TerrainView(
        pair_id=pair.id,
        instrument=pair.eyes[0].products.files.instrument,
        lsl_from_pair=geometry.rover_from_pair,
        geometry=geometry,
        parallax=dense.parallax_px,
        image=image,
        mask=mask,
        sigma_px=dense.sigma_px,
    )
