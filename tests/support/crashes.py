"""Kill flows, maintenance and servers at random moments; compare with an undisturbed run.

    python -m tests.support.crashes --kills 200 --seed 0 [--folder FOLDER]

A downlink is processed into an empty store, its process killed, started again, killed again, until
a run gets to its end; then the store is compared with that of an undisturbed run, byte for byte,
and the next store is begun. A server of the store is killed now and then at the same moment; a
client requests tiles, features and products from it all the while. Between the runs, and beside
them, the store is pruned, backed up, repaired and migrated from the version that had no number, and
these are killed too. After every kill the store is looked through, and the newest backup.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import psutil

from solmap.flows.runtime.children import Child
from solmap.flows.runtime.engine import await_engine, engine_child, free_port, use_engine
from solmap.products.catalogue.maintenance.backups import restore
from solmap.products.catalogue.workspace import Workspace
from tests.support.kill_moments import Moment, Watch
from tests.support.small_downlink import write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents, faults

MARK = "SOLMAP_CRASH_TEST"
"""In the environment of everything that a crash test starts."""
LONGEST_RUN_S = 600.0
ROOT = Path(__file__).resolve().parents[2]


@dataclass
class Tally:
    """What was killed, and what was found."""

    killed: Counter[str] = field(default_factory=Counter)
    moments: Counter[str] = field(default_factory=Counter)
    stores: int = 0
    """Runs that got to their end, and were compared."""
    restored: int = 0
    """Backups that were restored, and looked through."""
    answers: Counter[str] = field(default_factory=Counter)
    found: list[str] = field(default_factory=list)

    @property
    def kills(self) -> int:
        return sum(self.killed.values())

    def row(self) -> dict[str, object]:
        """The summary."""
        kinds = ("lost", "broken", "doubled", "changed", "orphan")
        named = {kind: sum(kind in line for line in self.found) for kind in kinds}
        return {
            "kills": self.kills,
            "of": dict(self.killed),
            "after": dict(self.moments),
            "stores compared": self.stores,
            "backups restored": self.restored,
            **named,
            "other faults": len(self.found) - sum(named.values()),
            "requests to the server": dict(self.answers),
        }


@dataclass
class CrashTest:
    """A downlink, the undisturbed store, and the means to disturb others."""

    folder: Path
    rng: np.random.Generator
    context: ForkServerContext
    tally: Tally = field(default_factory=Tally)
    known: set[int] = field(default_factory=set)
    """Processes that are to live on."""
    longest_s: float = 30.0
    early: float = 0.5
    """Share of the kills that come soon after a run was started: a killed run costs least then."""

    @property
    def downlink(self) -> Path:
        return self.folder / "downlink"

    @property
    def pipeline(self) -> Path:
        return self.folder / "coarse.toml"

    def flow(self, store: Path, downlink: Path | None = None) -> BaseProcess:
        """A process that takes the downlink, or another, into a store."""
        from tests.support.crash_targets import process  # noqa: PLC0415

        log = self.folder / "flow.log"
        started = self.context.Process(
            target=process,
            args=(downlink or self.downlink, store, self.pipeline, log),
            daemon=True,
        )
        started.start()
        return started

    def maintenance(self, what: str, store: Path) -> BaseProcess:
        """A process that maintains a store."""
        from tests.support.crash_targets import maintain  # noqa: PLC0415

        arguments = (what, store, self.backups, self.folder / "maintenance.log")
        started = self.context.Process(target=maintain, args=arguments, daemon=True)
        started.start()
        return started

    @property
    def backups(self) -> Path:
        return self.folder / "backups"

    def server(self, store: Path, port: int) -> BaseProcess:
        """A process that serves a store."""
        from tests.support.crash_targets import await_server, serve  # noqa: PLC0415

        started = self.context.Process(
            target=serve, args=(store, port, self.folder / "server.log"), daemon=True
        )
        started.start()
        self.known.add(started.pid or 0)
        await_server(port)
        return started

    def undisturbed(self) -> Contents:
        """The products of an undisturbed run, and its duration."""
        store = self.folder / "undisturbed"
        if not store.exists():
            began = time.monotonic()
            run = self.flow(store)
            run.join(LONGEST_RUN_S)
            if run.exitcode != 0:
                raise RuntimeError(f"the undisturbed run ended with {run.exitcode}, see flow.log")
            self.longest_s = time.monotonic() - began
        return Contents.of(store)

    def disturb_one_store(self, number: int, kills: int, expected: Contents) -> None:
        """Kill run after run into one store until one ends, then compare."""
        from tests.support.crash_targets import Onlooker  # noqa: PLC0415

        store = self.folder / f"store-{number}"
        shutil.rmtree(store, ignore_errors=True)
        shutil.rmtree(self.backups, ignore_errors=True)
        Workspace.open(store)
        port = free_port()
        server, onlooker = self.server(store, port), Onlooker(port)
        onlooker.start()
        before: set[str] = set()
        while True:
            beside = self._maintain_beside(store)
            run = self.flow(store)
            moment = Moment.draw(self.rng, self.longest_s, self.early)
            if self.tally.kills >= kills or not self._kill_at(moment, run, store):
                run.join(LONGEST_RUN_S)
                self._end(beside)
                if run.exitcode == 0:
                    break
                self.tally.found.append(f"run ended with {run.exitcode}")
                if self.tally.kills >= kills:
                    break
                continue
            if self.rng.random() < 0.25:
                server.kill()
                server.join()
                self.tally.killed["server"] += 1
                server = self.server(store, port)
            self._end(beside)
            before = self._look_through(store, before)
            if self._maintain(store):
                before = self._look_through(store, set())
            print_line(self.tally)
        self._look_through(store, before)
        self._restore_newest()
        self.tally.found += expected.differences(Contents.of(store))
        self.tally.stores += 1
        onlooker.stop()
        server.kill()
        server.join()
        self.tally.answers.update(onlooker.answers)
        self.tally.found += onlooker.faults
        shutil.rmtree(store)

    def _kill_at(self, moment: Moment, run: BaseProcess, store: Path) -> bool:
        with Watch(store) as watch:
            if not watch.reaches(moment, run.is_alive, LONGEST_RUN_S):
                return False
        if not run.is_alive():
            return False
        run.kill()
        run.join()
        self.tally.killed["flow"] += 1
        self.tally.moments[str(moment.step)] += 1
        return True

    def _maintain_beside(self, store: Path) -> tuple[str, BaseProcess] | None:
        """Now and then maintenance begins beside a run; that may have it refused, or wait for it.

        Where there is something to prune, a run would not end as the undisturbed one does.
        """
        from tests.support.crash_targets import Maintenance  # noqa: PLC0415

        if self.rng.random() < 0.7:
            return None
        what = self.rng.choice([Maintenance.BACKUP, Maintenance.BACKUP, Maintenance.REPAIR])
        return what, self.maintenance(Maintenance(what), store)

    def _end(self, beside: tuple[str, BaseProcess] | None) -> None:
        """Kill what was begun beside a run, or see how it ended."""
        if beside is None:
            return
        what, process = beside
        if process.is_alive():
            process.kill()
            self.tally.killed[f"{what} beside a run"] += 1
        process.join()
        if process.exitcode not in (0, -signal.SIGKILL):
            self.tally.found.append(f"{what} beside a run ended with {process.exitcode}")

    def _maintain(self, store: Path) -> bool:
        """Now and then maintain the store while no run goes on, and mostly kill that."""
        from tests.support.crash_targets import Maintenance, downgrade  # noqa: PLC0415

        if self.rng.random() < 0.4 or not (store / "catalogue.sqlite").exists():
            return False
        what = Maintenance(self.rng.choice(list(Maintenance)))
        if what is Maintenance.MIGRATION:
            downgrade(store)
        process = self.maintenance(what, store)
        process.join(float(self.rng.uniform(0.0, 0.2 if what is Maintenance.MIGRATION else 1.0)))
        if process.is_alive() and self.rng.random() < 0.9:
            process.kill()
            self.tally.killed[str(what)] += 1
        process.join(LONGEST_RUN_S)
        if process.exitcode not in (0, -signal.SIGKILL):
            self.tally.found.append(f"{what} ended with {process.exitcode}")
        return True

    def _restore_newest(self) -> None:
        """A backup that is offered can be restored, whole, and the store is sound."""
        if not any((self.backups / "backups").glob("*")):
            return
        restored = self.folder / "restored"
        shutil.rmtree(restored, ignore_errors=True)
        report = restore(self.backups, restored)
        self.tally.found += [f"broken in a backup: {name}" for name in report.broken]
        self.tally.found += [f"restored: {line}" for line in faults(restored)]
        self.tally.restored += 1

    def _look_through(self, store: Path, before: set[str]) -> set[str]:
        """Take down what is wrong; the products that are there now."""
        self.tally.found += faults(store)
        now = set(products_in(store))
        self.tally.found += [f"lost {name}" for name in sorted(before - now)]
        self.tally.found += [f"orphan {line}" for line in orphans(self.known)]
        return now


def products_in(store: Path) -> Iterator[str]:
    """Files below the folder of products."""
    folder = store / "products"
    return (str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())


def orphans(known: set[int], patience_s: float = 0.0) -> list[str]:
    """Processes of a crash test whose parent is gone and that are not to live on."""
    end = time.monotonic() + patience_s
    while found := list(_orphans(known)):
        if time.monotonic() >= end:
            break
        time.sleep(0.2)
    return found


def _orphans(known: set[int]) -> Iterator[str]:
    for process in psutil.process_iter(["pid", "ppid", "status"]):
        with contextlib.suppress(psutil.Error):
            is_ours = process.environ().get(MARK) == os.environ.get(MARK)
            if is_ours and process.ppid() == 1 and process.pid not in known:
                yield f"{process.pid} {' '.join(process.cmdline())[:100]}"


def kill_commands(test: CrashTest, kills: int, expected: Contents) -> None:
    """The same with `solmap run` as people call it, its server of Prefect included."""
    store = test.folder / "commands"
    shutil.rmtree(store, ignore_errors=True)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")}
    command = [
        sys.executable,
        "-m",
        "solmap.flows.cli",
        "run",
        str(test.downlink),
        "--store",
        str(store),
    ]
    command += ["--pipeline", str(test.pipeline)]
    done = 0
    while True:
        with (test.folder / "command.log").open("ab") as log:
            run = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        if done == kills:
            if run.wait(LONGEST_RUN_S) != 0:
                test.tally.found.append(f"solmap run ended with {run.returncode}")
            break
        while run.poll() is None and not (store / "catalogue.sqlite").exists():
            time.sleep(0.2)
        time.sleep(float(test.rng.uniform(0.0, test.longest_s)))
        if run.poll() is not None:
            break
        children = psutil.Process(run.pid).children(recursive=True)
        victim = "Prefect's server" if children and done % 3 == 2 else "solmap run"
        if victim == "solmap run":
            run.send_signal(signal.SIGKILL)
        else:
            children[0].kill()
            test.tally.moments["Prefect's server lost"] += 1
        with contextlib.suppress(subprocess.TimeoutExpired):
            run.wait(180.0)
        if run.poll() is None:
            test.tally.found.append("solmap run hangs without Prefect's server")
            run.kill()
            run.wait()
        test.tally.killed[victim] += 1
        done += 1
        test.tally.found += [f"orphan {line}" for line in orphans(test.known, 20.0)]
        test.tally.found += faults(store)
        print_line(test.tally)
    test.tally.found += [f"commands: {d}" for d in expected.differences(Contents.of(store))]
    test.tally.stores += 1


def print_line(tally: Tally) -> None:
    """Print how far it is."""
    now = time.strftime("%H:%M:%S")
    print(f"{now} {tally.kills} kills, {tally.stores} stores, {tally.found[-3:]}", flush=True)  # noqa: T201


@contextlib.contextmanager
def prepared(folder: Path, seed: int, *, pairs: int = 3) -> Iterator[CrashTest]:
    """A downlink, and one engine that outlives the flows."""
    os.environ[MARK] = str(os.getpid())
    sys.path.insert(0, str(ROOT))  # for what is forked
    os.environ["PYTHONPATH"] = f"{ROOT / 'src'}{os.pathsep}{ROOT}"
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "coarse.toml").exists():
        write_small_downlink(folder / "downlink", pairs=pairs)
        write_coarse_pipeline(folder / "coarse.toml")
    engine = _engine(folder)
    os.environ["PREFECT_LOGGING_LEVEL"] = "ERROR"
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.support.crash_targets"])
    test = CrashTest(folder, np.random.default_rng(seed), context)
    test.known |= {os.getpid(), engine.process.pid if engine and engine.process else 0}
    try:
        yield test
    finally:
        if engine:
            engine.stop()


def _engine(folder: Path) -> Child | None:
    """A server of Prefect for all flows; None where the environment names one."""
    if os.environ.get("PREFECT_API_URL"):
        return None
    port = free_port()
    os.environ["PREFECT_HOME"] = str(folder / "prefect")
    (folder / "prefect").mkdir(exist_ok=True)
    engine = engine_child(folder, port, has_pages=False)
    engine.start()
    await_engine(engine, port)
    use_engine(folder, port)
    return engine


def main() -> None:
    """Kill as often as requested, and print the findings."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.crashes", description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--commands", type=int, default=0, help="of them, kills of `solmap run`")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--early", type=float, default=0.5, help="share of moments soon after start"
    )
    parser.add_argument("--folder", type=Path, default=None)
    arguments = parser.parse_args()
    folder = arguments.folder or Path(tempfile.mkdtemp(prefix="crashes-"))
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # reports what was found until then
    with prepared(folder.resolve(), arguments.seed) as test, contextlib.suppress(KeyboardInterrupt):
        test.early = arguments.early
        expected = test.undisturbed()
        if arguments.commands:
            kill_commands(test, arguments.commands, expected)
        number = 0
        while test.tally.kills < arguments.kills:
            test.disturb_one_store(number, arguments.kills, expected)
            number += 1
            print_line(test.tally)
    print(json.dumps(test.tally.row(), indent=1))  # noqa: T201
    print("\n".join(test.tally.found))  # noqa: T201
    sys.exit(1 if test.tally.found else 0)


if __name__ == "__main__":
    main()
