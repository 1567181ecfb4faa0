"""The spline basis against scipy's and against its own promises."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from diffmill.correction import SplineOffsets, project

SPLINE = SplineOffsets(201, 3.75e-3, 30e-3)


def random_coefficients(seed=0, axes=2):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (SPLINE.coefficient_count, axes))


def dense_basis():
    count = SPLINE.coefficient_count
    return np.asarray(SPLINE.offsets(jnp.eye(count)))


def test_is_the_spline_that_scipy_evaluates():
    c = random_coefficients()
    h = SPLINE.actual_spacing
    knots = h * np.arange(-3, SPLINE.interval_count + 4)
    full = np.concatenate([np.zeros((3, 2)), c, np.zeros((3, 2))])
    time = np.arange(201) * SPLINE.time_step
    expected = BSpline(knots, full, 3)(time)
    np.testing.assert_allclose(SPLINE.offsets(jnp.asarray(c)), expected, atol=1e-13)


def test_rests_at_both_ends():
    offsets = np.asarray(SPLINE.offsets(jnp.asarray(random_coefficients())))
    # Offset, slope and curvature vanish, so the first rows grow with the cube of time.
    for curve in (offsets, offsets[::-1]):
        assert np.all(curve[0] == 0)
        np.testing.assert_allclose(curve[2] / curve[1], 8.0, rtol=1e-9)


def test_bounded_coefficients_bound_the_curve():
    signs = np.sign(random_coefficients(3))
    assert np.abs(SPLINE.offsets(jnp.asarray(signs))).max() <= 1 + 1e-15


def test_knots_are_never_closer_than_asked():
    assert SPLINE.actual_spacing == pytest.approx(30e-3, rel=1e-12)
    other = SplineOffsets(201, 3.75e-3, 31e-3)
    assert other.actual_spacing >= 31e-3


def test_fit_is_the_least_squares_solution():
    rng = np.random.default_rng(1)
    signal = rng.normal(size=(201, 3))
    expected = np.linalg.lstsq(dense_basis(), signal, rcond=None)[0]
    np.testing.assert_allclose(SPLINE.fit(signal), expected, atol=1e-9)


def test_roughness_is_the_second_derivative_at_the_knots():
    c = random_coefficients(2)
    h = SPLINE.actual_spacing
    knots = h * np.arange(-3, SPLINE.interval_count + 4)
    full = np.concatenate([np.zeros((3, 2)), c, np.zeros((3, 2))])
    inner = h * np.arange(1, SPLINE.interval_count)
    second = BSpline(knots, full, 3).derivative(2)(inner)
    rough = np.asarray(SPLINE.roughness(jnp.asarray(c))) / h**2
    np.testing.assert_allclose(rough[1:-1], second[1:-1], rtol=1e-9, atol=1e-9)


def test_projection_meets_the_bound_and_the_conditions_of_optimality():
    time = np.arange(201) * SPLINE.time_step
    signal = np.stack([np.sin(9 * time), 0.3 * np.cos(20 * time)], axis=1)
    bound = 0.5
    c = project(SPLINE, signal, bound)
    B = dense_basis()
    gradient = B.T @ (B @ c - signal)
    assert bound * (1 - 1e-6) < np.abs(c).max() <= bound
    scale = np.abs(B.T @ signal).max()
    inside = np.abs(c) < bound * (1 - 1e-6)
    assert np.abs(gradient[inside]).max() < 1e-6 * scale
    # At a bound the cost may fall only by leaving the box.
    assert np.all(gradient[~inside] * np.sign(c[~inside]) < 1e-6 * scale)


def test_refuses_knots_wider_than_the_program():
    with pytest.raises(ValueError, match="`knot_spacing`"):
        SplineOffsets(10, 3.75e-3, 30e-3)
