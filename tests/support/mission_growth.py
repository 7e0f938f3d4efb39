"""What a sol costs as the traverse gets longer: `python -m tests.support.mission_growth 500`.

A simulated mission comes in sol by sol, a stop a sol, as a mission's downlinks do: the network part
of the flow of a sol runs on the engine (inputs, matches and ties looked up, adjustment,
orientations, report, publishing), then what is drawn of the whole mission. Images have no pixels,
so nothing is matched and no ground mapped. A line of JSON a sol.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import resource
import sys
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from solmap.photogrammetry.synthetic.mission import MissionPlan
from tests.support.simulated_sols import SimulatedSols

CLEAR = Path("/proc/self/clear_refs")
STATUS = Path("/proc/self/status")
EVERY = 5
"""Memory is measured once per this many sols: returning free memory takes longer than a sol."""


class Costs:
    """Seconds by clock and processor, and the peak of memory, of named parts of a sol."""

    def __init__(self, *, takes_memory: bool) -> None:
        self.figures: dict[str, float] = {}
        self.takes_memory = takes_memory

    @contextmanager
    def of(self, part: str) -> Iterator[None]:
        """Take the time of a part; of the first one also the most memory it took."""
        takes_memory, self.takes_memory = self.takes_memory, False
        before = _settled_memory_mb() if takes_memory else 0.0
        clock, processor = time.perf_counter(), _processor_s()
        yield
        self.figures[f"{part}_s"] = round(time.perf_counter() - clock, 4)
        self.figures[f"{part}_cpu_s"] = round(_processor_s() - processor, 4)
        if takes_memory:
            self.figures[f"{part}_peak_mb"] = round(_memory_mb("VmHWM") - before, 1)
            self.figures["resident_mb"] = round(before, 1)
            self.takes_memory = True


def _settled_memory_mb() -> float:
    """Memory after all that is free was given back; the peak counts from here on."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    CLEAR.write_text("5")
    return _memory_mb("VmRSS")


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _memory_mb(name: str) -> float:
    (line,) = (line for line in STATUS.read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) / 1024


class AtOnce:
    """A stage that runs where it is submitted, without an engine."""

    def __init__(self, stage: Any) -> None:
        self.stage = stage

    def submit(self, *args: Any, **kwargs: Any) -> AtOnce:
        """Do the work; its value is the result."""
        made = AtOnce(self.stage)
        made.made = self.stage.fn(*args, **kwargs)  # type: ignore[attr-defined]
        return made

    def result(self, **_: Any) -> Any:
        """What the work gave."""
        return self.made  # type: ignore[attr-defined]


STAGES = {
    "sol_matching": (
        "measure_rows",
        "pool_rig",
        "match_stereo_pair",
        "tie_stop",
        "refine_rig",
    ),
    "sol_network": ("tie_stop", "link_stops", "adjust_network"),
}
"""Of the network of a sol, by the module of the flow that calls them."""


@contextmanager
def without_engine() -> Iterator[None]:
    """Run stages synchronously, where only their results are needed."""
    from solmap.flows import sol_matching, sol_network, sol_waves  # noqa: PLC0415

    modules = {"sol_matching": sol_matching, "sol_network": sol_network}
    calls = [(modules[name], stage) for name, stages in STAGES.items() for stage in stages]
    before = [getattr(module, name) for module, name in calls]
    publish = sol_waves.publish
    for (module, name), stage in zip(calls, before, strict=True):
        setattr(module, name, AtOnce(stage))
    sol_waves.publish = publish.fn
    try:
        yield
    finally:
        sol_waves.publish = publish
        for (module, name), stage in zip(calls, before, strict=True):
            setattr(module, name, stage)


