"""Process one sol, from its stereo pairs to published layers of its stops."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from prefect import flow

from solmap.flows.runtime.failures import keep_going, keep_outcome, wait_for
from solmap.flows.runtime.jobs import Job, run_jobs
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_inputs import SolInputs, gather
from solmap.flows.sol_maps import (
    FIRST,
    Key,
    Matched,
    map_far_ground,
    map_jobs,
    model_jobs,
    panorama_jobs,
    preview_jobs,
)
from solmap.flows.sol_matching import match_pairs
from solmap.flows.sol_network import adjust_stops
from solmap.flows.sol_waves import Waves, outcome_of
from solmap.photogrammetry.adjustment.quality.movement import ReissueParams
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.imagery import StopId
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductRef
from solmap.tasks.maps.dtms import clear_dtms
from solmap.tasks.network.orientations import (
    MappedStop,
    Standing,
    choose_orientations,
    clear_views,
    read_orientations,
)
from solmap.tasks.network.report import report_quality


@flow(name="sol", flow_run_name="{mission} sol {sol}")
def process_sol(
    mission: str,
    sol: int,
    store: Path,
    pipeline: str,
    previous: Standing | None = None,
    following: int | None = None,
) -> SolReport:
    """Process one sol from raw images to published layers.

    Args:
        mission: Name of the map.
        sol: The sol.
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.
        previous: The adjustment before this sol.
        following: The next sol of the run. It may move stops of this one, and makes their layers;
            this one only makes the first maps of stops that have none.
    """
    report = SolReport(mission, sol)
    inputs = gather(mission, sol, store, pipeline, previous)
    report.notes += inputs.unplaced
    report.notes += [
        f"{e.id} {'is unpaired' if e.repeats is None else 'is not used'}: {e.unpaired_because}"
        for e in inputs.unpaired
    ]
    of_sol = inputs.workspace.catalogue.images(mission, sol=sol)
    report.notes += [f"{image.id}: {note}" for image in of_sol for note in image.notes]
    if inputs.touched:
        map_what_moved(inputs, previous, report, following)
    else:  # none of the sol's stops can be placed
        report.add_failures("read", inputs.unread)
        keep_outcome(outcome_of(inputs, report), inputs.workspace)
    return report


def map_what_moved(
    inputs: SolInputs, previous: Standing | None, report: SolReport, following: int | None = None
) -> None:
    """Match, adjust, map new and moved stops, and publish; each step adds to the report."""
    report.add_failures("read", inputs.unread)
    failed: dict[str, str] = {}
    matched, rig = match_pairs(inputs, previous, report)
    waves = Waves.of(inputs, report)
    waves.pointers += [rig] if rig else []
    waves.pointers += [ref for pairs in matched.values() for pair in pairs for ref in pair.made]
    network = adjust_stops(inputs, previous, matched, report, rig)
    if network is not None:
        waves.pointers.append(network)
        report.standing = _choose_orientations(network, rig, previous, inputs, report)
    if report.standing is not None:
        waves.pointers.append(report.standing.orientations)
        waves.show_positions(report.standing)
        if following is not None:
            with keep_going(failed, f"sol {following}"):
                report.postponed = _stops_of(following, inputs, report.standing)
    _make(waves, network, matched)
    if report.standing is not None:
        with keep_going(failed, "its findings"):
            report.notes += _findings(inputs, report.standing)
    report.add_failures("read", failed)
    waves.close()


def _stops_of(sol: int, inputs: SolInputs, standing: Standing) -> frozenset[StopId]:
    """The stops that a following sol maps; none if it has none of its own."""
    name, store = inputs.mission.mission, inputs.workspace.store.root
    following = gather(name, sol, store, inputs.pipeline, standing)
    return frozenset(stop.stop for stop in following.window) if following.touched else frozenset()


def _make(waves: Waves, network: ProductRef | None, matched: Matched) -> None:
    """Make and publish the layers of the stops, the quality report, and previews of terrain."""
    inputs, report, standing = waves.inputs, waves.report, waves.report.standing
    unsubmitted: dict[str, str] = {}
    jobs: dict[Key, Job] = {}
    if standing is not None:
        with keep_going(unsubmitted, "maps"):
            jobs = _plan(waves, standing, matched)
    if network is not None:
        jobs |= _quality_job(network, matched, inputs)
    mapped = {stop for stop, what in jobs if what == "dtm"} - report.postponed
    jobs |= preview_jobs(inputs, mapped)
    first = [(stop, what) for stop, what in jobs if stop in waves.new and what in FIRST]
    jobs = {key: job if key in first else job.only_after(first) for key, job in jobs.items()}
    _note_failures(report, jobs, run_jobs(jobs, waves.settled)[1])
    clear_views()
    clear_dtms()
    if standing is not None:
        with keep_going(unsubmitted, "far ground"):
            for stop, far in map_far_ground(inputs, standing, matched, report).items():
                waves.layers.setdefault(stop, []).extend(far)
    report.add_failures("make", unsubmitted)


def _plan(waves: Waves, standing: Standing, matched: Matched) -> dict[Key, Job]:
    """Jobs for the layers of the stops; of a postponed one that is new, only the first maps."""
    inputs, postponed = waves.inputs, waves.report.postponed
    first, more = map_jobs(inputs, standing.orientations, matched, waves.new)
    models = model_jobs(inputs, standing.orientations, matched)
    models |= panorama_jobs(inputs, standing.orientations, matched)

    def due(jobs: Mapping[Key, Job], left_out: frozenset[StopId]) -> dict[Key, Job]:
        return {key: job for key, job in jobs.items() if key[0] not in left_out}

    planned = due(first, postponed - waves.new), due(more, postponed), due(models, postponed)
    waves.plan(*planned)
    jobs = planned[0] | planned[1] | planned[2]
    # new stops wave by wave, then the others one by one, so that the views of one are in memory
    names = {key: "" if key[0] in waves.new else str(key[0]) for key in jobs}
    return {key: jobs[key] for key in sorted(jobs, key=names.__getitem__)}


def _quality_job(network: ProductRef, matched: Matched, inputs: SolInputs) -> dict[Key, Job]:
    pairs = tuple(pair for of_stop in matched.values() for pair in of_stop)
    params, store = inputs.config.quality, inputs.workspace.store
    stage = f"sol {inputs.sol}: report the quality"
    job = Job(stage, lambda _: report_quality.submit(network, pairs, params, store))
    return {(network.scope, "quality"): job}


def _note_failures(report: SolReport, jobs: Mapping[Key, Job], failed: Mapping[Key, str]) -> None:
    """Add the causes of failed jobs to the report, grouped by the verb of their stage."""
    by_verb: dict[str, dict[str, str]] = {}
    for (subject, what), cause in failed.items():
        verb = jobs[subject, what].stage.partition(": ")[2].split()[0]
        by_verb.setdefault(verb, {})[f"{what} of {subject}"] = cause
    for verb, causes in by_verb.items():
        findings = (TerrainError,) if verb in {"model", "draw"} else ()
        report.add_findings(verb, causes, "no", *findings)


def _choose_orientations(
    network: ProductRef,
    rig: ProductRef | None,
    previous: Standing | None,
    inputs: SolInputs,
    report: SolReport,
) -> Standing | None:
    """Choose the orientations for mapping the stops; None if that failed."""
    before, store = previous.orientations if previous else None, inputs.workspace.store
    chosen = choose_orientations.submit(network, before, inputs.config.reissue, store, rig)
    stage = f"sol {inputs.sol}: choose the orientations"
    done, failed = wait_for(stage, {network.scope: chosen})
    report.add_failures("choose the orientations of", failed)
    return Standing(network, done[network.scope], rig) if done else None


def _findings(inputs: SolInputs, standing: Standing) -> list[str]:
    """Notes: summary of the adjustment, links, and stops that are mapped again."""
    store = inputs.workspace.store
    product, touched = read_network(standing.network, store), {str(s) for s in inputs.touched}
    links = [_link_line(link) for link in product.links if link["later"] in touched]
    mapped = read_orientations(standing.orientations, store, ()).values()
    again = [stop for stop in mapped if stop.is_new and stop.moved_m is not None]
    return [
        product.report["summary"],
        *product.manual_tie_notes,
        *links,
        *(_remapped_line(stop, inputs.config.reissue) for stop in again),
    ]


def _remapped_line(stop: MappedStop, params: ReissueParams) -> str:
    """The reason is a height bias that the first link of a stop has shown, or the movement."""
    if stop.moved_m is not None and stop.moved_m <= params.shift_m:
        return f"{stop.stop} is mapped again: its links state another height bias of the ground"
    return (
        f"{stop.stop} is mapped again: ground within {params.range_m:g} m of it moved by up to "
        f"{stop.moved_m:.3f} m"
    )


def _link_line(link: dict[str, object]) -> str:
    state = "linked" if link["linked"] else "not linked"
    return f"{link['earlier']} - {link['later']}: {state}, {link['reason']}"
