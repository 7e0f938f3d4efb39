"""Tie: join the pairs of a stop, and stops with each other."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Condition
from typing import Any

import numpy as np
from cachetools import LRUCache, cached

from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.adjustment.modes.rig_pooling import add_toe_in
from solmap.photogrammetry.frames import Frame, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import (
    CrossSiteParams,
    prepare_stop,
    tie_cross_site,
)
from solmap.photogrammetry.matching.cross_site.links import SiteLink
from solmap.photogrammetry.matching.cross_site.parts import merge_ground
from solmap.photogrammetry.matching.inter_stereo import (
    InterStereoParams,
    PairTies,
    point_pairs,
    tie_inter_stereo,
)
from solmap.photogrammetry.matching.records import MatchedStop
from solmap.products.formats.documents.archives import (
    finite,
    pose_document,
    pose_of_document,
    read_ties,
    write_ties,
)
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairProducts, read_matched_stop
from solmap.tasks.network.previews import write_link_preview, write_ties_preview
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage

STOPS_KEPT = 3
"""Stops that a process keeps, read and prepared, 200 MB each: a new one, and those that two links
at a time join to it."""


@dataclass(frozen=True, slots=True)
class PlainPose:
    """A pose as plain numbers, so that it can be part of a recipe."""

    rotation: tuple[float, ...]
    translation_m: tuple[float, ...]

    @classmethod
    def of(cls, pose: Pose) -> PlainPose:
        """A pose without its frames."""
        return cls(tuple(pose.rotation.ravel().tolist()), tuple(pose.translation_m.tolist()))

    def between(self, target: Frame, source: Frame) -> Pose:
        """The pose between two frames."""
        rotation = np.array(self.rotation).reshape(3, 3)
        return Pose(target, source, rotation, np.array(self.translation_m))


@dataclass(frozen=True, slots=True)
class StopProducts:
    """A stop with its matched pairs: input of tying."""

    stop: StopId
    pairs: tuple[PairProducts, ...]
    toe_in_sigmas: tuple[tuple[str, float], ...] = ()
    """Standard deviation of toe-in, radians, by camera set, where relevant for links."""
    ties: ProductRef | None = None
    """Inter-stereo ties, by which links correct its pairs' pointing; None: as labelled."""
    beside: tuple[tuple[StopProducts, PlainPose], ...] = ()
    """Stops whose ground is merged with its own for linking, with their poses in its rover
    frame."""

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The input products of tying."""
        return tuple(ref for pair in self.pairs for ref in pair.made)


@stage(task_run_name="tie-{stop.stop}")
def tie_stop(
    stop: StopProducts,
    telemetry: StopPrior,
    params: InterStereoParams,
    store: ProductStore,
    *,
    previews: bool = False,
) -> ProductRef:
    """Tie every two overlapping pairs of a stop."""

    @cache
    def tie_pairs() -> tuple[MatchedStop, PairTies]:
        matched = _read_stop(stop, telemetry, store)
        return matched, tie_inter_stereo(matched, params)

    def write(path: Path) -> None:
        found = tie_pairs()[1]
        write_ties(path, found.ties, _figures_of_stop(found))

    def write_preview(path: Path) -> None:
        matched, found = tie_pairs()
        write_ties_preview(path, matched, found.ties, params.alignment)

    scope = stop_scope(stop.stop)
    ties = store.make(Recipe(ProductKind.TIES, scope, stop.inputs, params), write)
    if previews:
        store.make(Recipe(ProductKind.QUICKLOOK, scope, (ties,)), write_preview)
    return ties


@stage(task_run_name="link-{earlier.stop}-{later.stop}")
def link_stops(  # noqa: PLR0913 - two stops, each with telemetry
    earlier: StopProducts,
    later: StopProducts,
    earlier_telemetry: StopPrior,
    later_telemetry: StopPrior,
    params: CrossSiteParams,
    store: ProductStore,
    *,
    previews: bool = False,
) -> ProductRef:
    """Link two stops by their common ground, or give the reason why not."""

    @cache
    def tie_sites() -> tuple[StopViews, StopViews, SiteLink]:
        one, other = (
            _prepared(stop, telemetry, params, store)
            for stop, telemetry in ((earlier, earlier_telemetry), (later, later_telemetry))
        )
        return one, other, tie_cross_site(one, other, params)

    def write(path: Path) -> None:
        one, other, link = tie_sites()
        sigmas_px = _toe_in_px(one.stop, earlier) | _toe_in_px(other.stop, later)
        ties = add_toe_in(link.ties, sigmas_px)
        write_ties(path, ties, _figures_of_link(link, (earlier, later)))

    recipe = links_recipe(earlier, later, earlier_telemetry, later_telemetry, params)
    links = store.make(recipe, write)
    if previews:
        store.make(
            Recipe(ProductKind.QUICKLOOK, recipe.scope, (links,)),
            lambda path: write_link_preview(path, *tie_sites(), params),
        )
    return links


def prepare_to_link(
    stop: StopProducts, telemetry: StopPrior, params: CrossSiteParams, store: ProductStore
) -> None:
    """Prepare a stop for links that this process will make soon."""
    _prepared(stop, telemetry, params, store)


def links_recipe(
    earlier: StopProducts,
    later: StopProducts,
    earlier_telemetry: StopPrior,
    later_telemetry: StopPrior,
    params: CrossSiteParams,
) -> Recipe:
    """Everything that determines the link of two stops."""
    telemetry = (earlier_telemetry, later_telemetry)
    poses = [PlainPose.of(prior.lsl_from_rover) for prior in telemetry]
    poses += [place for stop in (earlier, later) for _, place in stop.beside]
    stops = [*_merged(earlier), *_merged(later)]
    inputs = [ref for stop in stops for ref in stop.inputs]
    inputs += [stop.ties for stop in stops if stop.ties]
    rigs = [stop.toe_in_sigmas for stop in stops if stop.toe_in_sigmas]
    scope = link_scope(earlier.stop, later.stop)
    return Recipe(ProductKind.LINKS, scope, tuple(inputs), (params, *poses, *rigs))


def link_scope(earlier: StopId, later: StopId) -> Scope:
    """A stop and the earlier one to which it is linked."""
    return Scope(ScopeLevel.STOP, f"{later}-to-site{earlier.site:04d}-drive{earlier.drive:04d}")


def link_poses(
    links: Mapping[tuple[StopId, StopId], ProductRef], store: ProductStore
) -> dict[tuple[StopId, StopId], Pose]:
    """Poses of the later rover in the earlier one, from accepted links."""
    read = {stops: read_ties(store.path(ref))[1] for stops, ref in links.items()}
    return {
        stops: pose_of_document(link["earlier_from_later"])
        for stops, link in read.items()
        if link["linked"]
    }


def _merged(stop: StopProducts) -> tuple[StopProducts, ...]:
    """A stop and those whose ground is merged with its own."""
    return (stop, *(other for other, _ in stop.beside))


def _same_stop(stop: StopProducts, telemetry: StopPrior, store: ProductStore) -> Hashable:
    return stop.stop, stop.inputs, PlainPose.of(telemetry.lsl_from_rover), store


@cached(LRUCache(STOPS_KEPT), key=_same_stop, condition=Condition())
def _read_stop(stop: StopProducts, telemetry: StopPrior, store: ProductStore) -> MatchedStop:
    """A stop as matched, read once for ties within it and for its links."""
    return read_matched_stop(telemetry, np.zeros((6, 6)), stop.pairs, store)


def _read_pointed(
    stop: StopProducts, telemetry: StopPrior, params: CrossSiteParams, store: ProductStore
) -> MatchedStop:
    """A stop with pair pointings corrected by inter-stereo ties, and the ground merged with it."""
    matched = _read_stop(stop, telemetry, store)
    if stop.ties is not None:
        ties = read_ties(store.path(stop.ties))[0]
        matched = point_pairs(matched, ties, params.trials.alignment)
    others = []
    for other, place in stop.beside:
        pose = place.between(stop.stop.frame, other.stop.frame)
        prior = StopPrior(other.stop, telemetry.lsl_from_rover @ pose)
        others.append((_read_pointed(other, prior, params, store), pose))
    return merge_ground(matched, others)


def _ground_of(
    stop: StopProducts, telemetry: StopPrior, params: CrossSiteParams, store: ProductStore
) -> Hashable:
    """What determines a prepared stop."""
    ground = tuple((one.stop, one.inputs, one.ties) for one in _merged(stop))
    places = tuple(place for _, place in stop.beside)
    return ground, places, PlainPose.of(telemetry.lsl_from_rover), params, store


@cached(LRUCache(STOPS_KEPT), key=_ground_of, condition=Condition())
def _prepared(
    stop: StopProducts, telemetry: StopPrior, params: CrossSiteParams, store: ProductStore
) -> StopViews:
    """A stop prepared for linking, once for all its links."""
    return prepare_stop(_read_pointed(stop, telemetry, params, store), params)


def clear_prepared() -> None:
    """Free the memory of the stops that are kept."""
    _prepared.cache_clear()
    _read_stop.cache_clear()


def _toe_in_px(matched: MatchedStop, stop: StopProducts) -> dict[str, float]:
    sigmas = dict(pair for one in _merged(stop) for pair in one.toe_in_sigmas)
    return {
        pair.pair_id: pair.geometry.focal_px * sigmas.get(pair.instrument, 0.0)
        for pair in matched.pairs
    }


def _figures_of_stop(found: PairTies) -> dict[str, Any]:
    return {
        "stop": str(found.stop),
        "links": [dataclasses.asdict(link) for link in found.links],
        "rms_px": finite(found.rms_px),
    }


def _figures_of_link(link: SiteLink, stops: tuple[StopProducts, StopProducts]) -> dict[str, Any]:
    figures = dataclasses.asdict(link.figures)
    beside = [str(other.stop) for stop in stops for other, _ in stop.beside]
    merged = f", with the ground of {', '.join(beside)}" if beside else ""
    return {
        "earlier": str(link.earlier),
        "later": str(link.later),
        "linked": link.linked,
        "reason": link.reason + merged,
        "earlier_from_later": pose_document(link.earlier_from_later),
        "figures": {name: finite(value) for name, value in figures.items()},
    }
