"""Small downlinks in a row under `solmap up`: does anything grow that should not?

    python -m tests.support.many_downlinks --count 300 --folder FOLDER

The inbox holds a stereo pair of thumbnails of each of a few stops of a simulated traverse; every
downlink brings a later edition of the pair of one stop, as ground processing delivers images again.
So what is published stays as large as it is, and each downlink is processed whole: ingested,
matched, adjusted, mapped, published. Old products are removed now and then (`solmap prune`). A
client reads layers, tiles, features and whole products all the while.

Days pass faster than they do: what Prefect's server and the catalogue have noted of runs longer
than `AGE_S` ago is dated back to the year 2000, so that what trims old records has work.

Written down after every downlink: seconds it took, and of every process memory, open files and
threads; now and then rows of the databases and files of the store. FOLDER/many_downlinks.jsonl has
a line a downlink, many_downlinks.png and .json the figure and its numbers. After an interruption
`--only-figure` continues with the existing figures.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from solmap.flows.runtime.children import module_command
from solmap.flows.runtime.engine import free_port
from tests.support.crash_targets import Onlooker
from tests.support.small_downlink import FEW_LAYERS, write_coarse_pipeline, write_small_downlink

AGE_S = 600.0
LONGEST_S = 600.0
EVERY = 5
"""Rows and files are counted, and records dated back, once per this many downlinks."""
_CREATED = re.compile(rb"(PRODUCT_CREATION_TIME *= *)([0-9T:.-]{23})")
PARTS = {"up": "", "engine": "prefect", "scheduler": "deployments", "map": "serve"}
"""Long-running processes of `solmap up`, and the word of their command that identifies them."""


class Reader(Onlooker):
    """A client that notes how long answers take."""

    def __init__(self, port: int) -> None:
        super().__init__(port, every_s=0.2)
        self.latencies: list[float] = []

    def _requested(self, client: httpx.Client, url: str) -> httpx.Response | None:
        began = time.perf_counter()
        try:
            return super()._requested(client, url)
        finally:
            self.latencies.append(time.perf_counter() - began)

    def taken(self) -> list[float]:
        """The latencies since the last call."""
        taken, self.latencies = self.latencies, []
        return taken


@dataclass
class Rig:
    """`solmap up` on a store of its own, and what is delivered to it."""

    folder: Path
    stops: int
    port: int = field(default_factory=free_port)
    editions: Counter[int] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        first = self.folder / "first"
        if not first.exists():
            write_small_downlink(first, stops=self.stops, pairs=1)
        pipeline = FEW_LAYERS.replace("[wide]\nenabled = true", "[wide]\nenabled = false")
        write_coarse_pipeline(self.folder / "coarse.toml", f"{pipeline}[region]\nenabled = false\n")
        images = sorted(first.rglob("*.img"))
        sols = sorted({path.parts[len(first.parts)] for path in images})
        self.pairs = [[path for path in images if sol in path.parts] for sol in sols]
        self.others = list(first.rglob("*.[rs]vf"))
        self.inbox.mkdir(exist_ok=True)

    @property
    def inbox(self) -> Path:
        return self.folder / "inbox"

    @property
    def store(self) -> Path:
        return self.folder / "store"

    @property
    def printed(self) -> str:
        return (self.folder / "up.log").read_text()

    def start(self) -> psutil.Popen:
        """Start `solmap up`, and wait until the map answers."""
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")} | {
            "SOLMAP_PIPELINE": str(self.folder / "coarse.toml"),
            "SOLMAP_INBOX_SETTLE_S": "1",
            "SOLMAP_ENGINE_PORT": str(free_port()),
            "PREFECT_RUNNER_POLL_FREQUENCY": "1",
            "PREFECT_SERVER_SERVICES_DB_VACUUM_LOOP_SECONDS": "120",
        }
        options = ("--store", str(self.store), "--inbox", str(self.inbox))
        command = module_command("solmap.flows.cli", "up", *options, "--port", str(self.port))
        with (self.folder / "up.log").open("wb") as log:
            process = psutil.Popen(command, env=environment, stdout=log, stderr=log)
        while "map at" not in self.printed:
            if process.poll() is not None:
                raise RuntimeError(self.printed)
            time.sleep(0.5)
        return process

    def deliver(self, number: int) -> None:
        """Bring the first or a later edition of a stop's pair, at first with the mission's files.

        Files come under another name and are renamed, as transfers do.
        """
        stop = number % self.stops
        for path in [*self.pairs[stop], *(self.others if number == 0 else ())]:
            target = self.inbox / path.relative_to(self.folder / "first")
            target.parent.mkdir(parents=True, exist_ok=True)
            draft = target.with_name(target.name + ".part")
            draft.write_bytes(_edition(path.read_bytes(), self.editions[stop]))
            draft.replace(target)
        self.editions[stop] += 1

    def await_processed(self, before: int) -> str:
        """Wait until the run of the inbox has ended; how."""
        end = time.monotonic() + LONGEST_S
        while (
            len(ends := re.findall(r"the inbox was processed|the run of the inbox", self.printed))
            <= before
        ):
            if time.monotonic() > end:
                return "timeout"
            time.sleep(0.2)
        return "done" if "processed" in ends[-1] else "failed"

    def prune(self) -> str:
        """Remove what nothing refers to."""
        command = module_command("solmap.flows.cli", "prune", "--store", str(self.store))
        options = ("--older-than", "0", "--versions", "1", "--yes")
        done = subprocess.run((*command, *options), capture_output=True, text=True, check=False)
        return done.stdout.strip().splitlines()[-1] if done.stdout else done.stderr

    def rows(self) -> dict[str, int]:
        """Rows of both databases, by table."""
        found: dict[str, int] = {}
        for name, path in self._databases().items():
            with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as file:
                query = "SELECT name FROM sqlite_master WHERE type = 'table'"
                for (table,) in file.execute(query).fetchall():
                    count = file.execute(f'SELECT count(*) FROM "{table}"').fetchone()[0]  # noqa: S608
                    found[f"{name}.{table}"] = count
        return found

    def let_days_pass(self) -> None:
        """Date back what the databases have noted of runs some time ago."""
        before = datetime.now(UTC) - timedelta(seconds=AGE_S)
        times = {"prefect": before.strftime("%Y-%m-%d %H:%M:%S"), "catalogue": before.isoformat()}
        columns = {
            "prefect": {
                "flow_run": "end_time",
                "events": "occurred",
                "event_resources": "occurred",
            },
            "catalogue": {"runs": "started_at", "events": "at"},
        }
        for name, path in self._databases().items():
            with contextlib.closing(sqlite3.connect(path, timeout=60)) as file:
                for table, column in columns[name].items():
                    query = f"UPDATE {table} SET {column} = '2000' || substr({column}, 5) "  # noqa: S608
                    file.execute(
                        f"{query} WHERE {column} < ? AND {column} > '2001'", (times[name],)
                    )
                file.commit()

    def _databases(self) -> dict[str, Path]:
        return {
            "catalogue": self.store / "catalogue.sqlite",
            "prefect": self.store / "prefect" / "prefect.db",
        }


def _edition(data: bytes, number: int) -> bytes:
    """A file as it is made again so many hours later."""
    found = _CREATED.search(data)
    if found is None:
        return data
    at = datetime.fromisoformat(found[2].decode()) + timedelta(hours=number)
    return _CREATED.sub(found[1] + at.isoformat(timespec="milliseconds").encode(), data)


def processes(up: psutil.Process) -> dict[str, dict[str, float]]:
    """Memory, open files and threads of each part; the run of a downlink comes and goes."""
    figures = {}
    for process in [up, *up.children()]:
        with contextlib.suppress(psutil.Error):
            words = " ".join(process.cmdline())
            names = [name for name, word in PARTS.items() if word and word in words]
            name = "up" if process.pid == up.pid else next(iter(names), None)
            if name is not None:
                figures[name] = {
                    "mb": round(process.memory_full_info().uss / 1e6, 1),
                    "files": process.num_fds(),
                    "threads": process.num_threads(),
                }
    return figures


def walk(rig: Rig, count: int, prune_every: int) -> Iterator[dict[str, Any]]:
    """The figures of each downlink."""
    up = rig.start()
    reader = Reader(rig.port)
    reader.start()
    try:
        for number in range(count):
            before = len(re.findall(r"the inbox was processed|the run of the inbox", rig.printed))
            began = time.monotonic()
            rig.deliver(number)
            ended = rig.await_processed(before)
            spent = time.monotonic() - began
            row: dict[str, Any] = {
                "downlink": number + 1,
                "ended": ended,
                "seconds": round(spent, 2),
            }
            if (number + 1) % prune_every == 0:
                row["pruned"] = rig.prune()
            row["processes"] = processes(up)
            taken = reader.taken()
            row["requests"] = len(taken)
            if taken:
                row |= {
                    f"p{p}_ms": round(float(np.percentile(taken, p)) * 1e3, 1) for p in (50, 95)
                }
            row["faults"] = Counter(fault[:100] for fault in reader.faults)
            reader.faults.clear()
            if number % EVERY == 0 or number + 1 == count:
                rig.let_days_pass()
                row["rows"] = rig.rows()
                row["store_files"] = sum(1 for path in rig.store.rglob("*") if path.is_file())
            yield row
    finally:
        reader.stop()
        up.send_signal(signal.SIGTERM)
        with contextlib.suppress(psutil.Error):
            up.wait(15.0)
            up.kill()


def image(rows: list[dict[str, Any]]) -> Figure:
    """Memory, open files, rows and files, latency and seconds by downlink."""
    figure = Figure(figsize=(9.0, 11.0), layout="constrained")
    memory, files, records, latency, seconds = figure.subplots(5, 1, sharex=True)
    at = np.array([row["downlink"] for row in rows])
    for axes, key, label in ((memory, "mb", "memory, MB"), (files, "files", "open files")):
        for name in PARTS:
            axes.plot(
                at, [row["processes"].get(name, {}).get(key, np.nan) for row in rows], label=name
            )
        axes.set(ylabel=label, ylim=(0, None))
        axes.legend(fontsize=8, ncols=4)
    counted = [row for row in rows if "rows" in row]
    when = [row["downlink"] for row in counted]
    for name in ("prefect", "catalogue"):
        total = [sum(n for t, n in row["rows"].items() if t.startswith(name)) for row in counted]
        records.plot(when, total, label=f"rows of {name}")
    records.plot(when, [row["store_files"] for row in counted], label="files of the store")
    records.set(ylabel="number", yscale="log")
    records.legend(fontsize=8, ncols=3)
    for name in ("p50_ms", "p95_ms"):
        latency.plot(at, [row.get(name, np.nan) for row in rows], label=name.partition("_")[0])
    latency.set(ylabel="answers, ms", ylim=(0, None))
    latency.legend(fontsize=8)
    seconds.plot(at, [row["seconds"] for row in rows])
    seconds.set(ylabel="a downlink, s", xlabel="downlink", ylim=(0, None))
    for axes in (memory, files, records, latency, seconds):
        axes.grid(alpha=0.3)
    return figure


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of an early and of the last tenth; the first tenth warms up and is left out."""
    tenth = max(len(rows) // 10, 1)
    spans = {"early": rows[tenth : 2 * tenth] or rows, "end": rows[-tenth:]}
    found: dict[str, Any] = {
        "downlinks": len(rows),
        "ended": dict(Counter(row["ended"] for row in rows)),
        "requests": sum(row["requests"] for row in rows),
        "faults": dict(sum((Counter(row["faults"]) for row in rows), Counter())),
    }
    for span, of in spans.items():
        counted = [row for row in of if "rows" in row] or [row for row in rows if "rows" in row][
            -1:
        ]
        found[span] = {
            "seconds": float(np.median([row["seconds"] for row in of])),
            **{
                p: float(np.median([row[p] for row in of if p in row]))
                for p in ("p50_ms", "p95_ms")
            },
            "processes": {
                name: {
                    key: float(
                        np.median(
                            [row["processes"][name][key] for row in of if name in row["processes"]]
                        )
                    )
                    for key in ("mb", "files", "threads")
                }
                for name in PARTS
                if any(name in row["processes"] for row in of)
            },
            "rows": {
                table: float(np.median([row["rows"].get(table, 0) for row in counted]))
                for table in counted[-1]["rows"]
            },
            "store_files": float(np.median([row["store_files"] for row in counted])),
        }
    return found


def main() -> None:
    """Deliver as often as requested; write the figures."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.many_downlinks")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--stops", type=int, default=2)
    parser.add_argument("--prune-every", type=int, default=10)
    parser.add_argument("--only-figure", action="store_true", help="of what was written down")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    path = folder / "many_downlinks.jsonl"
    if not arguments.only_figure:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        rig = Rig(folder, arguments.stops)
        with path.open("w") as file, contextlib.suppress(KeyboardInterrupt):
            for row in walk(rig, arguments.count, arguments.prune_every):
                file.write(json.dumps(row) + "\n")
                file.flush()
                shown = {k: v for k, v in row.items() if k not in {"rows", "processes"}}
                sys.stdout.write(f"{time.strftime('%H:%M:%S')} {json.dumps(shown)}\n")
                sys.stdout.flush()
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    figure = image(rows)
    FigureCanvasAgg(figure)
    figure.savefig(folder / "many_downlinks.png", dpi=110)
    found = summary(rows)
    (folder / "many_downlinks.json").write_text(json.dumps(found, indent=1))
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
