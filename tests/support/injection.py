"""Errors injected into calls of stages, and what must hold of the run that meets them.

A clean run of a small downlink is recorded: every call of every stage (whatever `@stage` decorates
below `solmap.tasks` is found), and which products it gave. Then one call raises, in a run into an
empty catalogue. What does not depend on that call, by the inputs that provenance lists, has to be
published as in the clean run; the failure has to be reported in one line; and a run without the
error has to end as the clean one.

    python -m tests.support.injection --errors 3 --seed 1
"""

from __future__ import annotations

import argparse
import errno
import hashlib
import importlib
import inspect
import pkgutil
import shutil
import sqlite3
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio.errors
import sqlalchemy.exc

from solmap.config.records import ConfigError
from solmap.photogrammetry.errors import (
    AdjustmentError,
    LabelError,
    MatchingError,
    PhotogrammetryError,
    TerrainError,
)
from solmap.products.catalogue.runs import FinishedSolRecords
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import LONGEST_LINE, ProductError, StoreAwayError
from solmap.products.model import ProductRef
from solmap.products.store.faults import is_transient
from tests.support.disorder import differences
from tests.support.small_downlink import COARSE, write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents, faults

MARK = "injected"
"""Is in the text of errors that have one."""
BY_COMMAND = {
    "adjust_simulated",
    "control_by_image",
    "draw_base",
    "fetch_images",
    "fetch_index",
    "fetch_raw_images",
    "find_raw_images",
    "keep_labels",
    "register_orbital",
    "write_truth",
}
"""Stages of commands that work on one thing, not of the flow of a downlink."""
NOT_REACHED = {"render_colour"}
"""Stages of the flow that thumbnails of one filter do not come to."""
KEEPS_STOPS = {
    "preview_pairs",
    "preview_terrain",
    "tie_stop",
    "tie_singles",
    "link_stops",
    "match_stereo_pair",
    "measure_rows",
    "pool_rig",
    "refine_rig",
    "report_quality",
    "match_wide_pair",
}
"""Stages after whose failure every stop still has its maps, from the remaining products."""
NEAR = {"dtm", "orthophoto", "slope", "contours", "hillshade"}


class OddError(Exception):
    """An error that cannot be printed."""

    def __str__(self) -> str:
        raise RuntimeError(MARK)


ERRORS: dict[str, Callable[[], Exception]] = {
    "value": lambda: ValueError(f"{MARK}\nTraceback (most recent call last):\n  File x\nboom"),
    "long": lambda: RuntimeError(f"{MARK} " + "line\n" * 5000),
    "surrogate": lambda: ValueError(f"{MARK} \udcff \x00 \x1b[31m [/red] 💥"),
    "overflow": lambda: OverflowError(f"{MARK}: int too large to convert to float"),
    "memory": MemoryError,
    "recursion": lambda: RecursionError(f"{MARK}: maximum recursion depth exceeded"),
    "decode": lambda: UnicodeDecodeError("utf-8", b"\xff", 0, 1, MARK),
    "encode": lambda: UnicodeEncodeError("utf-8", "\udcff", 0, 1, MARK),
    "key": lambda: KeyError(MARK),
    "index": IndexError,
    "type": lambda: TypeError(f"{MARK}: unsupported operand"),
    "assertion": AssertionError,
    "stop": lambda: StopIteration(MARK),
    "group": lambda: ExceptionGroup(MARK, [ValueError("one"), KeyError("two")]),
    "odd": OddError,
    "zero": lambda: ZeroDivisionError(f"{MARK}: division by zero"),
    "singular": lambda: np.linalg.LinAlgError(f"{MARK}: Singular matrix"),
    "opencv": lambda: cv2.error(f"{MARK}: (-215) assertion failed\n in function 'x'"),
    "raster": lambda: rasterio.errors.RasterioIOError(f"{MARK}: not recognized"),
    "denied": lambda: PermissionError(errno.EACCES, f"{MARK}: denied", "/a/file"),
    "missing": lambda: FileNotFoundError(errno.ENOENT, f"{MARK}: none", "/a/file"),
    "integrity": lambda: sqlalchemy.exc.IntegrityError("INSERT\n", {}, sqlite3.Error(MARK)),
    "statement": lambda: sqlalchemy.exc.StatementError(f"{MARK}\n(bad)", "SELECT\n", {}, None),
    "matching": lambda: MatchingError(f"{MARK}: no texture"),
    "terrain": lambda: TerrainError(f"{MARK}: no ground"),
    "adjustment": lambda: AdjustmentError(f"{MARK}: singular"),
    "label": lambda: LabelError(f"{MARK}: {'x' * 900}"),
    "product": lambda: ProductError(f"{MARK}: broken"),
    "config": lambda: ConfigError(f"{MARK}: wrong"),
    "input/output": lambda: OSError(errno.EIO, f"{MARK}: input/output error"),
    "reset": lambda: ConnectionResetError(errno.ECONNRESET, MARK),
    "away": lambda: StoreAwayError(f"{MARK}: away"),
}
"""By name; the last three are transient."""


