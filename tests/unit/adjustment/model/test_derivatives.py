"""Every derivative is held against central differences."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.model.collinearity import misclosures, partials
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import (
    cross_matrix,
    inverse_left_jacobian,
    left_jacobian,
    rotation_of_vector,
)
from solmap.photogrammetry.adjustment.model.telemetry import (
    Telemetry,
    telemetry_misclosures,
    telemetry_partials,
)

STEP = 1e-6
vectors = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)


def nudged(state, stop=None, pair=None, point=None, axis=0, by=STEP):
    """The state with one unknown changed."""
    unit = np.zeros(3)
    unit[axis % 3] = by
    if stop is not None and axis < 3:
        rotations = state.rotations.copy()
        rotations[stop] = rotation_of_vector(unit) @ rotations[stop]
        return replace(state, rotations=rotations)
    name, k = next(
        (name, k)
        for name, k in (("centres", stop), ("pointings", pair), ("points", point))
        if k is not None
    )
    values = getattr(state, name).copy()
    values[k] += unit
    return replace(state, **{name: values})


def test_image_coordinates_change_with_every_unknown_as_the_partials_state(bent):
    _, observations, state = bent
    rows = np.arange(0, len(observations), 7)
    by_orientation, by_point = partials(state, observations, rows)
    for i, row in enumerate(rows.tolist()):
        stop, pair = int(observations.stop[row]), int(observations.pair[row])
        point, one = int(observations.point[row]), np.array([row])
        unknowns = [{"stop": stop, "axis": a} for a in range(6)]
        unknowns += [{"pair": pair, "axis": a} for a in range(3)]
        unknowns += [{"point": point, "axis": a} for a in range(3)]
        numeric = np.column_stack(
            [
                (
                    misclosures(nudged(state, **u, by=-STEP), observations, one)
                    - misclosures(nudged(state, **u, by=STEP), observations, one)
                )[0]
                / (2 * STEP)
                for u in unknowns
            ]
        )
        analytic = np.hstack([by_orientation[i], by_point[i]])
        # second differences of f/Z at 2 m: 1e-6^2 * 1236 / 2^3, over rounding 1e-13 * 1024 / 1e-6
        np.testing.assert_allclose(analytic, numeric, rtol=1e-6, atol=2e-3)


def test_telemetry_changes_with_every_unknown_as_the_partials_state(bent):
    network, _, state = bent
    for fine in (False, True):
        telemetry = Telemetry.of(network, AdjustmentParams())
        telemetry = replace(telemetry, is_fine=np.full(3, fine))
        analytic = telemetry_partials(state, telemetry)
        for k in (1, 2):
            for column in range(12):
                stop, axis = (k - 1, column) if column < 6 else (k, column - 6)
                change = telemetry_misclosures(
                    nudged(state, stop=stop, axis=axis, by=-STEP), telemetry
                ) - telemetry_misclosures(nudged(state, stop=stop, axis=axis), telemetry)
                np.testing.assert_allclose(
                    analytic[k, :, column], change[k] / (2 * STEP), atol=1e-7
                )


def test_a_rotation_about_the_vertical_is_not_a_tilt(bent):
    """Not even of a stop whose tilt misfits: else Gauss-Newton would hold the turn for it."""
    network, _, state = bent
    telemetry = Telemetry.of(network, AdjustmentParams())
    turned = replace(state, rotations=rotation_of_vector(np.array([0, 0, 0.3])) @ state.rotations)
    tilts = [telemetry_misclosures(s, telemetry)[:, :2] for s in (state, turned)]
    assert np.abs(tilts[0]).min(axis=1)[1:].max() > 1e-3
    np.testing.assert_allclose(tilts[1], tilts[0], atol=1e-15)
    assert not telemetry_partials(state, telemetry)[:, :2, 8].any()


@given(vectors)
def test_the_exponential_of_a_rotation_vector_equals_scipys(vector):
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation_of_vector(vector), expected, atol=1e-14)


@given(vectors, vectors)
def test_the_left_jacobian_maps_a_change_of_the_vector_to_a_rotation(vector, direction):
    change = 1e-6 * direction
    both = rotation_of_vector(vector + change)
    apart = rotation_of_vector(left_jacobian(vector) @ change) @ rotation_of_vector(vector)
    np.testing.assert_allclose(both, apart, atol=1e-11)  # second order: (1.5e-6 * sqrt 3)^2


@given(vectors, st.sampled_from([1.0, 1e-2, 1e-3, 1e-6, 0.0]))
def test_the_inverse_of_the_left_jacobian_undoes_it(vector, share):
    both = left_jacobian(share * vector) @ inverse_left_jacobian(share * vector)
    np.testing.assert_allclose(both, np.eye(3), atol=1e-13)


@given(vectors, vectors)
def test_the_cross_matrix_multiplies_like_the_cross_product(left, right):
    np.testing.assert_allclose(cross_matrix(left) @ right, np.cross(left, right), atol=1e-14)
