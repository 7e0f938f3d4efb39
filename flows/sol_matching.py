"""Match the stereo pairs of a sol, with right cameras corrected by estimates of the rigs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from solmap.flows.runtime.failures import keep_going, wait_for
from solmap.flows.runtime.runners import shares_memory
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_inputs import SolInputs, candidates
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.archive.rig import INSTRUMENT
from solmap.photogrammetry.imagery import StopId
from solmap.products.formats.documents.rig import PairRows, RigProduct, read_pair_rows, read_rig
from solmap.products.model import ProductRef
from solmap.tasks.images.pairs import PairFiles, PairProducts, Turn, pairs_of
from solmap.tasks.network.adjust import NetworkParams
from solmap.tasks.network.match import MatchParams, match_stereo_pair, measure_rows
from solmap.tasks.network.orientations import Standing
from solmap.tasks.network.rig import StopTies, pool_rig, refine_rig, turn_of_pair
from solmap.tasks.network.tie import StopProducts, prepare_to_link, tie_stop
from solmap.tasks.stage import LookedUp

Matched = dict[StopId, list[PairProducts]]


def match_pairs(
    inputs: SolInputs, previous: Standing | None, report: SolReport
) -> tuple[Matched, ProductRef | None]:
    """Match the pairs of all stops in the window; those of earlier sols are looked up.

    Pairs are matched with the rigs estimated from their rows and all earlier ones. If ties within
    the sol's stops then show another toe-in, the affected pairs are matched again.

    Returns:
        The matched pairs, and the estimates of the stereo rigs; None without any.
    """
    pairs = pairs_of(inputs.images)
    rows, refs, unmeasured = _measure_rows(pairs, inputs)
    rig = previous.rig if previous else None
    is_new = not (inputs.mode is AdjustmentMode.OVERALL and rig)
    if is_new:
        rig = _pool_rig(refs, rig, inputs, report)
    turns = _turns(rows, rig, inputs)
    matched = _match(pairs, turns, inputs, report)
    if is_new and rig:
        rig = _refine_rig(matched, rig, inputs, report)
        better = _turns(rows, rig, inputs)
        if better != turns:
            turns, matched = better, _match(pairs, better, inputs, report)
    ids = {pair.files.id for of_stop in matched.values() for pair in of_stop}
    for pair in ids & unmeasured.keys():  # of others one line is enough
        report.add_failures("measure the rows of", {pair: unmeasured[pair]})
    report.notes += _notes(rows, rig, inputs)
    return matched, rig


def _measure_rows(
    pairs: Sequence[PairFiles], inputs: SolInputs
) -> tuple[dict[str, PairRows], dict[str, ProductRef], dict[str, str]]:
    """Row offsets of pairs with the rigs of the labels, the products, and failures."""
    store = inputs.workspace.store
    futures = {pair.id: measure_rows.submit(pair, store) for pair in pairs}
    refs, failed = wait_for(f"sol {inputs.sol}: measure the rows of pairs", futures)
    rows: dict[str, PairRows] = {}
    for pair, ref in refs.items():
        with keep_going(failed, pair):
            rows[pair] = read_pair_rows(store.path(ref))
    return rows, {pair: refs[pair] for pair in rows}, failed


def _pool_rig(
    refs: Mapping[str, ProductRef], rig: ProductRef | None, inputs: SolInputs, report: SolReport
) -> ProductRef | None:
    """Add the rows of the sol's stops to the estimates; the earlier ones if that fails."""
    touched = {str(stop) for stop in inputs.touched}
    own = [image.id for image in inputs.images if image.stop in touched and image.id in refs]
    rows = tuple(refs[pair] for pair in sorted(own))
    if not rows:
        return rig
    mission, store = inputs.mission.mission, inputs.workspace.store
    future = pool_rig.submit(mission, inputs.sol, rows, rig, store)
    done, failed = wait_for(f"sol {inputs.sol}: pool the rows", {inputs.sol: future})
    report.add_failures("pool the rows of sol", failed)
    return done.get(inputs.sol, rig)


