"""Processes that belong to another: real ones."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from solmap.flows.runtime.children import Child, module_command

SLEEPER = (sys.executable, "-c", "import time; time.sleep(60)")
STUBBORN = (
    sys.executable,
    "-c",
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True);"
    "time.sleep(60)",
)
PARENT = """
import sys, time
from pathlib import Path
from solmap.flows.runtime.children import Child, module_command
child = Child("sleeper", (sys.executable, "-c", "import time; time.sleep(60)"), {{}}, Path({log!r}))
child.start()
print(child.process.pid, flush=True)
time.sleep(60)
"""


def runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"


def until(holds, seconds=15.0):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.05)


def child_of(tmp_path, command) -> Child:
    return Child("test", command, {}, tmp_path / "logs" / "test.log")


def test_a_stopped_child_stays_stopped(tmp_path):
    child = child_of(tmp_path, SLEEPER)
    child.start()
    assert child.is_alive
    child.stop()
    assert not child.is_alive
    assert child.restart_if_ended() is None
    assert not child.is_alive


def test_a_child_that_ignores_the_signal_is_killed(tmp_path):
    child = child_of(tmp_path, STUBBORN)
    child.start()
    until(lambda: "up" in child.log.read_text())
    child.stop(patience_s=0.5)
    assert child.process.returncode == -signal.SIGKILL


def test_a_child_that_ended_is_restarted_and_reported(tmp_path):
    child = child_of(tmp_path, SLEEPER)
    child.start()
    first = child.process.pid
    os.kill(first, signal.SIGKILL)
    until(lambda: not child.is_alive)
    assert "ended with -9" in child.restart_if_ended()
    until(lambda: child.restart_if_ended() is None and child.is_alive)
    assert child.process.pid != first
    child.stop()


def test_a_child_that_ends_repeatedly_is_restarted_after_growing_waits(tmp_path):
    child = child_of(tmp_path, (sys.executable, "-c", "raise SystemExit(3)"))
    child.start()
    pauses = []
    while len(pauses) < 3:
        until(lambda: not child.is_alive)
        if message := child.restart_if_ended():
            pauses.append(message)
        time.sleep(0.02)
    assert [message.split(" in ")[1].split(" s")[0] for message in pauses] == ["1", "2", "4"]
    child.stop()


def test_no_child_takes_code_or_settings_from_the_current_folder(tmp_path, monkeypatch):
    downlink = tmp_path / "downlink"
    downlink.mkdir()
    (downlink / "h2.py").write_text("raise SystemExit('hostile')")
    (downlink / "timeit.py").write_text("raise SystemExit('hostile')")
    monkeypatch.chdir(downlink)
    variables = {"PYTHONPATH": str(downlink), "LD_PRELOAD": "", "API_KEY": "1", "SOLMAP_PORT": "9"}
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    look = "import os; print(sorted(os.environ)); print(os.getcwd()); import sys; print(sys.path)"
    grandchild = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {look!r}])"
    child = child_of(tmp_path, module_command("timeit", "-n", "1", "-r", "1", grandchild))
    child.start()
    child.process.wait(60)
    names, folder, path, *_ = child.log.read_text().splitlines()
    assert child.process.returncode == 0
    assert {"SOLMAP_PORT", "PATH", "PYTHONSAFEPATH"} <= set(eval(names))  # noqa: S307 - our own
    assert not {"PYTHONPATH", "LD_PRELOAD", "API_KEY"} & set(eval(names))  # noqa: S307
    assert folder == str(child.log.parent)
    assert not {"", str(downlink), str(child.log.parent)} & set(eval(path))  # noqa: S307


def test_a_long_log_is_shortened_and_later_lines_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr("solmap.flows.runtime.children._LARGEST_LOG_BYTES", 1000)
    script = "import sys, time; print('x' * 2000, flush=True); time.sleep(2); print('later')"
    child = child_of(tmp_path, (sys.executable, "-c", script))
    child.start()
    until(lambda: child.log.stat().st_size > 1000)
    child.restart_if_ended()
    child.process.wait(30)
    assert child.log.read_text() == "later\n"
    assert child.log.with_suffix(".log.1").read_text().startswith("xxx")


@pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux signals children at the end of their parent"
)
def test_no_child_remains_after_its_parent_is_killed(tmp_path):
    script = PARENT.format(log=str(tmp_path / "log"))
    command = (sys.executable, "-c", script)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        assert runs(pid)
        parent.kill()
    until(lambda: not runs(pid))


def test_runs_have_lower_priority_than_the_server():
    code = (
        "import os; from pathlib import Path;"
        "from solmap.flows.runtime.children import lower_priority; lower_priority();"
        "group = Path('/proc/self/autogroup');"
        "print(os.nice(0), group.read_text() if group.exists() else '')"
    )
    command = (sys.executable, "-c", code)
    reported = subprocess.run(
        command, capture_output=True, text=True, check=True, start_new_session=True
    ).stdout
    assert int(reported.split()[0]) == min(os.nice(0) + 10, 19)
    assert "nice 0" not in reported
