"""Runs unit tests under checks of array types and shapes; the longer tests run without them."""

from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest

SCIENCE = Path(__file__).resolve().parents[2] / "photogrammetry"
_WITH_ARRAYS = [
    ".".join(("solmap", *file.relative_to(SCIENCE.parent).with_suffix("").parts))
    for file in SCIENCE.rglob("*.py")
    if "photogrammetry.arrays import" in file.read_text()
]
jaxtyping.install_import_hook(_WITH_ARRAYS, "beartype.beartype")  # before anything imports them


@pytest.fixture
def unchecked() -> Iterator[None]:
    """No checks of arrays, in tests that repeat what other tests do many times."""
    jaxtyping.config.update("jaxtyping_disable", value=True)
    yield
    jaxtyping.config.update("jaxtyping_disable", value=False)
