"""The commands of the tutorials run in their order and give the stated results."""

import contextlib
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app

pytestmark = pytest.mark.usefixtures("engine")
DOCS = Path(__file__).resolve().parents[2] / "docs"


def commands(page: str) -> list[list[str]]:
    """Arguments of the `solmap` lines of a page, except those that serve or query the archive."""
    lines = re.findall(r"^ {4}solmap (.*)$", (DOCS / page).read_text(), re.MULTILINE)
    calls = [shlex.split(line, comments=True) for line in lines]
    return [call for call in calls if call[0] not in {"serve", "fetch"} and "FILE" not in call]


def follow(page: str, folder: Path) -> dict[str, str]:
    """What each command of a page printed when all were run in a folder, one after the other."""
    printed = {}
    for call in commands(page):
        words = [name for word in call for name in sorted(map(str, folder.glob(word))) or [word]]
        with contextlib.chdir(folder):
            ended = CliRunner().invoke(app, words)
        assert ended.exit_code == 0, f"solmap {shlex.join(call)}: {ended.stderr[-2000:]}"
        printed[call[0]] = ended.output
    return printed


def blocks(page: str, language: str) -> list[str]:
    """The blocks of code of a page in a language."""
    return re.findall(
        rf"^```{language}\n(.*?)^```$", (DOCS / page).read_text(), re.DOTALL | re.MULTILINE
    )


@pytest.mark.timeout(600)
def test_archived_frames_of_spirit_give_the_results_of_the_tutorial(shared_data, tmp_path):
    for frames, folder in {"sol1869_troy": "sol1869", "sol1900": "sol1900"}.items():
        (tmp_path / "spirit" / folder).mkdir(parents=True)
        for image in (shared_data / f"mer_spirit_{frames}").glob("*.img"):
            shutil.copy(image, tmp_path / "spirit" / folder)
    printed = follow("tutorials/spirit.md", tmp_path)
    for line in blocks("tutorials/spirit.md", "")[0].splitlines():
        assert line in printed["run"]
    assert "mer2-origin137-sol1869" in printed["report"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_demo_gives_the_results_of_its_tutorial(tmp_path):
    printed = follow("tutorials/demo.md", tmp_path)
    for stop in re.findall(r"^mer2-\S+", blocks("tutorials/demo.md", "")[0], re.MULTILINE):
        assert stop in printed["positions"]
    errors = printed["evaluate"].splitlines()[2].split("\t")
    assert float(errors[2]) == pytest.approx(3.16, abs=0.01)
    assert float(errors[4]) < 0.3  # percent of the distance; the tutorial states 0.2
    python = blocks("how-to/uncertainty.md", "python")[0]
    subprocess.run([sys.executable, "-c", python], cwd=tmp_path, check=True)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_realistic_traverse_gives_the_results_of_its_tutorial(tmp_path):
    (settings,) = blocks("tutorials/realistic-traverse.md", "toml")
    (tmp_path / "image-only.toml").write_text(settings)
    printed = follow("tutorials/realistic-traverse.md", tmp_path)
    assert printed["evaluate"].count("mer2-site") > 3
