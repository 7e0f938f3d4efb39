"""`cd downlink && solmap ...`: what lies in the downlink is data, never code or settings."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

LOGGING = """\
version: 1
disable_existing_loggers: false
formatters:
  x: {"()": builtins.open, file: MARK, mode: w}
"""
MODULES = ("h2", "attr", "yaml", "typer", "prefect", "pydantic", "sitecustomize", "cv2")
COMMAND = Path(sys.executable).with_name("solmap")
CLEAN = {
    name: value
    for name, value in os.environ.items()
    if not name.startswith(("PREFECT_", "SOLMAP_"))
}
pytestmark = pytest.mark.skipif(not COMMAND.exists(), reason="solmap is not installed")


@pytest.fixture
def downlink(tmp_path):
    folder, mark = tmp_path / "downlink", tmp_path / "mark"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write('{name}\\n')")
    (folder / "logging.yml").write_text(LOGGING.replace("MARK", str(mark)))
    (folder / ".env").write_text(
        f"PREFECT_HOME={folder}/moved\nPREFECT_LOGGING_SETTINGS_PATH={folder}/logging.yml\n"
        f"SOLMAP_STORE={folder}/moved\n"
    )
    (folder / "prefect.toml").write_text(f'home = "{folder}/moved"\n')
    (folder / "pyproject.toml").write_text(
        f'[tool.prefect.logging]\nsettings_path = "{folder}/logging.yml"\n'
    )
    (folder / "broken.img").write_bytes(b"no image at all")
    return folder


def solmap(*words, cwd, **options):
    return subprocess.run(
        words, cwd=cwd, env=CLEAN, capture_output=True, text=True, check=False, **options
    )


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("command", [(COMMAND,), (sys.executable, "-m", "solmap.flows.cli")])
def test_no_file_of_a_downlink_is_executed_or_trusted(downlink, tmp_path, command):
    found = {path.name for path in downlink.iterdir()}
    run = solmap(*command, "run", ".", "--store", "../store", cwd=downlink)
    assert "none of its" in run.stderr, run.stderr
    ties = solmap(*command, "ties", "absent.csv", "--store", "../store", cwd=downlink)
    assert "absent.csv" in ties.stderr
    assert not (tmp_path / "mark").exists()
    assert {path.name for path in downlink.iterdir()} == found
    assert (tmp_path / "store" / "prefect" / "prefect.db").exists()


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("number", "reached"),
    [("SIGINT", "logs"), ("SIGTERM", "catalogue.sqlite"), ("SIGTERM", "products/matches")],
)
def test_a_stopped_run_ends_with_one_line(tmp_path, number, reached):
    from tests.support.small_downlink import write_coarse_pipeline, write_small_downlink  # noqa: PLC0415

    write_small_downlink(tmp_path / "downlink", stops=2, pairs=2)
    write_coarse_pipeline(tmp_path / "coarse.toml")
    options = ("--store", "store", "--pipeline", "coarse.toml")
    with subprocess.Popen(
        (COMMAND, "run", "downlink", *options),
        cwd=tmp_path,
        env=CLEAN,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while not (tmp_path / "store" / reached).exists():
            time.sleep(0.1)
        process.send_signal(signal.Signals[number])
        _, message = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.Signals[number]
    assert message.splitlines()[-1] == "stopped; what was made is kept; run again to continue"
    assert "Traceback" not in message
