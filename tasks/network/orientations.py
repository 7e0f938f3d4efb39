"""Oriented stereo pairs for mapping, and the decision to map a stop again.

Every adjustment changes orientations: new ties change the pointing of old stops too, mostly by
millimetres. Maps are not made again for that. The orientations used for mapping a mission's stops
are a separate product, one per network: made only from the network and the previous orientations,
so that the same networks lead to the same maps, independent of interruptions, repetitions and
publications. Stops that a network did not change are mapped as before: its product refers to those
that contain them.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from threading import Condition
from typing import Any

import numpy as np
from cachetools import LRUCache, cached

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedPair
from solmap.photogrammetry.adjustment.quality.movement import ReissueParams, ground_shift_m
from solmap.photogrammetry.arrays import ParallaxMap
from solmap.photogrammetry.frames import LSL, Frame, Pose
from solmap.photogrammetry.matching.height_bias import NO_BIAS, HeightBias
from solmap.photogrammetry.matching.records import SharedSigma
from solmap.photogrammetry.terrain.dtm.records import PoseCovariance, TerrainView
from solmap.photogrammetry.terrain.dtm.rover_body import mask_rover
from solmap.photogrammetry.threads import in_threads
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import read_matches, read_right_turn
from solmap.products.formats.documents.network import (
    References,
    read_network,
    references_document,
    references_of_document,
)
from solmap.products.formats.documents.rig import RigProduct, read_rig
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import (
    PAIRS_KEPT,
    PairProducts,
    read_left,
    stored_parallax,
)
from solmap.tasks.scopes import is_of_mission, sol_of
from solmap.tasks.stage import stage


@dataclass(frozen=True, slots=True)
class Orientation:
    """Pose of a pair for mapping: plain numbers, so that they are part of a product's recipe.

    A terrain model depends on the orientations of its own pairs and not on their network, so it
    stays valid while a later network does not change them.
    """

    pair_id: str
    rotation: tuple[float, ...]
    """`lsl_from_pair`, row by row."""
    translation_m: tuple[float, ...]
    covariance: tuple[float, ...] = ()
    """Covariance of rotation vector (radians) and position (metres) in the LSL, row by row: stop
    and pointing together, relative to the held stop. Empty: the orientation is treated as exact."""
    toe_in_sigma: float = 0.0
    """Standard deviation of the stereo rig's toe-in, radians, common to all pairs of a camera."""
    height_bias: HeightBias = NO_BIAS
    """Height bias of the ground around the stop."""

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
        """The covariance as a matrix; None where the orientation is treated as exact."""
        return np.array(self.covariance).reshape(6, 6) if self.covariance else None

    def lsl_from(self, pair: Frame) -> Pose:
        """The orientation as the pose of a pair's frame."""
        rotation = np.array(self.rotation).reshape(3, 3)
        return Pose(LSL, pair, rotation, np.array(self.translation_m))


@dataclass(frozen=True, slots=True)
class OrientedPair:
    """A matched pair with its orientation."""

    products: PairProducts
    orientation: Orientation

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The input products of mapping."""
        return (*self.products.files.left.inputs, *self.products.made)


def inputs_of(pairs: Iterable[OrientedPair]) -> tuple[ProductRef, ...]:
    """All input products of mapping with these pairs."""
    return tuple(ref for pair in pairs for ref in pair.inputs)


def read_views(
    pairs: Iterable[OrientedPair], store: ProductStore, *, sigmas: bool
) -> list[TerrainView]:
    """The views of some pairs, with or without the standard deviation of every parallax."""
    return in_threads(lambda pair: _read_view(pair, store, sigmas=sigmas), pairs)


def clear_views() -> None:
    """Free the memory of the views that are kept, 5 MB each without their images."""
    _read_in_place.cache_clear()


def _read_view(pair: OrientedPair, store: ProductStore, *, sigmas: bool) -> TerrainView:
    view = _read_in_place(pair.products, store)
    toe_in = SharedSigma(view.geometry.focal_px * pair.orientation.toe_in_sigma)
    return replace(
        view,
        lsl_from_pair=pair.orientation.lsl_from(view.geometry.rover_from_pair.source),
        sigma_px=_sigma_px(pair.products, toe_in, store) if sigmas else None,
        shared=toe_in,
        covariance=pair.orientation.covariance_6x6,
        height_bias=pair.orientation.height_bias,
    )


def _sigma_px(products: PairProducts, toe_in: SharedSigma, store: ProductStore) -> ParallaxMap:
    """Standard deviation of the parallax of a pair, by matching and by the rig's toe-in."""
    sigma_px = stored_parallax(products.parallax, store).sigma_px()
    return np.sqrt(sigma_px * sigma_px + np.float32(toe_in.offset_px**2))


