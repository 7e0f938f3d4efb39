"""The adjustment next to GTSAM and Ceres on the same problems, where these are installed.

`make peers` installs them; they are not in the lock.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network

gtsam = pytest.importorskip("gtsam", reason="GTSAM is not installed: make peers")
pytest.importorskip("pycolmap", reason="COLMAP is not installed: make peers")
pytest.importorskip("pyceres", reason="Ceres' options are not installed: make peers")

from tests.support.adjustment import (  # noqa: E402 - only with the peers
    bal,
    ceres_peer,
    gtsam_full,
    gtsam_peer,
)
from tests.support.adjustment.problems import (  # noqa: E402
    aligned,
    covariances,
    ours,
    simulated,
    warm,
)
from tests.support.adjustment.published_stereo import read_problem  # noqa: E402

DATA = Path(gtsam.__file__).parent / "Data"


@pytest.fixture(scope="module")
def small():
    network, _ = simulate_network(
        np.random.default_rng(10), stops=6, inter_ties=20, intra_ties=5,
        errors=replace(TelemetryErrors(), pointing_deg=0.0),
    )  # fmt: skip
    return simulated(network)


def test_covariances_of_all_stops_equal_those_of_gtsam(small):
    state = ours(small).state
    C, expected = covariances(small, state), gtsam_peer.covariances(small, state)[0]
    sigma = np.sqrt(np.diagonal(expected[1:], axis1=1, axis2=2))
    scale = sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose(C[1:] / scale, expected[1:] / scale, atol=1e-6)


@pytest.mark.parametrize("peer", [ceres_peer, gtsam_peer])
def test_peers_find_the_same_minimum(small, peer):
    mine, theirs = ours(small), peer.adjusted(small)
    assert mine.converged
    assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)


@pytest.fixture(scope="module")
def whole():
    """With mast pointings and telemetry."""
    return aligned(simulate_network(np.random.default_rng(10), stops=6, intra_ties=0)[0])


@pytest.mark.parametrize("start", ["cold", "warm"])
def test_the_whole_model_has_the_minimum_that_gtsam_finds(whole, start):
    """There a mast head may shift by a micrometre, which takes 2e-8 off the cost."""
    problem = whole if start == "cold" else warm(whole, np.random.default_rng(1))
    mine, theirs = ours(problem), gtsam_full.adjusted(problem)
    assert mine.converged
    assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)


def test_covariances_of_the_whole_model_equal_those_of_gtsam(whole):
    state = ours(whole).state
    C, expected = covariances(whole, state), gtsam_full.covariances(whole, state)
    sigma = np.sqrt(np.diagonal(expected[1:], axis1=1, axis2=2))
    scale = sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose(C[1:] / scale, expected[1:] / scale, atol=1e-6)


@pytest.mark.skipif(not DATA.is_dir(), reason=f"GTSAM came without its example data at {DATA}")
@pytest.mark.parametrize("peer", [ceres_peer, gtsam_peer])
def test_a_published_stereo_problem_has_the_same_minimum(peer):
    """26 cameras of a car, 2,634 points, 8,189 measurements that nobody here made."""
    problem = read_problem(DATA, "_large")
    mine, theirs = ours(problem), peer.adjusted(problem)
    assert mine.converged
    assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)


@pytest.fixture(scope="module")
def balbianello(tmp_path_factory):
    """A villa by Lake Como in 5 photographs, as Bundler left it, in BAL's format."""
    path = tmp_path_factory.mktemp("bal") / "balbianello.txt"
    if not (DATA / "Balbianello.out").is_file():
        pytest.skip(f"GTSAM came without its example data at {DATA}")
    gtsam.writeBAL(str(path), gtsam.SfmData.FromBundlerFile(str(DATA / "Balbianello.out")))
    return bal.read_bal(path)


def test_a_problem_in_the_format_of_bal_is_read_as_gtsam_reads_it(balbianello, tmp_path):
    assert len(balbianello.start.centres) == 5
    assert (len(balbianello.start.points), len(balbianello.observations)) == (544, 1417)
    broken = tmp_path / "broken.txt"
    broken.write_text("2 1 1\n0 0 1.0 2.0\n" + "0.5\n" * 20)
    with pytest.raises(ValueError, match="2 cameras and 1 points, 18 and 3 numbers, and holds 20"):
        bal.read_bal(broken)


@pytest.mark.parametrize("disturbed", [0.0, 0.01])
def test_a_published_problem_with_free_lenses_has_the_same_minimum(balbianello, disturbed):
    """As it was left, and with its points shaken by a hundredth of their distances."""
    start, rng = balbianello.start, np.random.default_rng(1)
    spread = np.linalg.norm(start.points - start.centres.mean(axis=0), axis=1, keepdims=True)
    points = start.points + disturbed * spread * rng.normal(size=start.points.shape)
    problem = replace(balbianello, start=replace(start, points=points))
    assert bal.ours(problem).cost == pytest.approx(
        ceres_peer.adjusted_with_lenses(problem).cost, rel=1e-6
    )
