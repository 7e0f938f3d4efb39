"""Prefect's settings, and its server as a child process; imported before Prefect is.

A run needs no network and no server of its own. The server's database is in the store, it listens
on this machine only, requires the password of the store, and sends no reports. Prefect would start
a server by itself, but a killed run would leave it behind. If the server ends unexpectedly it is
started again on the same port with the same database, and the run continues.

Access to a Prefect server permits running any command. So the password is random, is in a file that
only its owner can read (`password_file`), and is passed to processes by their environment, never by
their arguments. Pages of other sites are not answered (CORS); DNS rebinding does not help them,
because browsers do not send this password by themselves.

Prefect reads `.env`, `prefect.toml` and `pyproject.toml` of the current folder, which may be a
downlink's. `leave_folder` changes to a folder of the store before Prefect is imported.
"""

from __future__ import annotations

import atexit
import base64
import contextlib
import errno
import importlib
import logging
import os
import secrets
import socket
import sqlite3
import sys
import tempfile
import threading
import time
import urllib.request
from importlib.metadata import version
from pathlib import Path

from solmap.config.settings import PREFIX, Settings
from solmap.flows.runtime.children import Child, module_command
from solmap.photogrammetry.compiled import load_compiler
from solmap.photogrammetry.threads import use_one_thread_a_call
from solmap.products.store.faults import require_writable
from solmap.products.store.process import use_one_heap

log = logging.getLogger(__name__)
BY_COMMAND = "by-command"
"""Tag of runs that a command started, not the scheduler."""
_START_S = 300.0
"""Longest time of a start, which at first makes a database, on a loaded machine."""
_POLL_S = 0.5
"""Pause between checks that the server runs."""
_DAY_S = 86_400
_EVENT_DAYS = 7
"""Events record every step of every task; old ones are not needed."""
_NO_HARD_LINKS = {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS}
"""Error numbers of file systems without hard links, such as CIFS and exFAT."""
_IDLE_SERVICES = (
    "CANCELLATION_CLEANUP",
    "CLEANUP_RECONCILER",
    "EVENT_PERSISTER",
    "FOREMAN",
    "LATE_RUNS",
    "PAUSE_EXPIRATIONS",
    "REPOSSESSOR",
    "SCHEDULER",
    "TRIGGERS",
)
RUN_ONLY = {
    "PREFECT_UI_ENABLED": "false",
    "PREFECT_API_BLOCKS_REGISTER_ON_START": "false",
    # States of tasks are stored every second, not in three transactions for each task.
    "PREFECT_SERVER_SERVICES_TASK_RUN_RECORDER_BATCH_SIZE": "1000",
    "PREFECT_SERVER_SERVICES_TASK_RUN_RECORDER_FLUSH_INTERVAL": "1",
    **{f"PREFECT_SERVER_SERVICES_{name}_ENABLED": "false" for name in _IDLE_SERVICES},
}
"""The server of a run ends with it: it needs no pages, and has nothing to schedule or to watch.
States, logs and artifacts of runs are kept for the pages of `solmap up`; events are not."""
SCHEMA = Path(__file__).with_name("engine.sql")
"""The tables of Prefect's database, after a line with its version: its server takes as long to make
them, by all its migrations, as for the rest of its start."""


def prepare_engine(store: Path) -> None:
    """Set what Prefect reads at import; call before the first import of a flow."""
    use_one_heap()
    use_one_thread_a_call()
    days = Settings().history_days
    defaults = {
        "PREFECT_HOME": str(store.resolve() / "prefect"),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "PREFECT_CLOUD_ENABLE_ORCHESTRATION_TELEMETRY": "false",
        "DO_NOT_TRACK": "1",
        # The terminal shows progress and outcomes; Prefect's own lines are on its run page.
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "300",
        # The server removes old runs with their tasks, logs and artifacts, and old events, hourly.
        "PREFECT_SERVER_SERVICES_DB_VACUUM_ENABLED": "events,flow_runs,orphans",
        "PREFECT_SERVER_SERVICES_DB_VACUUM_RETENTION_PERIOD": str(days * _DAY_S),
        "PREFECT_SERVER_EVENTS_RETENTION_PERIOD": f"P{min(days, _EVENT_DAYS)}D",
        # Megabytes of blocks: a raster is read once; the default is a twentieth of the memory.
        "GDAL_CACHEMAX": "64",
    }
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
    home = Path(os.environ["PREFECT_HOME"]).expanduser().absolute()
    os.environ["PREFECT_HOME"] = str(home)
    # Prefect creates the folder but not its parents; without them its server does not start.
    home.mkdir(parents=True, exist_ok=True)


