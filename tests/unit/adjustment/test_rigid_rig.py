"""The rigid stereo body against the paper's way: two free cameras and virtual observations."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.synthetic.networks import simulate_network

VIRTUAL_RAD = 1e-7
VIRTUAL_M = 1e-7
"""Standard deviations of the virtual observations that tie the right camera to the left."""


def two_camera_residuals(x, network, params):
    """Weighted residuals when left and right camera are free and the bar is a virtual observation.

    Per pair: rotation of the left camera, then rotation and shift of the right one from where the
    bar puts it, the left about the mast head; then the tie points.
    """
    n = len(network.pairs)
    cameras, points = x[: 9 * n].reshape(n, 9), x[9 * n :].reshape(-1, 3)
    left_turn, right_turn, right_shift = cameras[:, :3], cameras[:, 3:6], cameras[:, 6:]
    ties, rows = network.ties, []
    lsl_from_rover = network.stops[0].lsl_from_rover
    for k in range(len(ties)):
        j, X = ties.pair[k], points[ties.point[k]]
        shape = network.pairs[j].geometry
        label = shape.rover_from_pair
        in_rover = lsl_from_rover.rotation.T @ (X - lsl_from_rover.translation_m)
        turn, pivot = rotation_of_vector(left_turn[j]), network.pairs[j].geometry.pivot_in_rover
        left_rotation = turn @ label.rotation
        left_origin = pivot + turn @ (label.translation_m - pivot)
        right_rotation = rotation_of_vector(right_turn[j]) @ label.rotation
        right_origin = left_origin + left_rotation[:, 0] * shape.base_m + right_shift[j]
        a = left_rotation.T @ (in_rover - left_origin)
        b = right_rotation.T @ (in_rover - right_origin)
        left = np.array(shape.centre_px) + shape.focal_px * a[:2] / a[2]
        right_sample = shape.centre_px[0] + shape.focal_px * b[0] / b[2]
        rows.extend((ties.left[k] - left) / ties.sigma_px[k])
        rows.append((ties.parallax_px[k] - (left[0] - right_sample)) / ties.sigma_parallax_px[k])
    rows.extend((left_turn / np.radians(params.pointing_deg)).ravel())
    rows.extend(((right_turn - left_turn) / VIRTUAL_RAD).ravel())
    rows.extend((right_shift / VIRTUAL_M).ravel())
    return np.array(rows)


@pytest.mark.usefixtures("unchecked")
def test_heavily_weighted_virtual_observations_of_the_baseline_give_the_same_result():
    params = AdjustmentParams(sigma_freedoms=np.inf, mast_deg=1e-7)
    network, _ = simulate_network(
        np.random.default_rng(3), stops=1, pairs_per_stop=9, inter_ties=5, intra_ties=0
    )
    adjusted, report = adjust_overall(network, params)
    assert report.blunders == 0
    pointings = np.array([pair.pointing for pair in adjusted.pairs])
    # start away from the answer: at the label, points half a per cent off
    start = np.concatenate([np.zeros(9 * len(pointings)), 1.005 * adjusted.ties.points.ravel()])
    found = least_squares(
        two_camera_residuals, start, x_scale="jac", method="lm", xtol=1e-12, ftol=1e-12,
        args=(network, params),
    )  # fmt: skip
    cameras = found.x[: 9 * len(pointings)].reshape(-1, 9)
    sigma = np.array([np.sqrt(np.diagonal(p.pointing_covariance)) for p in adjusted.pairs])
    # to a thousandth of the uncertainty: the virtual weights and numeric derivatives are finite
    assert (np.abs(cameras[:, :3] - pointings) / sigma).max() < 1e-3
    points = found.x[9 * len(pointings) :].reshape(-1, 3)
    spread = np.sqrt(np.diagonal(adjusted.ties.covariances, axis1=1, axis2=2))
    assert (np.abs(points - adjusted.ties.points) / spread).max() < 1e-3
    cost = 2 * found.cost
    assert abs(cost / report.redundancy - report.sigma0**2) < 1e-6
