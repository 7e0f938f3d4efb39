"""All sols on a map, oldest first: each adjustment starts from the one before.

A sol leaves the layers of stops that the next sol of the run maps again to that one, which may
move them; only new stops get their first maps at once. If the next sol fails, the layers are made
after all.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from prefect import Flow

from solmap.config.pipeline import load_pipeline
from solmap.flows.finished import ReusableSols
from solmap.flows.overall import overall_sols, process_overall
from solmap.flows.runtime.failures import isolate
from solmap.flows.runtime.runners import on_workers
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol import process_sol
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import Scope
from solmap.products.store.process import return_free_memory
from solmap.tasks.images.pairs import read_epipolar
from solmap.tasks.maps.dtms import clear_dtms
from solmap.tasks.network.orientations import Standing, clear_views
from solmap.tasks.scopes import network_scope


@dataclass(frozen=True, slots=True)
class Step:
    """A sol to process, by the adjustment of it or of all stops up to it."""

    sol: int
    scope: Scope
    is_overall: bool

    @classmethod
    def of(cls, name: str, sol: int, *, is_overall: bool) -> Step:
        """A step for a sol on a map."""
        mode = AdjustmentMode.OVERALL if is_overall else AdjustmentMode.SEQUENTIAL
        return cls(sol, network_scope(name, sol, mode), is_overall)


@dataclass(slots=True, eq=False)
class MapSols:
    """The sols of a map that one run processes, or finds processed."""

    name: str
    workspace: Workspace
    pipeline: str
    failures: list[str]
    """Gains a line per failure."""
    standing: Standing | None = None
    """The adjustment of the last sol so far."""
    _reports: dict[Step, SolReport] = field(default_factory=dict)
    _before: dict[Step, Standing | None] = field(default_factory=dict)
    """The adjustment from which each step started."""
    _unrecorded: list[tuple[Step, str, SolReport]] = field(default_factory=list)
    """Steps with their keys, whose layers are not all made yet."""
    _walks: bool = False
    """Whether a sol was processed; later ones publish maps of the same stops after it."""

    @property
    def reports(self) -> list[SolReport]:
        """The reports of the completed steps, oldest first."""
        return list(self._reports.values())

    def process(self) -> bool:
        """Process the sols; returns whether every one was completed."""
        steps = self._steps()
        reusable = ReusableSols.of(self.name, self.workspace, self.pipeline)
        self.workspace.catalogue.forget_sols(self.name, kept=[step.scope.name for step in steps])
        for earlier, step, later in zip([None, *steps], steps, [*steps[1:], None], strict=False):
            self._before[step] = self.standing
            self._take(step, reusable, later)
            if earlier and self._has_left(earlier) and not self._is_mapped(step):
                self._take(earlier, reusable, None)
        read_epipolar.cache_clear()  # 10 MB a pair: links of a later sol would need them
        return_free_memory()
        return len(self._reports) == len(steps)

    def _steps(self) -> list[Step]:
        """All steps; a map that was adjusted overall is so again: later sols continued from it."""
        sols = sorted({entry.sol for entry in self.workspace.catalogue.images(self.name)})
        overall = overall_sols(self.name, self.workspace)
        if load_pipeline(self.pipeline).adjustment_mode is AdjustmentMode.OVERALL:
            overall |= set(sols[-1:])
        return [
            Step.of(self.name, sol, is_overall=is_overall)
            for sol in sols
            for is_overall in ((False, True) if sol in overall else (False,))
        ]

    def _take(self, step: Step, reusable: ReusableSols, later: Step | None) -> None:
        """Find the report of a step, or process it, and leave layers to the `later` step."""
        line = f"{self.name} sol {step.sol}: {{}}"
        with isolate(step.scope.name, self.workspace, self.failures, line):
            key = reusable.key(step.sol, self._before[step])
            done = None if self._walks else reusable.report(step.scope, step.sol, key)
            if done is None:
                if not self._walks:
                    reusable.forget(step.scope)
                self._walks = True
                done = self._run(step, later)
                self._record(reusable, step, key, done)
            self._reports[step] = done
            lines = [line.format(failure) for failure in done.failures]
            self.failures += [one for one in lines if one not in self.failures]
            if done.standing is not None:
                self.standing = done.standing

    def _run(self, step: Step, later: Step | None) -> SolReport:
        flow: Flow[..., SolReport] = process_overall if step.is_overall else process_sol
        following = () if later is None or step.is_overall or later.is_overall else (later.sol,)
        root, before = self.workspace.store.root, self._before[step]
        done = on_workers(flow)(self.name, step.sol, root, self.pipeline, before, *following)
        clear_views()
        clear_dtms()
        return_free_memory()
        return done

    def _record(self, reusable: ReusableSols, step: Step, key: str, done: SolReport) -> None:
        """Record as finished the steps whose layers are all made."""
        others = [kept for kept in self._unrecorded if kept[0] != step]
        self._unrecorded = []
        for kept in (*others, (step, key, done)):
            if kept[2].postponed & done.postponed:
                self._unrecorded.append(kept)
            else:
                reusable.note(kept[0].scope, kept[1], kept[2])

    def _has_left(self, step: Step) -> bool:
        return step in self._reports and bool(self._reports[step].postponed)

    def _is_mapped(self, step: Step) -> bool:
        return step in self._reports and self._reports[step].standing is not None
