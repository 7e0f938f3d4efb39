"""What `solmap up` says of the engine: its deployments, runs that wait there, and that it lives.

The map gives the engine no orders and does not ask it anything. `solmap up` does, and writes the
state down in the file `engine.json` of the store, again and again: a state that is old says that
neither `solmap up` nor the engine is to be reckoned with.
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
"""A state that was written so long ago holds no more."""


@dataclass(frozen=True, slots=True)
class DeploymentState:
    """A deployment: a flow that may be run, and when it is."""

    name: str
    """Flow and deployment, as `downlink/inbox`."""
    description: str
    is_paused: bool
    schedules: tuple[str, ...]
    """Cron lines, UTC."""
    next_run: str | None
    """UTC, ISO 8601, as all times; None: nothing is scheduled."""
    last_state: str | None
    """How its last run ended, as `completed`; None: none has."""
    last_ended_at: str | None
    pool: str | None
    """Its work pool; None: `solmap up` runs it itself."""
    is_ready: bool
    """Whether somebody takes its runs."""


@dataclass(frozen=True, slots=True)
class QueuedRun:
    """A run that was asked for and has not begun."""

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
    """Why it is not up."""
    has_inbox: bool = False
    """Whether an inbox is watched."""
    deployments: tuple[DeploymentState, ...] = ()
    queued: tuple[QueuedRun, ...] = ()

    def write(self, root: Path) -> None:
        """Put it in place of the one before."""
        draft = root / f".{FILE}.{os.getpid()}"
        draft.write_text(json.dumps(asdict(self)))
        draft.replace(root / FILE)


def read_engine_state(root: Path) -> EngineState:
    """The state as it holds now."""
    now = datetime.now(UTC)
    at = now.isoformat(timespec="milliseconds")
    try:
        document = json.loads((root / FILE).read_text())
    except FileNotFoundError:
        return EngineState(at, is_up=False, trouble="`solmap up` has not run on this store yet")
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
        trouble = f"`solmap up` does not run; it last did at {found.at[:19].replace('T', ' ')} UTC"
        return EngineState(found.at, is_up=False, trouble=trouble, deployments=found.deployments)
    return found
