"""Log and resource use of a process that works on a store.

Logs are machine-readable: one JSON object per line, below `logs/` in the store. Every process of a
store may append to the same file, because a line is one write. A large file is renamed to `.1` (the
previous one to `.2`, and so on) under a lock; other processes detect the new file by its name.

Resources are measured for each stage. Stages run concurrently as threads of one process, so
processor time is that of the thread itself, without threads started by libraries (such as OpenCV).
Memory is known only for the process: `peak_rss_mb` is its maximum since its start, and
`rss_rise_mb` the increase of that maximum meanwhile, by any thread.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import logging
import resource
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from logging.handlers import WatchedFileHandler
from pathlib import Path
from types import MappingProxyType

from solmap.products.store.faults import is_read_only

MOST_BYTES = 10_000_000
KEPT = 4
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
_NOTHING: Mapping[str, object] = MappingProxyType({})
_context: ContextVar[Mapping[str, object]] = ContextVar("solmap_log", default=_NOTHING)


@contextmanager
def log_context(**facts: object) -> Iterator[None]:
    """Add facts (`run`, `sol`, `subject`) to every log line inside the block."""
    before = _context.set({**_context.get(), **facts})
    try:
        yield
    finally:
        _context.reset(before)


class JsonLineFormatter(logging.Formatter):
    """A record as one line of JSON: time, level, logger, message, context and extras."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        extras = {name: value for name, value in vars(record).items() if name not in _STANDARD}
        line = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "process": record.process,
            **_context.get(),
            **extras,
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


class SharedLogHandler(WatchedFileHandler):
    """A file of lines that several processes append to and that is rotated by size."""

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES, kept: int = KEPT) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        super().__init__(path, encoding="utf-8", delay=True)
        self._path, self._most, self._kept = path, most_bytes, kept

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line; a failure to write is reported without further effect."""
        try:
            super().emit(record)
            if self._path.stat().st_size > self._most:
                self._rotate()
        except OSError:
            self.handleError(record)

    def _rotate(self) -> None:
        with self._path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if self._path.stat().st_size <= self._most:
                return  # another process was faster
            names = [self._path, *(Path(f"{self._path}.{n}") for n in range(1, self._kept + 1))]
            for older, newer in zip(reversed(names[1:]), reversed(names[:-1]), strict=True):
                if newer.exists():
                    newer.replace(older)


def log_to_store(root: Path, program: str) -> None:
    """Write the log of this process to `logs/PROGRAM.jsonl` of a store, if it is writable."""
    path = root.resolve() / "logs" / f"{program}.jsonl"
    if is_read_only(root) or is_read_only(path):
        return
    handler = SharedLogHandler(path)
    handler.setFormatter(JsonLineFormatter())
    logger = logging.getLogger("solmap")
    for old in [one for one in logger.handlers if isinstance(one, SharedLogHandler)]:
        logger.removeHandler(old)
        old.close()
    logger.addHandler(handler)
    if logger.level == logging.NOTSET or logger.level > logging.INFO:
        logger.setLevel(logging.INFO)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


@dataclass(frozen=True, slots=True)
class ResourceMeter:
    """Time and memory of this thread and process at the beginning of a measurement."""

    wall: float = field(default_factory=time.monotonic)
    cpu: float = field(default_factory=time.thread_time)
    peak_mb: float = field(default_factory=_peak_mb)

    def usage(self) -> dict[str, float]:
        """Seconds and megabytes since the beginning."""
        peak = _peak_mb()
        return {
            "seconds": round(time.monotonic() - self.wall, 3),
            "cpu_s": round(time.thread_time() - self.cpu, 3),
            "peak_rss_mb": round(peak, 1),
            "rss_rise_mb": round(peak - self.peak_mb, 1),
        }


_ARENA_MAX, _MMAP_THRESHOLD, _TRIM_THRESHOLD = -8, -3, -1
"""Options of `mallopt` (glibc)."""
_KEPT_BYTES = 128 << 20
"""Free memory at the end of the heap that is kept for the next arrays, as large as those of some
images: a page that is returned and requested again must be cleared each time."""
_OWN_MAPPING_BYTES = 32 << 20
"""Arrays from this size on are mapped alone, and returned when they are freed: glibc's limit."""


def use_one_heap() -> None:
    """Let all threads of this process allocate from one heap; call before there are any.

    The heaps of glibc, one a thread, each keep what they once held: a run of three stops kept 3 GB.
    """
    with suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_ARENA_MAX, 1)
        mallopt(_MMAP_THRESHOLD, _OWN_MAPPING_BYTES)
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)


def return_free_memory() -> None:
    """Return what this process has freed to the system; otherwise most of it stays resident."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
