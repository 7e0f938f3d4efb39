"""The sols of a run: their order, those that need no processing, and layers that none makes.

**Order.** Oldest first, because each adjustment starts from the one before. A sol leaves the layers
of stops that the next one maps again to that one, which may move them; only new stops get their
first maps at once. If the next sol fails, the layers are made after all.

**Finished sols.** A sol depends on the images up to it, on the vector files, manual ties and
control of the mission, on the settings, and on the adjustment before it. A late image changes the
key of its sol and, by the adjustments, of those after it; their products are looked up or made
again as usual.

**Leftovers.** Late images and vector files also change which stops are linked, which images make
pairs, and which map a stop is on: then a stop may have no far ground any more, and a map no image.
The sols of a run, including those that needed no processing, define all layers of stops. Other
published layers would depend on the order of delivery; they are withdrawn where the run has
published their stop again, or newer files replace their images. Otherwise they are kept, and the
run fails with a message.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, field
from importlib.metadata import version

from prefect import Flow

from solmap.config.landing import landing_site
from solmap.config.pipeline import load_pipeline
from solmap.config.settings import Settings
from solmap.flows.overall import overall_sols, process_overall
from solmap.flows.runtime.failures import isolate
from solmap.flows.runtime.runners import on_workers
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol import process_sol
from solmap.flows.sol_inputs import read_map
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.runs import FinishedSolRecords
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import (
    SCIENCE_VERSION,
    ProductKind,
    ProductRef,
    Scope,
    ScopeLevel,
    mission_of,
)
from solmap.products.store.process import return_free_memory
from solmap.tasks.images.pairs import clear_images
from solmap.tasks.mission.localisation import traverse_products
from solmap.tasks.mission.publish import withdraw
from solmap.tasks.network.orientations import Standing
from solmap.tasks.scopes import is_of_mission, network_scope, pair_scope

PARTS = "standing", "layers", "pointers"
"""Lists in the record of a finished sol: input of the next sol, layers, other products."""
BY_COMMAND = {ProductKind.DIPS}
"""Kinds of layers that commands of people make, too."""
Latest = Set[tuple[ProductKind, Scope]]


@dataclass(frozen=True, slots=True, eq=False)
class ReusableSols:
    """The finished sols of a mission, for what is in the store and settings now."""

    mission: str
    workspace: Workspace
    book: FinishedSolRecords
    common: str
    """Digest of what all sols depend on."""
    images: dict[int, str]
    """Digest of the images up to a sol, by sol."""

    @classmethod
    def of(cls, mission: str, workspace: Workspace, pipeline: str) -> ReusableSols:
        """Compute the digests of all inputs of sols, except adjustments."""
        book = FinishedSolRecords(workspace.catalogue.engine)
        common = _digest(*_common(mission, workspace, pipeline))
        return cls(mission, workspace, book, common, _images(mission, workspace))

    def key(self, sol: int, before: Standing | None) -> str:
        """Digest of the inputs of a sol; `before` is the adjustment from which it starts."""
        return _digest(self.common, self.images[sol], repr(before))

    def report(self, scope: Scope, sol: int, key: str) -> SolReport | None:
        """Report of the sol made from the same inputs; None if it must be processed."""
        found = self.book.find(scope.name, key)
        if found is None or not found.keys() >= set(PARTS):  # an earlier version noted less
            return None
        standing, published, pointed = (
            tuple(map(ProductRef.of_text, found[part])) for part in PARTS
        )
        store = self.workspace.store
        needed = (*standing, *((*published, *pointed) if store.object_storage is None else ()))
        if not all(map(store.has, needed)):  # of an object store each would be a request
            return None
        left = Standing(*standing) if standing else None
        notes, failures = list(found["notes"]), list(found["failures"])
        layers = len(published)
        return SolReport(self.mission, sol, left, layers, notes, failures, published, pointed)

    def forget(self, first: Scope) -> None:
        """Delete the records of this sol and later ones, which are processed now.

        Each publishes the stops that it shares with the one before it again, so none may be skipped
        if this run is killed in between.
        """
        self.book.forget(first.name, f"{self.mission.lower()}-sol")

    def note(self, scope: Scope, key: str, report: SolReport) -> None:
        """Record that the sol is finished, unless a failure of it may not occur again."""
        if not is_finished(report):
            return
        left = report.standing
        standing = (left.network, left.orientations, left.rig) if left else ()
        made = dict(zip(PARTS, (standing, report.published, report.pointed), strict=True))
        document = {part: [ref.text for ref in refs if ref] for part, refs in made.items()}
        messages = {"notes": report.notes, "failures": report.failures}
        self.book.note(scope.name, key, document | messages)


def is_finished(report: SolReport) -> bool:
    """Whether a repeated run would have the same outcome."""
    return all(map(_will_fail_again, report.failures))


def _common(mission: str, workspace: Workspace, pipeline: str) -> Iterator[str]:
    yield f"{SCIENCE_VERSION} {version('solmap')} {tuple(ProductKind)}"
    yield repr(load_pipeline(pipeline))
    yield repr(landing_site(mission, Settings().landing_sites))
    for kind in (ProductKind.VECTORS, ProductKind.MANUAL_TIES, ProductKind.CONTROL):
        yield repr(workspace.catalogue.pointers(kind))
    left_out = read_map(mission, workspace).left_out
    if left_out:
        yield repr(sorted(entry.id for entry, _ in left_out))


def _images(mission: str, workspace: Workspace) -> dict[int, str]:
    entries = sorted(workspace.catalogue.images(mission), key=lambda entry: (entry.sol, entry.id))
    so_far, digests = hashlib.sha256(), {}
    for entry in entries:
        so_far.update(repr(entry).encode())
        digests[entry.sol] = so_far.hexdigest()
    return digests


def _will_fail_again(failure: str) -> bool:
    """Whether the images are at fault, and not a disk, a network or a program."""
    return not failure.startswith("publish ") and any(
        f": {name}: " in failure for name in _names_of(PhotogrammetryError)
    )


def _names_of(error: type[Exception]) -> Iterator[str]:
    yield error.__name__
    for narrower in error.__subclasses__():
        yield from _names_of(narrower)


def _digest(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


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
    _has_processed: bool = False
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
        clear_images()  # links of a later sol would need them
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
            done = None if self._has_processed else reusable.report(step.scope, step.sol, key)
            if done is None:
                if not self._has_processed:
                    reusable.forget(step.scope)
                self._has_processed = True
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


def withdraw_leftovers(
    mission: str, maps: Sequence[str], sols: Sequence[SolReport], workspace: Workspace
) -> list[str]:
    """Withdraw what none of the sols published; `sols` are all on the `maps` of a mission.

    After a transient failure everything stays: published layers are valid, and the next run
    decides.

    Returns:
        A line for each stop whose maps stay although no sol makes them any more.
    """
    if not sols or not all(map(is_finished, sols)):
        return []
    given = {(ref.kind, ref.scope) for sol in sols for ref in (*sol.published, *sol.pointed)}
    catalogue = workspace.catalogue
    known = [entry for entry in catalogue.missions() if mission_of(entry.mission) == mission]
    gone = [entry for entry in known if entry.mission not in maps]
    images = [image for name in maps for image in catalogue.images(name)]
    superseded = {ref.scope.name for sol in sols for ref in sol.published}
    has_pairs = {image.stop for image in images if image.partner is not None}
    kept: set[str] = set()
    for entry in known:
        layers, here = [], {image.stop for image in catalogue.images(entry.mission)}
        for layer in catalogue.layers(entry.mission):
            scope = layer.ref.scope
            if scope.level is not ScopeLevel.STOP:
                layers += [layer] if entry in gone else []
            elif layer.ref.kind in BY_COMMAND:
                layers += [] if scope.name in here else [layer]  # in a frame that is not its stop's
            elif (layer.ref.kind, scope) not in given:
                if scope.name in superseded or scope.name not in has_pairs:
                    layers.append(layer)
                else:
                    kept.add(scope.name)
        withdraw(entry, layers, _pointers(entry.mission, images, given, workspace), workspace)
    for entry in gone:
        if not catalogue.layers(entry.mission):
            catalogue.withdraw((), traverse_products(entry.mission, catalogue))
            catalogue.forget_map(entry.mission)
    return [f"{stop}: its maps are unchanged, because this run made none" for stop in sorted(kept)]


def _pointers(
    name: str, images: Sequence[ImageEntry], given: Latest, workspace: Workspace
) -> list[ProductRef]:
    """Products of a map's pairs, stops and sols in the catalogue that no sol made."""
    pairs = {pair_scope(image.id) for image in images}
    stops = {image.stop for image in images}
    levels = {ScopeLevel.PAIR, ScopeLevel.STOP, ScopeLevel.SOL}
    return [
        ref
        for kind in ProductKind
        if kind.level in levels
        for ref in workspace.catalogue.pointers(kind)
        if (ref.kind, ref.scope) not in given
        and (ref.scope in pairs or ref.scope.name in stops or is_of_mission(ref.scope, name))
    ]