def stages() -> dict[str, Any]:
    """All functions that `@stage` decorates, by name."""
    from prefect import Task  # noqa: PLC0415 - after the engine's settings

    import solmap.tasks  # noqa: PLC0415

    found: dict[str, Any] = {}
    for module in pkgutil.walk_packages(solmap.tasks.__path__, "solmap.tasks."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Task):
                found[value.fn.__name__] = value
    return found


@dataclass(frozen=True, slots=True)
class Call:
    """One call of a stage in a run."""

    stage: str
    arguments: str
    """Digest of what it was called with."""
    occurrence: int
    """How many calls with the same arguments came before."""
    made: frozenset[str] = frozenset()
    """The products that it gave."""

    @property
    def id(self) -> tuple[str, str, int]:
        """What distinguishes it from other calls, in every run over the same files."""
        return self.stage, self.arguments, self.occurrence


@dataclass(slots=True)
class Injection:
    """What is to be raised in a call, before or after its work."""

    call: Call
    error: Callable[[], Exception]
    is_after: bool = False
    was_raised: bool = False


@dataclass(slots=True)
class Watch:
    """Looks at all calls of stages; in one of them it raises."""

    injection: Injection | None = None
    calls: list[Call] = field(default_factory=list)
    _seen: Counter[tuple[str, str]] = field(default_factory=Counter)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def on(self) -> Iterator[None]:
        """Watch all stages; those that are tried again are without pauses."""
        tasks = stages()
        real = {name: (task.fn, task.retry_delay_seconds) for name, task in tasks.items()}
        try:
            for name, task in tasks.items():
                task.fn = self._watched(name, task.fn)
                task.retry_delay_seconds = 0
            yield
        finally:
            for name, (fn, pauses) in real.items():
                tasks[name].fn, tasks[name].retry_delay_seconds = fn, pauses

    def _watched(self, name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        shape = inspect.signature(work)

        @wraps(work)
        def watched(*args: Any, **kwargs: Any) -> Any:
            bound = shape.bind(*args, **kwargs).arguments
            reported = {
                key: repr(value)
                for key, value in bound.items()
                if key not in {"store", "workspace", "outcomes"} and not callable(value)
            }
            digest = hashlib.sha256(repr(reported).encode()).hexdigest()[:16]
            with self._lock:
                occurrence = self._seen[name, digest]
                self._seen[name, digest] += 1
            call = Call(name, digest, occurrence)
            injection = self.injection
            if injection is None or injection.call.id != call.id:
                made = work(*args, **kwargs)
            else:
                injection.was_raised = True
                if injection.is_after:
                    work(*args, **kwargs)
                raise injection.error()
            pointers = bound.get("pointers", ())
            refs = frozenset(_refs([made, *pointers]))
            with self._lock:
                self.calls.append(Call(name, digest, occurrence, refs))
            return made

        return watched


def _refs(value: Any) -> Iterator[str]:
    """All products that a result names."""
    if isinstance(value, ProductRef):
        yield _name(value)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _refs(one)
    else:
        for name in ("ref", "layers", "made", "matches", "parallax"):
            yield from _refs(getattr(value, name, ()))


def _name(ref: ProductRef) -> str:
    """As the inputs of provenance name it."""
    return f"{ref.kind}/{ref.scope}/{ref.digest}"


@dataclass(frozen=True, eq=False)
class CleanRun:
    """A small downlink, the store that an undisturbed run left, and the calls of its stages."""

    folder: Path
    downlink: Path
    pipeline: str
    store: Path
    calls: tuple[Call, ...]
    contents: Contents
    needs: dict[str, frozenset[str]]
    """Of every product those that it was made from, step by step."""

    @classmethod
    def of(cls, folder: Path, *, pairs: int = 4, layers: str = COARSE) -> CleanRun:
        """Write the downlink and process it. An image without partner is in it."""
        downlink = write_small_downlink(folder / "downlink", pairs=pairs)
        rights = sorted((downlink / "sol0156").rglob("2n*r0m1.img"))
        if pairs > 1:
            rights[-1].unlink()
        pipeline = str(write_coarse_pipeline(folder / "coarse.toml", layers))
        store, watch = folder / "clean", Watch()
        with watch.on():
            report = process(downlink, store, pipeline)
        assert report.succeeded, report.failures
        products = Workspace.open(store).store
        needs = {
            _name(ref): frozenset(products.provenance(ref)["recipe"]["inputs"])
            for ref in products.refs()
        }
        contents = Contents.of(store)
        return cls(folder, downlink, pipeline, store, tuple(watch.calls), contents, needs)

    def dependent(self, made: frozenset[str]) -> set[str]:
        """Products that depend on some, and these.

        Maps depend on the poses of the network of their stop's first sol, too, which their recipes
        hold as numbers; far ground on that of the last sol, which names the links. A network
        is adjusted from what the sol before left, its network and orientations together; the
        layers of the mission are drawn of the last sol that has both.
        """
        networks = [name for name in self.needs if name.startswith(("network/", "orientations/"))]
        found = set(made)
        while True:
            more = {name for name, inputs in self.needs.items() if inputs & found} - found
            for network in found.intersection(networks):
                sol = network.split("/")[1]
                more |= {name for name in self.needs if self._is_drawn_with(name, sol)} - found
                more |= {name for name in networks if name.split("/")[1] > sol} - found
                more |= {name for name in self.needs if "-" not in name.split("/")[1]} - found
            if not more:
                return found
            found |= more

    def _is_drawn_with(self, name: str, network: str) -> bool:
        kind, scope, _ = name.split("/")
        last = max(one.split("/")[1] for one in self.needs if one.startswith("network/"))
        if kind in {"ties", "links", "quicklook"} or "-site" not in scope:
            return "-with-" in scope and network == last
        stops = sorted({image["stop"] for image in self.contents.rows["images"].values()})
        first = f"mer2-sol{155 + stops.index(scope):04d}" if scope in stops else last
        return network == (last if kind.startswith("far") else first)


def process(downlink: Path, store: Path, pipeline: str) -> Any:
    """Run the flow of a downlink."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    return process_downlink(downlink, store, pipeline)


def violations(clean: CleanRun, injection: Injection, *, from_nothing: bool = False) -> list[str]:
    """What does not hold for a run with an error, a line each.

    Args:
        clean: What the run is compared with.
        injection: What is raised, and where.
        from_nothing: Make all products again; else those of the clean run are looked up, except
            what the call makes: it would not come.
    """
    from solmap.tasks.stage import Stage  # noqa: PLC0415 - after the engine's settings

    root = Path(tempfile.mkdtemp(prefix="faulty-", dir=clean.folder))
    try:
        if not from_nothing:
            shutil.copytree(clean.store / "products", root / "products")
            if isinstance(stages()[injection.call.stage], Stage):
                for name in injection.call.made:
                    for file in (root / "products").glob(f"{name}.*"):
                        file.unlink()
        return _violations(clean, injection, root)
    finally:
        shutil.rmtree(root)


def _violations(clean: CleanRun, injection: Injection, root: Path) -> list[str]:
    error, found = injection.error(), list[str]()
    with Watch(injection).on():
        try:
            report = process(clean.downlink, root, clean.pipeline)
        except ProductError as stopped:
            report = None
            if injection.call.stage != "ingest_downlink" or not _is_line(str(stopped)):
                found.append(f"the flow ended: {type(stopped).__name__}: {str(stopped)[:300]!r}")
        except Exception as stopped:  # noqa: BLE001 - must not be
            return [f"the flow crashed: {type(stopped).__name__}: {str(stopped)[:300]!r}"]
    if not injection.was_raised:
        return ["the call did not come"]
    if report is not None:
        found += _missing(clean, injection.call, root, is_transient=is_transient(error))
        found += _untold(report, root, error)
    found += _not_repaired(clean, root, error)
    return found


def _missing(clean: CleanRun, call: Call, root: Path, *, is_transient: bool) -> list[str]:
    """What is not published although it does not depend on a call."""
    there = Contents.of(root).rows["latest"]
    expected = clean.contents.rows["latest"]
    dependent = clean.dependent(frozenset() if is_transient else call.made)
    moves = any(name.startswith("network/") for name in dependent)
    lines = []
    for key, digest in expected.items():
        scope, kind = key.rsplit("/", 1)
        is_free = f"{kind}/{scope}/{digest}" not in dependent
        is_kept = call.stage in KEEPS_STOPS and kind in NEAR
        if (is_free or is_kept) and key not in there:
            lines.append(f"{key} is missing")
        elif is_free and not moves and there[key] != digest:
            lines.append(f"{key} is another")
    return lines


def _untold(report: Any, root: Path, error: Exception) -> list[str]:
    """Lines for errors that the report and the outcomes of the store do not name."""
    reported = [*report.failures, *(note for sol in report.sols for note in sol.notes)]
    kept = [note for one in Workspace.open(root).catalogue.outcomes() for note in one.notes]
    lines = [f"no line: {line[:200]!r}" for line in (*reported, *kept) if not _is_line(line)]
    if is_transient(error):
        return lines + [f"reported, but it passed: {line}" for line in report.failures]
    for where, texts in (("report", reported), ("outcomes", kept)):
        if not any(MARK in text or type(error).__name__ in text for text in texts):
            lines.append(f"the {where} does not report {type(error).__name__}")
    return lines


def _is_line(text: str) -> bool:
    return len(text) < LONGEST_LINE + 300 and all(one.isprintable() for one in text)


def _not_repaired(clean: CleanRun, root: Path, error: Exception) -> list[str]:
    """What differs from the clean run when the error is gone and the downlink comes again."""
    if isinstance(error, PhotogrammetryError):  # of the images: they have to change
        book = FinishedSolRecords(Workspace.open(root).catalogue.engine)
        book.forget("mer2-sol0000", "mer2-sol")
    report = process(clean.downlink, root, clean.pipeline)
    end = Contents.of(root)
    lost = clean.contents.products.items() - end.products.items()
    return [
        *(f"fails again: {line}" for line in report.failures),
        *differences(clean.contents, end)[:5],
        *(f"lost or changed: {name}" for name, _ in sorted(lost)[:5]),
        *faults(root)[:5],
        *(f"still failed: {row}" for row in end.rows["outcomes"].values() if row["is_failure"]),
    ]


def chosen(clean: CleanRun, stage: str, rng: np.random.Generator, name: str) -> Injection:
    """An error in a random call of a stage."""
    calls = sorted((call for call in clean.calls if call.stage == stage), key=lambda c: c.id)
    call = calls[int(rng.integers(len(calls)))]
    return Injection(call, ERRORS[name], is_after=bool(rng.integers(2)))


def main() -> None:
    """Every stage with a number of errors; a line for each violation, and how many there were."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--errors", type=int, default=3, help="errors a stage")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stage", help="this one only")
    parser.add_argument("--error", help="this one only")
    arguments = parser.parse_args()
    from solmap.flows.runtime.engine import prepare_engine  # noqa: PLC0415 - before Prefect is imported

    with tempfile.TemporaryDirectory(prefix="injection-") as name:
        folder = Path(name)
        prepare_engine(folder / "engine")
        from prefect.testing.utilities import prefect_test_harness  # noqa: PLC0415

        with prefect_test_harness(server_startup_timeout=300):
            began = time.monotonic()
            clean = CleanRun.of(folder)
            print(f"clean run: {len(clean.calls)} calls, {time.monotonic() - began:.0f} s")  # noqa: T201
            _sweep(clean, arguments)


def _sweep(clean: CleanRun, arguments: argparse.Namespace) -> None:
    rng = np.random.default_rng(arguments.seed)
    names = sorted(stages().keys() - BY_COMMAND - NOT_REACHED)
    runs = bad = 0
    for stage in [arguments.stage] if arguments.stage else names:
        errors = rng.permutation(sorted(ERRORS))[: arguments.errors]
        for error in [arguments.error] if arguments.error else errors:
            injection, began = chosen(clean, stage, rng, str(error)), time.monotonic()
            lines = violations(clean, injection, from_nothing=runs % 8 == 7)
            runs, bad = runs + 1, bad + bool(lines)
            when = "after" if injection.is_after else "before"
            took_s = time.monotonic() - began
            print(f"{stage} {when} {error}: {lines or 'holds'} ({took_s:.0f} s)", flush=True)  # noqa: T201
    print(f"{len(names)} stages, {runs} injections, {bad} with violations")  # noqa: T201


if __name__ == "__main__":
    main()
