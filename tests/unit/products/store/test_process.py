import json
import logging
import subprocess
import sys
import time

import pytest

from solmap.products.store.process import (
    JsonLineFormatter,
    ResourceMeter,
    SharedLogHandler,
    log_context,
    log_to_store,
)


@pytest.fixture
def log_of(tmp_path):
    """A logger that writes to a file of its own, small enough to be renamed soon."""
    handlers = []

    def make(most_bytes=2000, kept=2):
        handler = SharedLogHandler(tmp_path / "logs" / "flows.jsonl", most_bytes, kept)
        handler.setFormatter(JsonLineFormatter())
        handlers.append(handler)
        logger = logging.Logger(f"logged-{len(handlers)}")  # noqa: LOG001 - not kept by name
        logger.addHandler(handler)
        return logger

    yield make
    for handler in handlers:
        handler.close()


def lines_in(folder):
    files = sorted((folder / "logs").glob("flows.jsonl*"))
    return [json.loads(line) for file in files for line in file.read_text().splitlines()]


def test_a_log_line_has_its_message_and_its_context(tmp_path, log_of):
    with log_context(run="r1", sol=156), log_context(subject="dtm"):
        log_of().info("%d cells", 7, extra={"seconds": 1.5})
    (line,) = lines_in(tmp_path)
    assert line["message"] == "7 cells"
    assert (line["run"], line["sol"], line["subject"], line["seconds"]) == ("r1", 156, "dtm", 1.5)
    assert line["level"] == "info"
    assert line["at"].endswith("+00:00")


def test_log_context_ends_with_its_block(tmp_path, log_of):
    with log_context(run="r1"):
        pass
    log_of().info("later")
    assert "run" not in lines_in(tmp_path)[0]


def test_an_exception_is_one_line(tmp_path, log_of):
    logger = log_of()
    try:
        json.loads("{\n")
    except ValueError:
        logger.exception("it failed")
    (line,) = lines_in(tmp_path)
    assert "JSONDecodeError" in line["traceback"].splitlines()[-1]


def test_a_large_log_is_renamed_and_the_oldest_removed(tmp_path, log_of):
    logger = log_of(most_bytes=500, kept=2)
    for number in range(60):
        logger.info("line %d", number)
    names = {path.name for path in (tmp_path / "logs").iterdir()}
    assert names <= {"flows.jsonl", "flows.jsonl.1", "flows.jsonl.2", "flows.lock"}
    message = {line["message"] for line in lines_in(tmp_path)}
    assert "line 59" in message
    assert "line 0" not in message


_WRITER = """
import logging, pathlib, sys
from solmap.products.store.process import JsonLineFormatter, SharedLogHandler
handler = SharedLogHandler(pathlib.Path(sys.argv[1]), 3000, 50)
handler.setFormatter(JsonLineFormatter())
logger = logging.getLogger(sys.argv[2])
logger.setLevel(logging.INFO)
logger.addHandler(handler)
for number in range(100):
    logger.info("%s %d", sys.argv[2], number)
"""


def test_processes_that_share_a_file_lose_no_line(tmp_path):
    command = [sys.executable, "-c", _WRITER, str(tmp_path / "logs" / "flows.jsonl")]
    writers = [subprocess.Popen([*command, name]) for name in "ab"]
    assert [writer.wait(60) for writer in writers] == [0, 0]
    message = sorted(line["message"] for line in lines_in(tmp_path))
    assert message == sorted(f"{name} {number}" for name in "ab" for number in range(100))


def test_setting_up_logs_twice_writes_a_line_once(tmp_path):
    logger = logging.getLogger("solmap.products.a_test")
    before = logging.getLogger("solmap").handlers[:]
    try:
        for _ in range(2):
            log_to_store(tmp_path, "flows")
        logger.info("once")
        assert [line["message"] for line in lines_in(tmp_path)] == ["once"]
    finally:
        packages = logging.getLogger("solmap")
        for handler in [one for one in packages.handlers if one not in before]:
            packages.removeHandler(handler)
            handler.close()


def test_effort_distinguishes_waiting_from_working():
    effort = ResourceMeter()
    time.sleep(0.2)
    waited = effort.usage()
    assert waited["seconds"] >= 0.2
    assert waited["cpu_s"] < 0.1
    effort = ResourceMeter()
    while effort.usage()["cpu_s"] < 0.1:
        sum(range(10_000))
    assert effort.usage()["seconds"] >= 0.1
    held = bytearray(60_000_000)
    held[::4096] = b"x" * len(held[::4096])
    assert effort.usage()["rss_rise_mb"] >= 0.0
    assert effort.usage()["peak_rss_mb"] > 60.0