def _refine_rig(
    matched: Matched, rig: ProductRef, inputs: SolInputs, report: SolReport
) -> ProductRef:
    """Add the ties within the sol's stops to the estimates; the earlier ones if that fails."""
    config, store = inputs.config, inputs.workspace.store
    telemetry = {stop.stop: stop for stop in inputs.window}
    stops = {
        name: StopProducts(name, tuple(matched[name]))
        for name in inputs.touched
        if len(matched.get(name, ())) > 1
    }
    futures = {
        name: tie_stop.submit(
            stop, telemetry[name], config.inter_stereo, store, previews=config.previews
        )
        for name, stop in stops.items()
    }
    if not all(isinstance(future, LookedUp) for future in futures.values()):
        _prepare_link(matched, inputs)
    # reported after adjustment
    ties, _ = wait_for(f"sol {inputs.sol}: tie pairs within stops", futures)
    if not ties:
        return rig
    params = NetworkParams(config.tracks, config.adjustment)
    tied = tuple(StopTies(stops[name], ref) for name, ref in ties.items())
    future = refine_rig.submit(tied, rig, params, store)
    done, failed = wait_for(f"sol {inputs.sol}: refine the stereo rigs", {inputs.sol: future})
    report.add_failures("refine the stereo rigs of sol", failed)
    return done.get(inputs.sol, rig)


def _prepare_link(matched: Matched, inputs: SolInputs) -> None:
    """Prepare the stop nearest to a new one for their link, while a worker ties the new one.

    If that fails, the link reports it.
    """
    stops, config, store = inputs.telemetry.stops, inputs.config, inputs.workspace.store
    new = [stop for stop in inputs.window if stop.stop in inputs.new_stops]
    near = [old for stop in new for old in candidates(stop, stops, config)]
    near = [old for old in near if matched.get(old.stop) and old.stop not in inputs.touched]
    if not near or not shares_memory():
        return
    stop = StopProducts(near[0].stop, tuple(matched[near[0].stop]))
    tied = tie_stop.submit(stop, near[0], config.inter_stereo, store, previews=config.previews)
    if isinstance(tied, LookedUp):
        with keep_going({}, f"{stop.stop} is not prepared"):
            stop = replace(stop, ties=tied.result())
            prepare_to_link(stop, near[0], config.cross_site, store)


def _turns(
    rows: Mapping[str, PairRows], rig: ProductRef | None, inputs: SolInputs
) -> dict[str, Turn | None]:
    known = _read(rig, inputs)
    return {pair: turn_of_pair(one, known)[0] for pair, one in rows.items()}


def _match(
    pairs: Sequence[PairFiles],
    turns: Mapping[str, Turn | None],
    inputs: SolInputs,
    report: SolReport,
) -> Matched:
    params, store = MatchParams(inputs.config.sparse, inputs.config.dense), inputs.workspace.store
    futures = {
        pair.id: match_stereo_pair.submit(pair, params, store, turns.get(pair.id)) for pair in pairs
    }
    done, failed = wait_for(f"sol {inputs.sol}: match stereo pairs", futures)
    report.add_failures("match", failed)
    matched: Matched = {stop: [] for stop in sorted(stop.stop for stop in inputs.window)}
    for products in done.values():
        matched[products.files.stop].append(products)
    return matched


def _notes(rows: Mapping[str, PairRows], rig: ProductRef | None, inputs: SolInputs) -> list[str]:
    """Rotations of right cameras of the sol's stops, and pairs that contradict them."""
    known = _read(rig, inputs)
    notes = [
        f"{stop} {camera}: the right camera is turned by {np.degrees(np.linalg.norm(turn)):.3f} "
        f"degrees from its label, toe-in known to {np.degrees(sigma):.4f} degrees"
        for stop in map(str, inputs.touched)
        for camera, turn in known.applied.get(stop, {}).items()
        if (sigma := known.toe_in_sigmas(stop).get(camera)) is not None
    ]
    own = {entry.id for entry in inputs.images if entry.sol == inputs.sol}
    return (
        notes
        + [
            f"{pair}: its rows contradict those of other pairs of {one.instrument}; its right "
            f"camera is rotated accordingly ({one.summary})"
            for pair, one in rows.items()
            if pair in own and turn_of_pair(one, known)[1]
        ]
        + [
            f"{pair}: {one.summary}; calibrate the rig again"
            for pair, one in rows.items()
            if pair in own and one.rows is None and one.instrument == INSTRUMENT
        ]
    )


def _read(rig: ProductRef | None, inputs: SolInputs) -> RigProduct:
    return read_rig(inputs.workspace.store.path(rig)) if rig else RigProduct()
