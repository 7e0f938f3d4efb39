"""Twenty small faults, put one by one into a copy of the code: the tests of their area must fail.

`python -m tests.support.seeded_faults [NUMBER ...]` reports for each, or for those named, whether
it is caught, and exits with 1 where one is not. Without a fault every area must pass.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.support.structure import PACKAGES, ROOT

CAMERAS = "tests/unit/cameras"
VECTOR_FILES = "tests/unit/archive/tables/test_vector_files.py"
PARTNERS = "tests/unit/archive/test_partners.py"
NAMES = "tests/unit/archive/test_file_names.py"
WRITES = "tests/unit/gis_server/test_writes.py"
DOWNLINK = "tests/e2e/test_downlink.py"


@dataclass(frozen=True, slots=True)
class Fault:
    """Text of a production module that is replaced, and the tests that must notice."""

    tests: str
    path: str
    right: str
    wrong: str


FAULTS = (
    Fault(CAMERAS, "photogrammetry/cameras/cahvor.py", "(2.0 - oo)", "(2.0 + oo)"),
    Fault(
        CAMERAS, "photogrammetry/cameras/cahvor.py", "self.r[1] + 2.0 * self", "self.r[1] + self"
    ),
    Fault(
        CAMERAS, "photogrammetry/cameras/cahvore.py", "2.0 * e1 + 4.0 * e2", "2.0 * e1 + 2.0 * e2"
    ),
    Fault(CAMERAS, "photogrammetry/cameras/cahvore.py", "(ratio * pupil)", "(pupil)"),
    Fault(CAMERAS, "photogrammetry/cameras/photogrammetric.py", "- samples / 2)", "- samples)"),
    Fault(CAMERAS, "photogrammetry/cameras/linearisation.py", "size / 2 * float", "size * float"),
    Fault(CAMERAS, "photogrammetry/cameras/cahv.py", "else 0.0 * self.a", "else 0.5 * self.a"),
    Fault(CAMERAS, "photogrammetry/cameras/cahv.py", "(np.cross(v, h) @ a", "(np.cross(h, v) @ a"),
    Fault(
        "tests/unit/test_mars.py", "photogrammetry/mars.py", "[1.0, 1.0, -1.0]", "[1.0, 1.0, 1.0]"
    ),
    Fault(NAMES, "photogrammetry/archive/file_names.py", "126322960", "126322860"),
    Fault(
        VECTOR_FILES, "photogrammetry/archive/tables/vector_files.py", "min(members)", "members[0]"
    ),
    Fault(
        VECTOR_FILES,
        "photogrammetry/archive/tables/vector_files.py",
        "key=rank, reverse=True",
        "key=rank",
    ),
    Fault(PARTNERS, "photogrammetry/archive/partners.py", "DIFFERENCE = 1.0", "DIFFERENCE = 0.1"),
    Fault(
        PARTNERS, "photogrammetry/archive/partners.py", "SAME_COVERAGE = 0.9", "SAME_COVERAGE = 0.1"
    ),
    Fault(
        WRITES, "gis_server/collaboration/edits.py", "edit.counts or not counting", "edit.counts"
    ),
    Fault(
        WRITES,
        "gis_server/collaboration/edits.py",
        "min_length=1, max_length=4000",
        "max_length=4000",
    ),
    Fault(WRITES, "gis_server/collaboration/runs.py", 'if name != "mission"', 'if name != ""'),
    Fault(WRITES, "gis_server/collaboration/accounts.py", "role < self", "role > self"),
    Fault(
        DOWNLINK,
        "photogrammetry/terrain/dtm/stop_dtm.py",
        "mark_occluded(dtm.ground, dtm.elevation, grid, views, params)",
        "dtm.ground",
    ),
    Fault(
        DOWNLINK,
        "photogrammetry/terrain/dtm/stop_dtm.py",
        "(fused.level, fused",
        "(fused.level + 0.05, fused",
    ),
)


def run(fault: Fault) -> bool:
    """Whether the tests of a fault fail with it; it is put into a copy of the checkout."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in (*PACKAGES, "src", "tests"):
            ignored = shutil.ignore_patterns("node_modules", "dist", "__pycache__")
            shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignored)
        for name in ("pyproject.toml", "requirements.lock"):
            shutil.copy(ROOT / name, copy)
        module = copy / fault.path
        text = module.read_text()
        assert text.count(fault.right) >= 1, f"{fault.path} does not hold {fault.right!r} any more"
        module.write_text(text.replace(fault.right, fault.wrong))
        command = [sys.executable, "-m", "pytest", "-qx", "--hypothesis-profile=repeatable"]
        shared = os.environ.get("SOLMAP_SHARED", str(ROOT.parent / "shared"))
        places = {"PYTHONPATH": str(copy / "src"), "SOLMAP_SHARED": shared}
        ended = subprocess.run(
            [*command, fault.tests],
            cwd=copy,
            env={**os.environ, **places},
            capture_output=True,
            text=True,
            check=False,
        )
    assert ended.returncode in (0, 1), ended.stdout[-2000:] + ended.stderr[-2000:]
    return ended.returncode == 1


def main(numbers: list[int]) -> int:
    """Report for every fault whether it is caught; the exit code."""
    missed = 0
    for area in dict.fromkeys(FAULTS[number - 1].tests for number in numbers):
        first = next(fault for fault in FAULTS if fault.tests == area)
        assert not run(Fault(area, first.path, first.right, first.right)), f"{area} fails by itself"
    for number in numbers:
        fault = FAULTS[number - 1]
        is_caught = run(fault)
        missed += not is_caught
        reported = "caught" if is_caught else "MISSED"
        print(f"{number:2} {reported} {fault.path}: {fault.right} -> {fault.wrong}", flush=True)  # noqa: T201
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main([int(word) for word in sys.argv[1:]] or list(range(1, len(FAULTS) + 1))))
