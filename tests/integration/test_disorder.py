"""What is published is a function of the files that came, not of how they came."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.disorder import deliveries, differences
from tests.support.small_downlink import write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents, faults

pytestmark = [pytest.mark.usefixtures("engine"), pytest.mark.slow]


def compared(tmp_path: Path, sols: int, pairs: int, turns: int, seed: int) -> list[str]:
    """How a run in disorder differs from one of the whole downlink at once."""
    from flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    downlink = write_small_downlink(tmp_path / "downlink", stops=sols, pairs=pairs)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml"))
    clean, disordered = tmp_path / "clean", tmp_path / "disordered"
    process_downlink(downlink, clean, pipeline)
    rng = np.random.default_rng(seed)
    for delivery in deliveries(downlink, tmp_path / "deliveries", turns, rng):
        process_downlink(delivery, disordered, pipeline)
    assert faults(disordered) == []
    return differences(Contents.of(clean), Contents.of(disordered))


@pytest.mark.parametrize("seed", [1])
def test_four_sols_in_disorder_end_as_in_order(tmp_path: Path, seed: int) -> None:
    assert compared(tmp_path, sols=4, pairs=1, turns=3, seed=seed) == []


def test_thirty_sols_in_disorder_end_as_in_order(tmp_path: Path) -> None:
    assert compared(tmp_path, sols=30, pairs=1, turns=8, seed=30) == []
