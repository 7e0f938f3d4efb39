"""Runs unit tests under checks of array types and shapes; the longer tests run without them."""

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jaxtyping
import pytest

SCIENCE = Path(__file__).resolve().parents[2] / "photogrammetry"
_WITH_ARRAYS = [
    ".".join(("solmap", *file.relative_to(SCIENCE.parent).with_suffix("").parts))
    for file in SCIENCE.rglob("*.py")
    if "photogrammetry.arrays import" in file.read_text()
]
_checked = jaxtyping.jaxtyped


def _checked_if_of_arrays(*, typechecker: Callable[..., Any]) -> Callable[..., Any]:
    """What the hook decorates with: all types of other functions are known to `make check`."""

    def decorated(of: Any) -> Any:
        types = " ".join(map(str, of.__annotations__.values()))
        known = vars(sys.modules[of.__module__])
        spelt = types + " ".join(str(known.get(name)) for name in re.findall(r"\w+", types))
        is_checked = isinstance(of, type) or "ndarray" in spelt
        return _checked(of, typechecker=typechecker) if is_checked else of

    return decorated


jaxtyping.jaxtyped = _checked_if_of_arrays
jaxtyping.install_import_hook(_WITH_ARRAYS, "beartype.beartype")  # before anything imports them


@pytest.fixture
def unchecked() -> Iterator[None]:
    """No checks of arrays, in tests that repeat what other tests do many times."""
    jaxtyping.config.update("jaxtyping_disable", value=True)
    yield
    jaxtyping.config.update("jaxtyping_disable", value=False)