def network_of_sol(*, on_engine: bool) -> Callable[..., Any]:
    """The flow of a sol up to what is known of its network; imported where the engine runs."""
    from prefect import flow  # noqa: PLC0415

    from solmap.flows.runtime.runners import on_workers  # noqa: PLC0415
    from solmap.flows.runtime.sol_report import SolReport  # noqa: PLC0415
    from solmap.flows.sol_inputs import gather  # noqa: PLC0415
    from solmap.flows.sol_matching import match_pairs  # noqa: PLC0415
    from solmap.flows.sol_network import adjust_stops  # noqa: PLC0415
    from solmap.flows.sol_waves import Waves  # noqa: PLC0415
    from solmap.tasks.network.orientations import Standing, choose_orientations  # noqa: PLC0415
    from solmap.tasks.network.report import report_quality  # noqa: PLC0415

    chosen = choose_orientations if on_engine else choose_orientations.fn
    stated = report_quality if on_engine else lambda *_: []

    def run(sol: int, store: Path, previous: Any, costs: Costs) -> Any:
        report = SolReport("MER2", sol)
        with costs.of("gather"):
            inputs = gather("MER2", sol, store, "default", previous)
        with costs.of("match"):
            matched, rig = match_pairs(inputs, previous, report)
        with costs.of("adjust"):
            network = adjust_stops(inputs, previous, matched, report, rig)
        if network is None:
            raise RuntimeError(f"sol {sol}: {report.failures}")
        with costs.of("orient"):
            before, params = previous.orientations if previous else None, inputs.config.reissue
            oriented = chosen(network, before, params, inputs.workspace.store, rig)
        report.standing = Standing(network, oriented, rig)
        pairs = tuple(pair for of_stop in matched.values() for pair in of_stop)
        with costs.of("report"):
            reported = stated(network, pairs, inputs.config.quality, inputs.workspace.store)
        with costs.of("publish"):
            waves = Waves.of(inputs, report)
            waves.pointers += [network, oriented, *([rig] if rig else []), *reported]
            waves.pointers += [ref for pair in pairs for ref in pair.made]
            waves.close()
        if report.failures:
            raise RuntimeError(f"sol {sol}: {report.failures}")
        return report.standing

    if on_engine:
        return on_workers(flow(run, name="network of a sol", validate_parameters=False))

    def run_at_once(*args: Any) -> Any:
        with without_engine():
            return run(*args)

    return run_at_once


def main() -> None:
    """Walk the traverse and write a line a sol."""
    parser = argparse.ArgumentParser(prog="mission_growth", description=__doc__)
    parser.add_argument("stops", type=int)
    parser.add_argument(
        "--store", type=Path, required=True, help="an empty folder, or a walk to go on with"
    )
    parser.add_argument("--sols", type=int, help="the first so many only")
    parser.add_argument("--pairs", type=int, default=10, help="stereo pairs a stop")
    parser.add_argument("--whole", default="10,50,100,200,300,400,500", help="sols on the engine")
    arguments = parser.parse_args()
    arguments.store = arguments.store.absolute()  # the engine changes to another folder
    arguments.store.mkdir(parents=True, exist_ok=True)
    from solmap.flows.runtime.engine import start_engine  # noqa: PLC0415

    start_engine(arguments.store)
    whole = {int(sol) for sol in arguments.whole.split(",")}
    share = arguments.pairs / MissionPlan().pairs_per_stop
    sols = SimulatedSols.of(
        arguments.stops,
        pairs_per_stop=arguments.pairs,
        inter_ties=round(share * MissionPlan().inter_ties),
        intra_ties=round(share * MissionPlan().intra_ties),
    )
    walk(sols, arguments.sols or arguments.stops, arguments.store, whole)


def walk(sols: SimulatedSols, last: int, root: Path, whole: set[int]) -> None:
    """The sols of a mission up to one; some of them on the engine, with report and layers."""
    for _, figures in walked(sols, last, root, whole):
        sys.stdout.write(json.dumps(figures) + "\n")
        sys.stdout.flush()


def walked(
    sols: SimulatedSols, last: int, root: Path, whole: Collection[int] = ()
) -> Iterator[tuple[Any, dict[str, float]]]:
    """What each sol leaves to the next, and what it cost."""
    from solmap.config.workspace import open_workspace  # noqa: PLC0415
    from solmap.flows.mission import draw_mission  # noqa: PLC0415
    from solmap.flows.sol_inputs import gather  # noqa: PLC0415
    from solmap.tasks.scopes import sol_of  # noqa: PLC0415

    workspace = open_workspace(root)
    flows = {on: network_of_sol(on_engine=on) for on in (True, False)}
    standing = _standing(workspace)
    first = sol_of(standing.network.scope) + 1 if standing else 1
    for sol in range(first, last + 1):
        sols.deliver([sol], workspace)
        sols.match(gather("MER2", sol, root, "default", standing))
        costs = Costs(takes_memory=sol in whole or sol % EVERY == 0)
        with costs.of("sol"):
            standing = flows[sol in whole](sol, root, standing, costs)
        if sol in whole:
            with costs.of("draw"):
                draw_mission("MER2", standing.network, workspace, "default", {})
        sizes = {
            f"{ref.kind}_kb": round(workspace.store.size(ref) / 1024, 1)
            for ref in (standing.network, standing.orientations)
        }
        yield standing, {"sol": sol, **costs.figures, **sizes}


def _standing(workspace: Any) -> Any:
    """Where a walk that was interrupted goes on; None at the beginning."""
    from solmap.products.catalogue.catalogue import published_networks  # noqa: PLC0415
    from solmap.tasks.network.orientations import standing_of  # noqa: PLC0415

    networks = published_networks("MER2", workspace.catalogue)
    return standing_of(networks[-1], workspace) if networks else None


if __name__ == "__main__":
    main()