@cached(LRUCache(PAIRS_KEPT), condition=Condition())  # for maps, models and points of a stop
def _read_in_place(products: PairProducts, store: ProductStore) -> TerrainView:
    """The view of a pair at the origin; read only.

    Only the left image is used: the right one is represented by the parallax.
    """
    files, path = products.files, store.path(products.matches)
    geometry, _ = read_matches(path)
    left = read_left(files, read_right_turn(path), store)
    view = TerrainView(
        pair_id=files.id,
        instrument=files.instrument,
        lsl_from_pair=Pose.identity(LSL, geometry.rover_from_pair.source),
        geometry=geometry,
        parallax=stored_parallax(products.parallax, store).parallax_px(),
        image=left.grey,
        mask=left.mask,
    )
    view = mask_rover(view, files.stop.mission)
    for array in (view.parallax, view.image, view.mask):
        array.setflags(write=False)
    return view


@dataclass(frozen=True, slots=True)
class MappedStop:
    """Orientations used for mapping a stop, and the reason."""

    stop: str
    orientations: tuple[Orientation, ...]
    moved_m: float | None
    """Largest movement of ground by the adjustment, relative to the existing maps; None: new."""
    is_new: bool
    """Whether its orientations differ from those of the previous network."""
    toe_in_sigmas: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of the toe-in of its stereo rigs, radians, by camera set."""
    height_bias: HeightBias = NO_BIAS
    """Height bias of its ground, from its links."""


@stage(task_run_name="orientations-{network.scope}")
def choose_orientations(
    network: ProductRef,
    previous: ProductRef | None,
    params: ReissueParams,
    store: ProductStore,
    rig: ProductRef | None = None,
) -> ProductRef:
    """Use the network's orientations for the stops that moved; keep those of the others."""

    def write(path: Path) -> None:
        rigs = read_rig(store.path(rig)) if rig else RigProduct()
        product = read_network(network, store)
        by_stop: dict[str, list[AdjustedPair]] = {}
        for pair in product.adjusted.pairs:
            by_stop.setdefault(str(pair.stop), []).append(pair)
        before = read_orientations(previous, store, by_stop) if previous else {}
        chosen = [
            choose_for_stop(
                stop,
                pairs,
                before.get(stop),
                params,
                rigs.toe_in_sigmas(stop),
                height_bias_of(stop, product.links),
            )
            for stop, pairs in by_stop.items()
        ]
        known = orientation_references(previous, store) if previous else {}
        holders = {stop: ref for stop, ref in known.items() if stop not in by_stop}
        document = {
            "mapped": [asdict(mapped) for mapped in chosen],
            "holders": references_document(holders),
        }
        path.write_text(json.dumps(document))

    inputs = tuple(ref for ref in (network, previous, rig) if ref)
    return store.make(Recipe(ProductKind.ORIENTATIONS, network.scope, inputs, params), write)


def choose_for_stop(
    stop: str,
    pairs: list[AdjustedPair],
    before: MappedStop | None,
    params: ReissueParams,
    toe_in_sigmas: Mapping[str, float] | None = None,
    height_bias: HeightBias = NO_BIAS,
) -> MappedStop:
    """Orientations for mapping a stop: all of its adjusted pairs, or all as mapped before."""
    adjusted = tuple(Orientation.of(pair) for pair in sorted(pairs, key=lambda p: p.pair_id))
    sigmas = toe_in_sigmas or {}
    new = MappedStop(
        stop, adjusted, None, is_new=True, toe_in_sigmas=sigmas, height_bias=height_bias
    )
    old = {o.pair_id: o for o in before.orientations} if before else {}
    if before is None or old.keys() != {o.pair_id for o in adjusted}:
        return new
    moved_m = max(
        ground_shift_m(
            old[pair.pair_id].lsl_from(pair.lsl_from_pair.source),
            pair.lsl_from_pair,
            params.range_m,
        )
        for pair in pairs
    )
    if moved_m > params.shift_m or height_bias.differs_from(before.height_bias):
        return replace(new, moved_m=moved_m)
    return replace(before, moved_m=moved_m, is_new=False)


