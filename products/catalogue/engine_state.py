"""State of the engine as written by `solmap up`: deployments, waiting runs, and whether it is up.

The map does not communicate with the engine. `solmap up` does, and writes the state to the file
`engine.json` of the store at intervals: an old state means that the store is only served.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

FILE = "engine.json"
OLD_S = 30.0
"""Age in seconds from which a state is outdated."""


@dataclass(frozen=True, slots=True)
class DeploymentState:
    """A deployment: a flow with its schedule."""

    name: str
    """Flow and deployment, as `downlink/inbox`."""
    description: str
    is_paused: bool
    schedules: tuple[str, ...]
    """Cron lines, UTC."""
    next_run: str | None
    """UTC, ISO 8601, as for all times; None: nothing is scheduled."""
    last_state: str | None
    """State of its last run, such as `completed`; None: there was none."""
    last_ended_at: str | None
    pool: str | None
    """Its work pool; None: `solmap up` runs it itself."""
    is_ready: bool
    """Whether a worker takes its runs."""


@dataclass(frozen=True, slots=True)
class QueuedRun:
    """A run that was requested and has not begun."""

    flow_run: str
    deployment: str
    name: str
    expected_at: str | None
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EngineState:
    """The state of the engine at a time."""

    at: str
    is_up: bool
    trouble: str | None = None
    """Reason why it is not up."""
    has_inbox: bool = False
    """Whether an inbox is watched."""
    deployments: tuple[DeploymentState, ...] = ()
    queued: tuple[QueuedRun, ...] = ()
    is_known: bool = True
    """Whether `solmap up` runs on the store; else it is only served."""

    def write(self, root: Path) -> None:
        """Write the state, replacing the previous one."""
        draft = root / f".{FILE}.{os.getpid()}"
        draft.write_text(json.dumps(asdict(self)))
        draft.replace(root / FILE)


def read_engine_state(root: Path) -> EngineState:
    """The present state."""
    now = datetime.now(UTC)
    at = now.isoformat(timespec="milliseconds")
    try:
        document = json.loads((root / FILE).read_text())
    except FileNotFoundError:
        trouble = "`solmap up` has never run on this store"
        return EngineState(at, is_up=False, trouble=trouble, is_known=False)
    except (OSError, ValueError) as error:
        return EngineState(at, is_up=False, trouble=f"{FILE} cannot be read: {error}")
    found = EngineState(
        **{
            **document,
            "deployments": tuple(
                DeploymentState(**{**one, "schedules": tuple(one["schedules"])})
                for one in document["deployments"]
            ),
            "queued": tuple(QueuedRun(**one) for one in document["queued"]),
        }
    )
    if (now - datetime.fromisoformat(found.at)).total_seconds() > OLD_S:
        trouble = f"`solmap up` last ran at {found.at[:16].replace('T', ' ')} UTC"
        return EngineState(found.at, is_up=False, trouble=trouble, is_known=False)
    return found
