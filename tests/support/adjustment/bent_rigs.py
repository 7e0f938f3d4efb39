"""Networks as rigs would measure them that are not as calibrated."""

from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.model.network import Network
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.synthetic.networks import NetworkTruth


def with_bent_rig(
    network: Network, truth: NetworkTruth, rotation: np.ndarray, longer_m: float
) -> Network:
    """The network as a bent rig sees it: exact projection into the rotated right camera."""
    y = _in_pairs(network, truth)
    shape = network.pairs[0].geometry
    straight = y - [shape.base_m, 0.0, 0.0]
    bent = (y - [shape.base_m + longer_m, 0.0, 0.0]) @ rotation_of_vector(rotation)
    moved = shape.focal_px * (bent[:, 0] / bent[:, 2] - straight[:, 0] / straight[:, 2])
    ties = network.ties
    return replace(network, ties=replace(ties, parallax_px=ties.parallax_px - moved))


def _in_pairs(network: Network, truth: NetworkTruth) -> np.ndarray:
    """Every observed point in the frame of its pair, as it truly stood."""
    stops = dict(zip(network.stop_ids, truth.lsl_from_rover, strict=True))
    found = np.zeros((len(network.ties), 3))
    for k, pair in enumerate(network.pairs):
        rows = np.flatnonzero(network.ties.pair == network.ties.pair_ids.index(pair.pair_id))
        label, pivot = pair.geometry.rover_from_pair, pair.geometry.pivot_in_rover
        turn = rotation_of_vector(truth.pointings[k])
        in_rover = stops[pair.stop].inverse.apply(truth.points[network.ties.point[rows]])
        origin = pivot + turn @ (label.translation_m - pivot)
        found[rows] = (in_rover - origin) @ (turn @ label.rotation)
    return found