def height_bias_of(stop: str, links: Iterable[Mapping[str, Any]]) -> HeightBias:
    """Height bias of the ground of a stop, from all of its links."""
    figures = [link["figures"] for link in links if stop in (link["earlier"], link["later"])]
    return HeightBias.pooled(
        (_bias(one, "height_bias"), _bias(one, "expected_bias"))
        for one in figures
        if one.get("height_bias_sigma") and one.get("expected_bias_sigma")
    )


def _bias(figures: Mapping[str, Any], kind: str) -> HeightBias:
    return HeightBias(figures[f"{kind}_lines"], figures[f"{kind}_sigma"])


def read_orientations(
    ref: ProductRef, store: ProductStore, stops: Collection[str] | None = None
) -> dict[str, MappedStop]:
    """The orientations for mapping stops, by their names.

    Args:
        ref: Orientations of a network's own stops.
        store: The product store.
        stops: Further requested stops; None for all of the mission.
    """
    own, holders = _read(ref, store)
    by_product: dict[ProductRef, list[str]] = {}
    for stop in holders if stops is None else stops:
        if stop in holders:
            by_product.setdefault(holders[stop], []).append(stop)
    further: dict[str, MappedStop] = {}
    for holder, names in by_product.items():
        held, _ = _read(holder, store)
        further |= {name: _untouched_stop(held[name]) for name in names}
    return further | own


def orientation_references(ref: ProductRef, store: ProductStore) -> References:
    """The products with the orientations of each stop of a mission."""
    own, holders = _read(ref, store)
    return holders | dict.fromkeys(own, ref)


def _read(ref: ProductRef, store: ProductStore) -> tuple[dict[str, MappedStop], References]:
    document = json.loads(store.path(ref).read_text())
    # format of earlier versions
    rows = document["mapped"] if isinstance(document, dict) else document
    holders = references_of_document(document["holders"]) if isinstance(document, dict) else {}
    return {row["stop"]: _mapped_of(row) for row in rows}, holders


def _mapped_of(row: dict[str, Any]) -> MappedStop:
    orientations = tuple(
        Orientation(
            o["pair_id"],
            tuple(o["rotation"]),
            tuple(o["translation_m"]),
            tuple(o.get("covariance", ())),
        )
        for o in row["orientations"]
    )
    sigmas = row.get("toe_in_sigmas", {})
    bias = HeightBias(**row.get("height_bias", {}))
    return MappedStop(row["stop"], orientations, row["moved_m"], row["is_new"], sigmas, bias)


def _untouched_stop(before: MappedStop) -> MappedStop:
    """A stop that the network has not changed."""
    return replace(before, moved_m=0.0, is_new=False)


@dataclass(frozen=True, slots=True)
class Standing:
    """State passed to the next adjustment: the network, and the orientations for mapping."""

    network: ProductRef
    orientations: ProductRef
    rig: ProductRef | None = None
    """Estimates of the stereo rigs."""


def standing_of(network: ProductRef, workspace: Workspace) -> Standing | None:
    """A published network with its orientations."""
    kind = ProductKind.ORIENTATIONS
    digest = workspace.catalogue.latest(network.scope.name, kind)
    rig = latest_rig(network.scope.name.rpartition("-sol")[0], workspace, sol_of(network.scope))
    return Standing(network, ProductRef(kind, network.scope, digest), rig) if digest else None


def latest_rig(mission: str, workspace: Workspace, sol: int | None = None) -> ProductRef | None:
    """The latest estimates of a mission's stereo rigs, up to a sol if given."""
    refs = [
        ref
        for ref in workspace.catalogue.pointers(ProductKind.RIG)
        if is_of_mission(ref.scope, mission) and (sol is None or sol_of(ref.scope) <= sol)
    ]
    return max(refs, key=lambda ref: sol_of(ref.scope), default=None)


def orient_pairs(pairs: list[PairProducts], mapped: MappedStop | None) -> tuple[OrientedPair, ...]:
    """The pairs of a stop in the network, with their orientations for mapping."""
    known = {o.pair_id: o for o in mapped.orientations} if mapped else {}
    sigmas, bias = (mapped.toe_in_sigmas, mapped.height_bias) if mapped else ({}, NO_BIAS)

    def oriented(pair: PairProducts) -> Orientation:
        toe_in_sigma = sigmas.get(pair.files.instrument, 0.0)
        return replace(known[pair.files.id], toe_in_sigma=toe_in_sigma, height_bias=bias)

    return tuple(OrientedPair(p, oriented(p)) for p in pairs if p.files.id in known)
