"""Ctrl-C and SIGTERM end a process soon, whatever it is doing: real processes."""

import signal
import subprocess
import sys
import time

import pytest

SCRIPT = """
import ctypes, sys, threading, time
from pathlib import Path
from solmap.flows.runtime import stopping
from solmap.flows.runtime.children import Child
stopping.GRACE_S = 1.0
sleeper = Child("sleeper", (sys.executable, "-c", "import time; time.sleep(99)"), {}, Path(LOG))
def library(seconds):
    ctypes.CDLL(None).sleep(seconds)  # no signal handler of Python runs meanwhile
def order():
    try:
        time.sleep(99)
    finally:
        print("closed", flush=True)
def deaf():
    while True:
        try:
            time.sleep(99)
        except BaseException:
            pass
with stopping.end_on_signals():
    sleeper.start()
    print(sleeper.process.pid, flush=True)
    DO
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    "doing",
    [
        "order()",
        "library(99)",
        "deaf()",
        "threading.Thread(target=library, args=(99,)).start(); order()",
    ],
)
def test_a_signal_ends_the_run_with_one_line_and_ends_its_children(tmp_path, number, doing):
    script = SCRIPT.replace("DO", doing).replace("LOG", repr(str(tmp_path / "log")))
    with subprocess.Popen(
        (sys.executable, "-c", script), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        child = int(process.stdout.readline())
        time.sleep(0.3)
        process.send_signal(number)
        message, wrong = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert wrong.splitlines() == ["stopped; what was made is kept; run again to continue"]
    assert ("closed" in message) == ("order" in doing)
    with pytest.raises(ProcessLookupError):
        _until_gone(child)


def test_a_process_whose_library_holds_the_interpreter_lock_is_killed(tmp_path):
    doing = "sum(range(10**12))"
    script = SCRIPT.replace("DO", doing).replace("LOG", repr(str(tmp_path / "log")))
    with subprocess.Popen((sys.executable, "-c", script), stdout=subprocess.PIPE) as process:
        child = int(process.stdout.readline())
        time.sleep(0.3)
        process.terminate()
        assert process.wait(60) == -signal.SIGKILL
    with pytest.raises(ProcessLookupError):
        _until_gone(child)


def _until_gone(pid):
    import os  # noqa: PLC0415

    for _ in range(1200):
        os.kill(pid, 0)
        time.sleep(0.05)
