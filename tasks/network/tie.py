"""Tie: join the pairs of a stop, and stops with each other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.adjustment.modes.rig_pooling import add_toe_in
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams, tie_cross_site
from solmap.photogrammetry.matching.cross_site.links import SiteLink
from solmap.photogrammetry.matching.inter_stereo import (
    InterStereoParams,
    PairTies,
    point_pairs,
    tie_inter_stereo,
)
from solmap.photogrammetry.matching.records import MatchedStop
from solmap.products.formats.documents.archives import finite, pose_document, read_ties, write_ties
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairProducts, read_matched_stop
from solmap.tasks.network.previews import write_link_preview, write_ties_preview
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage


@dataclass(frozen=True, slots=True)
class StopProducts:
    """A stop with its matched pairs: what tying works on."""

    stop: StopId
    pairs: tuple[PairProducts, ...]
    toe_in_sigmas: tuple[tuple[str, float], ...] = ()
    """Standard deviation of toe-in, radians, by camera set, where it matters to links."""
    ties: ProductRef | None = None
    """Inter-stereo ties, by which links point its pairs; None: as labelled."""

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The products that tying reads."""
        return tuple(ref for pair in self.pairs for ref in pair.made)


@dataclass(frozen=True, slots=True)
class TelemetryPose:
    """A telemetry pose as plain numbers, so that it is part of a recipe."""

    rotation: tuple[float, ...]
    translation_m: tuple[float, ...]

    @classmethod
    def of(cls, telemetry: StopPrior) -> TelemetryPose:
        """The pose of a stop in the LSL."""
        pose = telemetry.lsl_from_rover
        return cls(tuple(pose.rotation.ravel().tolist()), tuple(pose.translation_m.tolist()))


@stage(task_run_name="tie-{stop.stop}")
def tie_stop(
    stop: StopProducts, telemetry: StopPrior, params: InterStereoParams, store: ProductStore
) -> ProductRef:
    """Tie every two overlapping pairs of a stop."""

    @cache
    def tie_pairs() -> tuple[MatchedStop, PairTies]:
        matched = _read_stop(stop, telemetry, store)
        return matched, tie_inter_stereo(matched, params)

    def write(path: Path) -> None:
        found = tie_pairs()[1]
        write_ties(path, found.ties, _figures_of_stop(found))

    def write_look(path: Path) -> None:
        matched, found = tie_pairs()
        write_ties_preview(path, matched, found.ties, params.alignment)

    scope = stop_scope(stop.stop)
    ties = store.make(Recipe(ProductKind.TIES, scope, stop.inputs, params), write)
    store.make(Recipe(ProductKind.QUICKLOOK, scope, (ties,)), write_look)
    return ties


@stage(task_run_name="link-{earlier.stop}-{later.stop}")
def link_stops(
    earlier: StopProducts,
    later: StopProducts,
    earlier_telemetry: StopPrior,
    later_telemetry: StopPrior,
    params: CrossSiteParams,
    store: ProductStore,
) -> ProductRef:
    """Tie two stops by the ground that both see, or say why that cannot be done."""

    @cache
    def tie_sites() -> tuple[StopViews, StopViews, SiteLink]:
        one, other = (
            StopViews.of(_read_pointed(stop, telemetry, params, store), params.birds_eye)
            for stop, telemetry in ((earlier, earlier_telemetry), (later, later_telemetry))
        )
        return one, other, tie_cross_site(one, other, params)

    def write(path: Path) -> None:
        one, other, link = tie_sites()
        sigmas_px = _toe_in_px(one.stop, earlier) | _toe_in_px(other.stop, later)
        write_ties(path, add_toe_in(link.ties, sigmas_px), _figures_of_link(link))

    recipe = links_recipe(earlier, later, earlier_telemetry, later_telemetry, params)
    links = store.make(recipe, write)
    store.make(
        Recipe(ProductKind.QUICKLOOK, recipe.scope, (links,)),
        lambda path: write_link_preview(path, *tie_sites(), params),
    )
    return links


def links_recipe(
    earlier: StopProducts,
    later: StopProducts,
    earlier_telemetry: StopPrior,
    later_telemetry: StopPrior,
    params: CrossSiteParams,
) -> Recipe:
    """What the links of two stops are made of."""
    poses = (TelemetryPose.of(earlier_telemetry), TelemetryPose.of(later_telemetry))
    inputs = (*earlier.inputs, *later.inputs)
    inputs += tuple(stop.ties for stop in (earlier, later) if stop.ties)
    rigs = tuple(stop.toe_in_sigmas for stop in (earlier, later) if stop.toe_in_sigmas)
    scope = link_scope(earlier.stop, later.stop)
    return Recipe(ProductKind.LINKS, scope, inputs, (params, *poses, *rigs))


def link_scope(earlier: StopId, later: StopId) -> Scope:
    """A stop and the earlier one it is linked to."""
    return Scope(ScopeLevel.STOP, f"{later}-to-site{earlier.site:04d}-drive{earlier.drive:04d}")


def _read_stop(stop: StopProducts, telemetry: StopPrior, store: ProductStore) -> MatchedStop:
    return read_matched_stop(telemetry, np.zeros((6, 6)), stop.pairs, store)


def _read_pointed(
    stop: StopProducts, telemetry: StopPrior, params: CrossSiteParams, store: ProductStore
) -> MatchedStop:
    """A stop with its pairs pointed as its inter-stereo ties tell."""
    matched = _read_stop(stop, telemetry, store)
    if stop.ties is None:
        return matched
    return point_pairs(matched, read_ties(store.path(stop.ties))[0], params.trials.alignment)


def _toe_in_px(matched: MatchedStop, stop: StopProducts) -> dict[str, float]:
    sigmas = dict(stop.toe_in_sigmas)
    return {
        pair.pair_id: pair.images.geometry.focal_px * sigmas.get(pair.instrument, 0.0)
        for pair in matched.pairs
    }


def _figures_of_stop(found: PairTies) -> dict[str, Any]:
    return {
        "stop": str(found.stop),
        "links": [dataclasses.asdict(link) for link in found.links],
        "rms_px": finite(found.rms_px),
    }


def _figures_of_link(link: SiteLink) -> dict[str, Any]:
    figures = dataclasses.asdict(link.figures)
    return {
        "earlier": str(link.earlier),
        "later": str(link.later),
        "linked": link.linked,
        "reason": link.reason,
        "earlier_from_later": pose_document(link.earlier_from_later),
        "figures": {name: finite(value) for name, value in figures.items()},
    }
