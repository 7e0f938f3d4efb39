"""Find tie points between a sol's matched pairs and stops, and adjust the network."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from prefect.futures import PrefectFuture

from solmap.flows.runtime.failures import keep_going, wait_for
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_inputs import SolInputs, candidates
from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.parts import LinkPoses, Part, parts_to_link
from solmap.photogrammetry.matching.manual.editing import EditRequest
from solmap.products.formats.documents.rig import RigProduct, read_rig
from solmap.products.model import ProductKind, ProductRef
from solmap.products.store.process import return_free_memory
from solmap.tasks.images.manual_ties import read_edit_requests, requests_within
from solmap.tasks.images.pairs import PairProducts, clear_right_images
from solmap.tasks.mission.control import holds_control_of
from solmap.tasks.network.adjust import NetworkParams, NetworkStep, adjust_network
from solmap.tasks.network.orientations import Standing
from solmap.tasks.network.previews import preview_pairs
from solmap.tasks.network.singles import (
    SingleFile,
    drop_repeats,
    read_singles,
    singles_notes,
    singles_of,
    tie_singles,
)
from solmap.tasks.network.tie import (
    PlainPose,
    StopProducts,
    clear_prepared,
    link_poses,
    link_stops,
    tie_stop,
)

Links: TypeAlias = dict[tuple[StopId, StopId], ProductRef]


def adjust_stops(
    inputs: SolInputs,
    previous: Standing | None,
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
    rig: ProductRef | None = None,
) -> ProductRef | None:
    """Find tie points of the stops of the window and adjust the network; None if that failed."""
    config, store, sol = inputs.config, inputs.workspace.store, inputs.sol
    telemetry = {stop.stop: stop for stop in inputs.window}
    rigs = read_rig(store.path(rig)) if rig else RigProduct()
    stops = {
        name: StopProducts(name, tuple(pairs), rigs.toe_in_sigmas_of_ties(str(name)))
        for name, pairs in matched.items()
        if pairs
    }
    tied = {
        name: tie_stop.submit(
            stop, telemetry[name], config.inter_stereo, store, previews=config.previews
        )
        for name, stop in stops.items()
    }
    previews = _preview_matches(stops, inputs)  # while one worker ties the pairs of a stop
    ties, failed = wait_for(f"sol {sol}: tie pairs within stops", tied)
    report.add_failures("tie", failed)
    stops = {name: replace(stop, ties=ties.get(name)) for name, stop in stops.items()}
    links = _link(inputs, stops, report)
    singles = _tie_singles(inputs, stops, report)
    step = NetworkStep(
        mission=inputs.mission.mission,
        sol=sol,
        mode=inputs.mode,
        previous=previous.network if previous else None,
        stops=inputs.telemetry.stops,
        new_stops=inputs.new_stops,
        window=tuple(stop.stop for stop in inputs.window),
        pairs=tuple(pair for stop in stops.values() for pair in stop.pairs),
        ties=tuple(ties.values()),
        links=tuple(links.values()),
        singles=singles,
        edit_requests=_edit_requests(inputs, matched, report),
        control=_control(inputs, report),
        stated=inputs.telemetry.stated,
    )
    params = NetworkParams(config.tracks, config.adjustment)
    done, undone = wait_for(
        f"sol {sol}: adjust the network", {sol: adjust_network.submit(step, params, store)}
    )
    report.add_failures("adjust sol", undone)
    _, undrawn = wait_for(f"sol {sol}: preview matches", previews)
    report.add_failures("preview the matches of", undrawn)
    clear_right_images()
    return done.get(sol)


def _preview_matches(
    stops: Mapping[StopId, StopProducts], inputs: SolInputs
) -> dict[StopId, PrefectFuture[tuple[ProductRef, ...]]]:
    """Tasks that draw previews of the matches of every stop, if enabled."""
    params, store = inputs.config.sparse, inputs.workspace.store
    drawn = stops if inputs.config.previews else {}
    return {name: preview_pairs.submit(stop.pairs, params, store) for name, stop in drawn.items()}


def _link(inputs: SolInputs, stops: Mapping[StopId, StopProducts], report: SolReport) -> Links:
    """Link the stops of the window one by one, then parts that are still not linked."""
    telemetry = {stop.stop: stop for stop in inputs.window}
    params, store = inputs.config.cross_site, inputs.workspace.store

    def tie(every: Iterable[tuple[StopProducts, StopProducts]]) -> Links:
        done, failed = wait_for(
            f"sol {inputs.sol}: tie stops across sites",
            {
                (one.stop, other.stop): link_stops.submit(
                    one,
                    other,
                    telemetry[one.stop],
                    telemetry[other.stop],
                    params,
                    store,
                    previews=inputs.config.previews,
                )
                for one, other in every
            },
        )
        why = {f"{one} - {other}": cause for (one, other), cause in failed.items()}
        report.add_failures("link", why)
        return done

    every = [(old, new) for old, new in _link_candidates(inputs) if {old, new} <= set(stops)]
    links = tie((stops[old], stops[new]) for old, new in every)
    poses = link_poses(links, store)
    for new in inputs.window:
        merged = tie(parts_at(new, inputs, stops, poses))
        links, poses = links | merged, poses | link_poses(merged, store)
    clear_prepared()
    return_free_memory()
    return links


def parts_at(
    new: StopPrior,
    inputs: SolInputs,
    stops: Mapping[StopId, StopProducts],
    poses: LinkPoses,
) -> list[tuple[StopProducts, StopProducts]]:
    """Parts (groups of linked stops) to link with the part of `new`, each merged into one surface.

    None unless the window contains all stops with which a link of `new` was tried; so a later sol
    does not try fewer.
    """
    tried = {old.stop for old in candidates(new, inputs.telemetry.stops, inputs.config)}
    telemetry = {stop.stop: stop.lsl_from_rover for stop in inputs.window}
    if new.stop not in stops or not tried <= telemetry.keys():
        return []
    among = [stop for stop in telemetry if stop in tried and stop in stops]
    reach_m = inputs.config.links.max_distance_m
    return [
        (_merged(one, stops), _merged(other, stops))
        for one, other in parts_to_link([*among, new.stop], telemetry, poses, reach_m)
    ]


def _merged(part: Part, stops: Mapping[StopId, StopProducts]) -> StopProducts:
    """The reference stop of a part, with the products and relative poses of its other stops."""
    others = [(stops[name], PlainPose.of(pose)) for name, pose in part.beside.items()]
    return replace(stops[part.stop], beside=tuple(others))


def _tie_singles(
    inputs: SolInputs, stops: Mapping[StopId, StopProducts], report: SolReport
) -> tuple[ProductRef, ...]:
    """Find tie points of images without a stereo partner, at the stops of the window."""
    store, window = inputs.workspace.store, {stop.stop for stop in inputs.window}
    singles: dict[StopId, tuple[SingleFile, ...]] = {}
    unread: dict[str, str] = {}
    for stop in window:
        images = [image for image in inputs.images if image.stop_id == stop]
        with keep_going(unread, str(stop)):
            singles |= singles_of(drop_repeats(images, inputs.workspace))
    report.add_failures("read the unpaired images of", unread)
    futures = {
        stop: tie_singles.submit(
            stop,
            files,
            stops[stop].pairs if stop in stops else (),
            inputs.config.mono,
            store,
            previews=inputs.config.previews,
        )
        for stop, files in singles.items()
        if stop in window and (len(files) > 1 or stop in stops)
    }
    done, failed = wait_for(f"sol {inputs.sol}: tie images without partner", futures)
    report.add_failures("tie the unpaired images of", failed)
    touched = set(inputs.touched)
    for stop, ref in done.items():
        if stop in touched:
            report.notes += singles_notes(stop, read_singles(ref, store))
    return tuple(done.values())


def _edit_requests(
    inputs: SolInputs, matched: Mapping[StopId, Sequence[PairProducts]], report: SolReport
) -> tuple[EditRequest, ...]:
    """The edit requests that concern pairs and stops of the window and nothing beyond them."""
    unread: dict[str, str] = {}
    requests: list[EditRequest] = []
    for ref in inputs.workspace.catalogue.pointers(ProductKind.MANUAL_TIES):
        with keep_going(unread, ref.scope.name):
            data = inputs.workspace.store.path(ref).read_bytes()
            requests += read_edit_requests(data, ref.scope.name)
    report.add_failures("read", unread)
    known = {pair.files.id for pairs in matched.values() for pair in pairs}
    return requests_within(requests, known | {str(stop) for stop in matched})


def _control(inputs: SolInputs, report: SolReport) -> tuple[ProductRef, ...]:
    """All published control of the mission; none for a map not tied to the lander or to Mars."""
    if inputs.landing.origin:
        return ()
    unread: dict[str, str] = {}
    control: list[ProductRef] = []
    for ref in inputs.workspace.catalogue.pointers(ProductKind.CONTROL):
        with keep_going(unread, ref.scope.name):
            if holds_control_of(ref, inputs.mission.mission, inputs.workspace.store):
                control.append(ref)
    report.add_failures("read", unread)
    return tuple(control)


def _link_candidates(inputs: SolInputs) -> list[tuple[StopId, StopId]]:
    """Pairs of stops of the window that are tried for a link, the earlier one first."""
    stops = inputs.telemetry.stops
    names = {stop.stop for stop in inputs.window}
    return [
        (old.stop, stop.stop)
        for stop in inputs.window
        for old in candidates(stop, stops, inputs.config)
        if old.stop in names
    ]
