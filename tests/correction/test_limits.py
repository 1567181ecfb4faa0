"""Limits of velocity and acceleration: safe everywhere, held exactly, optimal."""

import jax.numpy as jnp
import numpy as np
import pytest
from correction.spring_mass import square_problem

from diffmill.correction import (
    GaussNewton,
    InfeasibleLimit,
    LinearLimits,
    SplineOffsets,
)
from diffmill.optimise import LinearRows, QuadraticModel

TIME_STEP = 3.75e-3


def small_spline():
    return SplineOffsets(81, 0.01, 0.05)


def test_rows_are_the_derivatives_of_the_curve():
    spline = small_spline()
    rng = np.random.default_rng(0)
    c = rng.normal(size=(spline.coefficient_count, 2))
    curve = np.asarray(spline.offsets(jnp.asarray(c)))
    nominal = np.cumsum(rng.normal(size=(81, 2)), axis=0)
    limits = LinearLimits.of_command(
        spline, nominal, max_velocity=1e4, max_acceleration=1e6
    )
    for order, limit, most in ((1, limits[0], 1e4), (2, limits[1], 1e6)):
        rows = limit.apply(c)
        # What is left to the upper limit is what the whole command leaves to it.
        total = np.diff(nominal + curve, order, axis=0) / spline.time_step**order
        total = total.reshape(-1)
        scale = spline.actual_spacing**order
        np.testing.assert_allclose((limit.upper - rows) / scale, most - total)
        np.testing.assert_allclose((rows - limit.lower) / scale, most + total)


def test_a_program_beyond_the_limit_is_named():
    nominal = np.zeros((81, 3))
    nominal[:, 1] = 0.5 * 3.0 * (0.01 * np.arange(81)) ** 2
    with pytest.raises(InfeasibleLimit, match=r"3 m/s\^2 .*axis 1.*1 m/s\^2"):
        LinearLimits.of_command(small_spline(), nominal, max_acceleration=2.0, unit="m")
    assert LinearLimits.of_command(small_spline(), nominal) == ()


def test_a_program_at_the_limit_is_none_beyond_it():
    """Second differences of a ramp are its acceleration but for rounding."""
    nominal = np.zeros((81, 3))
    nominal[:, 1] = 0.5 * 0.5 * (0.01 * np.arange(81)) ** 2
    rate = np.diff(nominal, 2, axis=0) / 0.01**2
    assert np.abs(rate).max() > 0.5
    (limit,) = LinearLimits.of_command(small_spline(), nominal, max_acceleration=0.5)
    assert np.all(limit.lower <= 0) and np.all(limit.upper >= 0)


def test_the_minimum_within_limits_is_that_of_a_dense_solver():
    from scipy.optimize import minimize
    from scipy.sparse import csr_array

    spline = SplineOffsets(81, 0.01, 0.08)
    count = spline.coefficient_count
    rng = np.random.default_rng(2)
    root = rng.normal(size=(2 * count, count))
    A, g = root.T @ root, rng.normal(size=count)
    (limit,) = LinearLimits.of_command(spline, np.zeros((81, 1)), max_acceleration=8.0)
    rows = limit.about(np.zeros((count, 1)))
    far = np.full(count, 0.08)
    box = LinearRows(np.eye(count), -far, far)
    cost = lambda p: 0.5 * p @ A @ p + g @ p
    found = QuadraticModel(lambda p, _: cost(p), g, A, (box, rows)).minimum()
    assert found is not None
    matrix = csr_array(rows.matrix).toarray()
    assert np.all(matrix @ found <= rows.upper + 1e-9)
    assert np.all(matrix @ found >= rows.lower - 1e-9)
    dense = minimize(
        cost,
        np.zeros(count),
        jac=lambda p: A @ p + g,
        bounds=[(-0.08, 0.08)] * count,
        constraints=[
            {"type": "ineq", "fun": lambda p: rows.upper - matrix @ p},
            {"type": "ineq", "fun": lambda p: matrix @ p - rows.lower},
        ],
        options={"maxiter": 500, "ftol": 1e-14},
    )
    free = -0.5 * g @ np.linalg.solve(A, g)
    assert dense.fun > 0.9 * free
    assert cost(found) == pytest.approx(dense.fun, rel=1e-6)


def test_gauss_newton_holds_a_velocity_and_pays_for_it():
    problem = square_problem(TIME_STEP)
    fastest = lambda rows: np.abs(np.diff(rows, axis=0)).max() / TIME_STEP
    free = GaussNewton(30e-3)(problem)
    limit = 1.02 * float(fastest(problem.desired))
    assert fastest(np.asarray(free.command)) > 1.05 * limit
    held = GaussNewton(30e-3, max_velocity=limit)(problem)
    assert fastest(np.asarray(held.command)) == pytest.approx(limit, rel=1e-3)
    assert fastest(np.asarray(held.command)) <= limit * (1 + 1e-9)
    assert free.measures.rms < held.measures.rms < 2 * free.measures.rms
    with pytest.raises(InfeasibleLimit, match="max_velocity"):
        GaussNewton(30e-3, max_velocity=0.9 * limit)(problem)
