"""Everything on one machine: Prefect's server, the scheduled flows, the map, and the watched inbox.

`solmap up` starts them as children that never outlive it, restarts those that end, submits the
inbox when its files are complete, and stops all in order.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from solmap.config.settings import Settings
from solmap.flows.runtime.children import Child, module_command
from solmap.flows.runtime.engine import (
    address,
    await_engine,
    engine_child,
    leave_folder,
    port_file,
    prepare_engine,
    use_engine,
)
from solmap.flows.service.inbox import Inbox, InboxParams

if TYPE_CHECKING:
    from solmap.flows.service.submission import SubmittedRun

CHECK_EVERY_S = 2.0
_STOP_S = 2.5
"""Seconds after which a stopping process is killed."""
_STUCK_S = 300.0
"""Delay of a run, while none is in progress, that shows that the scheduler does not work."""


@dataclass(slots=True)
class Machine:
    """The processes and messages of `solmap up`; its settings have absolute paths."""

    settings: Settings
    report: Callable[[str], None]
    _children: dict[str, Child] = field(default_factory=dict)
    _inbox: Inbox | None = None
    _running: SubmittedRun | None = None
    _scheduler_died: bool = False
    _stuck_checked_at: float = 0.0
    _problem: str = ""

    @property
    def store(self) -> Path:
        """Folder of products and catalogue."""
        return self.settings.store

    @property
    def engine_url(self) -> str:
        """Address of Prefect's server and run pages."""
        return address(self.settings.engine_port)

    def start(self) -> None:
        """Start all children in the order in which they need each other.

        Raises:
            TimeoutError: Prefect's server does not answer.
        """
        leave_folder(self.store)
        os.environ.update(self.settings.environment)
        prepare_engine(self.store)
        use_engine(self.store, self.settings.engine_port)
        engine = engine_child(self.store, self.settings.engine_port, has_pages=True)
        self._keep(engine)
        await_engine(engine, self.settings.engine_port)
        port_file(self.store).write_text(str(self.settings.engine_port))
        from solmap.flows.service import submission  # noqa: PLC0415 - after the engine's settings

        if dead := submission.mark_crashed_runs(of_commands=True):
            self.report(f"{dead} runs ended with the last `solmap up`; their products are kept")
        self._child("scheduler", *module_command("solmap.flows.service.deployments"))
        self._child("map", *module_command("solmap.flows.cli", "serve", *self._address()))
        if self.settings.inbox is not None:
            self.settings.inbox.mkdir(parents=True, exist_ok=True)
            memory, params = self.store / "inbox.json", InboxParams(self.settings.inbox_settle_s)
            self._inbox = Inbox(self.settings.inbox.resolve(), memory, params)

    def check(self) -> None:
        """Check everything once: the children, the inbox, late runs."""
        for child in self._children.values():
            if message := child.restart_if_ended():
                self.report(message)
                self._scheduler_died = self._scheduler_died or child.name == "scheduler"
        try:
            self._end_dead_runs()
            self._check_inbox()
            self._check_requests()
            self._check_scheduler()
        except Exception as error:  # noqa: BLE001 - the engine starts again, the inbox is away, ...
            self._report_once(f"{type(error).__name__}: {error}; retried until it works")
        else:
            self._problem = ""
        self._write_engine_state()

    def stop(self) -> None:
        """Stop the map and the scheduler with its runs, then the engine; a few seconds in all."""
        port_file(self.store).unlink(missing_ok=True)
        first = [child for name, child in self._children.items() if name != "engine"]
        for child in first:
            child.request_end()
        for child in first:
            child.stop(_STOP_S)
        for child in self._children.values():
            child.stop(_STOP_S / 2)

    def _write_engine_state(self) -> None:
        """Write the engine's state for the map; without updates it becomes outdated."""
        from solmap.flows.service import engine_watch  # noqa: PLC0415 - after the engine's settings

        scheduler = self._children.get("scheduler")
        is_alive = scheduler is not None and scheduler.is_alive
        try:
            engine_watch.write_state(
                self.store, has_inbox=self._inbox is not None, is_scheduler_alive=is_alive
            )
        except Exception as error:  # noqa: BLE001 - as above
            with contextlib.suppress(Exception):  # the disk is full, the catalogue away
                engine_watch.write_problem(self.store, f"the engine does not answer: {error}")

    def _report_once(self, problem: str) -> None:
        """Print an error, once while it stays the same."""
        if problem != self._problem:
            self.report(problem)
        self._problem = problem

    def _child(self, name: str, *command: str) -> None:
        environment = {"PYTHONUNBUFFERED": "1"}
        if name == "map":  # does not control the engine; requests of people go through the store
            environment["PREFECT_API_AUTH_STRING"] = ""
        self._keep(Child(name, command, environment, self.store / "logs" / f"{name}.log"))

    def _keep(self, child: Child) -> None:
        self._children[child.name] = child
        child.start()

    def _address(self) -> tuple[str, ...]:
        return "--host", self.settings.host, "--port", str(self.settings.port)

    def _check_inbox(self) -> None:
        if self._inbox is None:
            return
        from solmap.flows.service import submission  # noqa: PLC0415 - after the engine's settings

        if self._running is not None:
            ended = submission.final_state(self._running)
            if ended is None:
                return
            self._note_end(ended, self._running.delivery, self._inbox)
            self._running = None
        delivery = self._inbox.poll()
        if delivery is not None:
            self._running = submission.submit_inbox(delivery, self.settings.inbox_settle_s)
        if self._running is not None:
            self.report(f"files came: run {self._running.name}, see {self.engine_url}/runs")

    def _note_end(self, ended: str, delivery: str, inbox: Inbox) -> None:
        """Record the outcome of a delivery's run; a cancelled one counts as processed."""
        if ended in {"COMPLETED", "CANCELLED"}:
            inbox.mark_processed(delivery)
            self.report(f"the inbox was processed: {ended.lower()}")
            return
        pause = inbox.mark_failed(delivery)
        when = "when files come or change" if pause is None else f"in {pause / 60:.0f} min"
        self.report(
            f"the run of the inbox {ended.lower()}, see `solmap status`; tried again {when}"
        )

    def _end_dead_runs(self) -> None:
        """Mark the runs of a dead scheduler as ended in the engine."""
        if not self._scheduler_died:
            return
        from solmap.flows.service import submission  # noqa: PLC0415 - after the engine's settings

        submission.mark_crashed_runs(of_commands=False)
        self._scheduler_died = False

    def _check_requests(self) -> None:
        """Pass requests from the map to the scheduler."""
        from solmap.flows.service.submission import submit_requests  # noqa: PLC0415 - after the engine's settings

        for line in submit_requests(self.store, has_inbox=self._inbox is not None):
            self.report(line)

    def _check_scheduler(self) -> None:
        now = time.monotonic()
        if now - self._stuck_checked_at < _STUCK_S / 5:
            return
        self._stuck_checked_at = now
        from solmap.flows.service import submission  # noqa: PLC0415 - after the engine's settings

        scheduler = self._children["scheduler"]
        if scheduler.is_alive and submission.is_stuck(_STUCK_S):
            self.report("runs are late and none is started: the scheduler is restarted")
            scheduler.stop()
            self._children.pop("scheduler")
            self._child("scheduler", *scheduler.command)
