"""Prefect's settings, and its server as a child process; imported before Prefect is.

A run needs no network and no server of its own. The server's database lies in the store, it listens
on this machine only and reports nothing to anybody; what is set in the environment wins. Prefect
would start a server by itself, but a run that is killed would leave that one behind. One that dies
is started again on the same port with the same database: the run asks again and goes on.
"""

from __future__ import annotations

import atexit
import logging
import os
import socket
import sys
import threading
import time
import urllib.request
from pathlib import Path

from solmap.flows.runtime.children import Child

log = logging.getLogger(__name__)
_START_S = 300.0
"""Its database is made at the first start, and a loaded machine takes its time."""
_LOOK_S = 0.5
"""Between looks at whether it lives."""
_RUN_ONLY = {"PREFECT_UI_ENABLED": "false"}
"""A run that nobody can look at longer than it lasts needs no pages."""


def prepare_engine(store: Path) -> None:
    """Set what Prefect reads at import; call before the first import of a flow."""
    defaults = {
        "PREFECT_HOME": str(store.resolve() / "prefect"),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "PREFECT_CLOUD_ENABLE_ORCHESTRATION_TELEMETRY": "false",
        "DO_NOT_TRACK": "1",
        # The terminal shows progress and outcomes; Prefect's own lines are on its run page.
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "300",
        # Small-block linear algebra is far slower with two BLAS threads than with one.
        "OPENBLAS_NUM_THREADS": "1",
    }
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
    # Prefect makes the folder itself but not its parents, and then waits for its server in vain.
    Path(os.environ["PREFECT_HOME"]).expanduser().mkdir(parents=True, exist_ok=True)


def address(port: int) -> str:
    """Where the server of a port is found."""
    return f"http://127.0.0.1:{port}"


def engine_child(store: Path, port: int, *, has_pages: bool) -> Child:
    """The server of a store, not started yet. It listens on this machine only."""
    command = (sys.executable, "-m", "prefect", "server", "start", "--host", "127.0.0.1")
    extra = {} if has_pages else _RUN_ONLY
    return Child("engine", (*command, "--port", str(port)), extra, store / "logs" / "engine.log")


def await_engine(child: Child, port: int) -> None:
    """Wait until the server answers.

    Raises:
        TimeoutError: it does not, or it ended.
    """
    end = time.monotonic() + _START_S
    while not _answers(f"{address(port)}/api/health"):
        if time.monotonic() > end or not child.is_alive:
            raise TimeoutError(
                f"Prefect's server does not answer at {address(port)}; is the port taken? Its log "
                f"is {child.log}"
            )
        time.sleep(0.2)


def start_engine(store: Path) -> None:
    """Have a server until this process ends; call before the first import of a flow.

    The one that `PREFECT_API_URL` names is used where it is set. The server is stopped after
    Prefect has sent what it still had to say: what is registered last at exit is called first.

    Raises:
        TimeoutError: it does not start.
    """
    prepare_engine(store)
    if os.environ.get("PREFECT_API_URL"):
        return
    port = _free_port()
    child = engine_child(store, port, has_pages=False)
    child.start()
    atexit.register(child.stop)
    await_engine(child, port)
    threading.Thread(target=_keep_alive, args=(child,), name="engine-watch", daemon=True).start()
    os.environ["PREFECT_API_URL"] = f"{address(port)}/api"


def _keep_alive(child: Child) -> None:
    """Start the server again whenever it dies, until it is stopped."""
    while not child.is_stopping:
        said = child.revive()
        if said:
            log.warning("%s", said)
        time.sleep(_LOOK_S)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=2) as answer:  # noqa: S310 - our own server
            return bool(answer.status == 200)  # noqa: PLR2004 - HTTP's OK
    except OSError:
        return False
