"""Compiled functions: when they are compiled, and processes that can keep no result."""

import subprocess
import sys

import pytest
from numba.core import caching

from solmap.photogrammetry.compiled import compiled


def test_a_process_that_can_write_no_folder_compiles_for_itself(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    def doubled(x: float) -> float:
        return 2 * x

    with pytest.raises(RuntimeError, match="cannot cache function"):
        caching.FunctionCache(doubled)
    assert compiled("float64")(doubled)(4.0) == 8.0


def test_the_compiler_is_loaded_with_the_functions_imported_so_far():
    code = (
        "import sys; from solmap.photogrammetry.compiled import load_compiler; load_compiler();"
        "assert 'numba' not in sys.modules; import solmap.photogrammetry.matching.kernels;"
        "load_compiler(); sys.exit('numba' not in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_matching_loads_the_compiler_when_it_runs():
    code = (
        "import sys, solmap.photogrammetry.matching.stereo.dense; sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