def make_database(file: Path) -> None:
    """Make the tables of Prefect's database, if `SCHEMA` is of the installed version.

    Otherwise, or where the settings name another database, its server makes them.
    """
    schema = SCHEMA.read_text()
    is_known = schema.startswith(f"-- Prefect {version('prefect')}\n")
    if not is_known or file.exists() or "PREFECT_API_DATABASE_CONNECTION_URL" in os.environ:
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=file.parent) as drafts:
        draft = Path(drafts) / file.name
        with contextlib.closing(sqlite3.connect(draft)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.executescript(schema)
        with contextlib.suppress(OSError):  # another process was first, or no hard links
            file.hardlink_to(draft)


def leave_folder(store: Path) -> None:
    """Change to a folder of the store; relative paths in settings are made absolute first."""
    for name, value in Settings().model_dump().items():
        variable = f"{PREFIX}{name.upper()}"
        if variable in os.environ and (isinstance(value, Path) or str(value).endswith(".toml")):
            os.environ[variable] = str(Path(value).absolute())
    folder = store / "logs"
    folder.mkdir(parents=True, exist_ok=True)
    os.chdir(folder)


def import_prefect() -> None:
    """Import Prefect in an empty folder, for commands that stay in their folder."""
    with contextlib.chdir(sys.prefix):
        importlib.import_module("prefect.main")


def password_file(store: Path) -> Path:
    """The file with the credentials of a store's server, `user:password`; made once.

    Raises:
        OSError: it cannot be written.
    """
    path = store / "prefect" / "password"
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.stat().st_size:  # left by a power failure
        path.unlink()
    if not path.exists():
        secret = f"solmap:{secrets.token_urlsafe(32)}"
        number, draft = tempfile.mkstemp(dir=path.parent)  # for its owner only
        try:
            _write_flushed(number, secret)
            with contextlib.suppress(FileExistsError):  # another process was first
                _name_once(draft, path, secret)
        finally:
            Path(draft).unlink()
    path.chmod(0o600)
    return path


def _name_once(draft: str, path: Path, secret: str) -> None:
    """Give a written file a free name; raises FileExistsError if it is taken."""
    try:
        path.hardlink_to(draft)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        _write_flushed(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), secret)


def _write_flushed(number: int, text: str) -> None:
    """Write to an open file, flush it to the disk, and close it."""
    with os.fdopen(number, "w") as file:
        file.write(text)
        file.flush()
        os.fsync(number)


def address(port: int) -> str:
    """URL of the server at a port."""
    return f"http://127.0.0.1:{port}"


def engine_child(store: Path, port: int, *, has_pages: bool) -> Child:
    """The server of a store, not started yet. It listens on this machine only."""
    make_database(Path(os.environ.get("PREFECT_HOME", store / "prefect")) / "prefect.db")
    environment = {
        "PREFECT_SERVER_API_HOST": "127.0.0.1",
        "PREFECT_SERVER_API_PORT": str(port),
        "PREFECT_SERVER_API_AUTH_STRING": password_file(store).read_text(),
        "PREFECT_SERVER_CORS_ALLOWED_ORIGINS": f"{address(port)},http://localhost:{port}",
        **({} if has_pages else RUN_ONLY),
    }
    log_file = store / "logs" / "engine.log"
    command = module_command("solmap.flows.runtime.prefect_server")
    return Child("engine", command, environment, log_file)


def use_engine(store: Path, port: int) -> None:
    """Make this process and its children use the server of a store."""
    os.environ["PREFECT_API_URL"] = f"{address(port)}/api"
    os.environ["PREFECT_API_AUTH_STRING"] = password_file(store).read_text()


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
        time.sleep(0.05)


def port_file(store: Path) -> Path:
    """The file with the port of the server that `solmap up` runs; absent when it stops."""
    return store / "prefect" / "port"


def running_engine(store: Path) -> int | None:
    """Port of the server that `solmap up` runs for a store; None if there is none.

    Another server at the same port does not accept the store's password.
    """
    try:
        port = int(port_file(store).read_text())
    except (OSError, ValueError):
        return None
    request = urllib.request.Request(f"{address(port)}/api/admin/version")  # noqa: S310 - our own
    password = base64.b64encode(password_file(store).read_bytes()).decode()
    request.add_header("Authorization", f"Basic {password}")
    return port if _answers(request) else None


def start_engine(store: Path, flows: str = "prefect.main") -> None:
    """Run a server until this process ends; call before the first import of a flow.

    The server in `PREFECT_API_URL` is used if set, else that of a running `solmap up`, which saves
    its start. A server started here is stopped after Prefect has sent its
    last messages: exit handlers run in reverse order.

    Args:
        store: Folder of products and catalogue.
        flows: Module to import while the server starts, which takes as long.

    Raises:
        TimeoutError: it does not start.
        StoreReadOnlyError: the store may only be read.
        OSError: it cannot be written.
    """
    store = store.absolute()
    require_writable(store)
    leave_folder(store)
    prepare_engine(store)
    if os.environ.get("PREFECT_API_URL"):
        return
    if (running := running_engine(store)) is not None:
        use_engine(store, running)
        return
    port = free_port()
    child = engine_child(store, port, has_pages=False)
    child.start()
    atexit.register(child.stop)
    use_engine(store, port)
    importlib.import_module(flows)
    load_compiler()
    await_engine(child, port)
    threading.Thread(target=_keep_alive, args=(child,), name="engine-watch", daemon=True).start()


def _keep_alive(child: Child) -> None:
    """Restart the server whenever it ends, until it is stopped."""
    while not child.is_stopping:
        message = child.restart_if_ended()
        if message:
            log.warning("%s", message)
        time.sleep(_POLL_S)


def free_port() -> int:
    """A port of this machine that nothing listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _answers(request: str | urllib.request.Request) -> bool:
    try:
        with urllib.request.urlopen(request, timeout=2) as answer:  # noqa: S310 - our own server
            return bool(answer.status == 200)  # noqa: PLR2004 - HTTP's OK
    except OSError:
        return False
