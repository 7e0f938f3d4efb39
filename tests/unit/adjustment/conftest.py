"""Networks and states that the tests of the adjustment share."""

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.collinearity import Observations, State
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.synthetic.networks import simulate_network


@pytest.fixture
def params() -> AdjustmentParams:
    return AdjustmentParams()


@pytest.fixture
def stated() -> AdjustmentParams:
    """All standard deviations taken as stated, so that two solutions can be one and the same."""
    return AdjustmentParams(sigma_freedoms=np.inf)


@pytest.fixture
def bent():
    """A small network and a state near its truth in which nothing is zero or aligned."""
    rng = np.random.default_rng(5)
    network, truth = simulate_network(rng, stops=3, inter_ties=8, intra_ties=3, cross_ties=8)
    observations = Observations.of(network)
    state = State(
        np.array([pose.rotation for pose in truth.lsl_from_rover]),
        np.array([pose.translation_m for pose in truth.lsl_from_rover])
        + rng.normal(0, 0.05, (3, 3)),
        rng.normal(0, 0.02, (len(network.pairs), 3)),
        truth.points + rng.normal(0, 0.05, truth.points.shape),
    )
    return network, observations, state
