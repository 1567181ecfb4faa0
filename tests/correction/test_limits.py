"""Limits of velocity and acceleration: safe everywhere, held exactly, optimal."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from correction.spring_mass import rounded_square, soft_arm
from scipy import sparse

from diffmill.correction import (
    GaussNewton,
    InfeasibleLimit,
    LimitedQuadratic,
    MixedLimits,
    Problem,
    SplineOffsets,
    command_limits,
)
from diffmill.correction._limited_quadratic import _Span

TIME_STEP = 3.75e-3


def small_spline():
    return SplineOffsets(81, 0.01, 0.05)


def test_rows_are_the_derivatives_of_the_curve():
    spline = small_spline()
    rng = np.random.default_rng(0)
    c = rng.normal(size=(spline.coefficient_count, 2))
    curve = np.asarray(spline.offsets(jnp.asarray(c)))
    nominal = np.cumsum(rng.normal(size=(81, 2)), axis=0)
    limits = command_limits(spline, nominal, max_velocity=1e4, max_acceleration=1e6)
    for order, limit, most in ((1, limits[0], 1e4), (2, limits[1], 1e6)):
        rows = limit.apply(c)
        # What is left to the upper limit is what the whole command leaves to it.
        total = np.diff(nominal + curve, order, axis=0) / spline.time_step**order
        scale = spline.actual_spacing**order
        np.testing.assert_allclose((limit.upper - rows) / scale, most - total)
        np.testing.assert_allclose((rows - limit.lower) / scale, most + total)
        w = rng.normal(size=rows.shape)
        assert np.sum(w * rows) == pytest.approx(np.sum(limit.transpose(w) * c))


def test_a_program_beyond_the_limit_is_named():
    nominal = np.zeros((81, 3))
    nominal[:, 1] = 0.5 * 3.0 * (0.01 * np.arange(81)) ** 2
    with pytest.raises(InfeasibleLimit, match=r"3 m/s\^2 on axis 1.*1 m/s\^2 too low"):
        command_limits(small_spline(), nominal, max_acceleration=2.0, unit="m")
    assert command_limits(small_spline(), nominal) == ()


def test_a_program_at_the_limit_is_none_beyond_it():
    """Second differences of a ramp are its acceleration but for rounding."""
    nominal = np.zeros((81, 3))
    nominal[:, 1] = 0.5 * 0.5 * (0.01 * np.arange(81)) ** 2
    rate = np.diff(nominal, 2, axis=0) / 0.01**2
    assert np.abs(rate).max() > 0.5
    (limit,) = command_limits(small_spline(), nominal, max_acceleration=0.5)
    assert np.all(limit.lower <= 0) and np.all(limit.upper >= 0)


def test_limited_quadratic_is_that_of_a_dense_solver():
    from scipy.optimize import minimize

    spline = SplineOffsets(81, 0.01, 0.08)
    shape = (spline.coefficient_count, 1)
    rng = np.random.default_rng(2)
    root = rng.normal(size=(2 * shape[0], shape[0]))
    A, g = root.T @ root, rng.normal(size=shape)
    limits = command_limits(spline, np.zeros((81, 1)), max_acceleration=8.0)
    (limit,) = limits
    box = np.full(shape, 0.08)
    problem = LimitedQuadratic(
        lambda p: A @ p, g, -box, box, limits, rtol=1e-8, max_products=2000
    )
    found = problem.solve()
    rows = limit.apply(found.p)
    assert np.all((rows <= limit.upper) & (rows >= limit.lower))
    matrix = np.stack([limit.apply(e[:, None])[:, 0] for e in np.eye(shape[0])], 1)
    constraints = [
        {"type": "ineq", "fun": lambda p: limit.upper[:, 0] - matrix @ p},
        {"type": "ineq", "fun": lambda p: matrix @ p - limit.lower[:, 0]},
    ]
    cost = lambda p: 0.5 * p @ A @ p + g[:, 0] @ p
    dense = minimize(
        cost,
        np.zeros(shape[0]),
        jac=lambda p: A @ p + g[:, 0],
        bounds=[(-0.08, 0.08)] * shape[0],
        constraints=constraints,
        options={"maxiter": 500, "ftol": 1e-14},
    )
    free = -0.5 * g[:, 0] @ np.linalg.solve(A, g[:, 0])
    assert dense.fun > 0.9 * free
    assert cost(found.p[:, 0]) == pytest.approx(dense.fun, rel=2e-2)
    assert found.decrease == pytest.approx(-cost(found.p[:, 0]), rel=1e-6)


@pytest.mark.parametrize("has_limit", [False, True])
def test_what_cannot_move_takes_nothing_from_the_rest(has_limit):
    """As the ends of a segment: their slopes neither settle nor spread."""
    rng = np.random.default_rng(4)
    n, pinned = 60, np.arange(60) % 3 == 0
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    A = Q @ (np.logspace(0, -3, n)[:, None] * Q.T)
    g = A @ rng.normal(size=(n, 1))
    free = np.flatnonzero(~pinned)
    box = np.where(pinned, 0.0, 100.0)[:, None]
    # A limit far away, to which nothing comes.
    most = np.full(n, 1e3)
    matrix: Any = sparse.csr_array(np.eye(n))
    far = MixedLimits(matrix, -most, most, 1)
    mix = Q @ (np.logspace(0, 3, n)[:, None] * Q.T)
    problem = LimitedQuadratic(
        lambda p: A @ p,
        g,
        -box,
        box,
        (far,) if has_limit else (),
        rtol=1e-6,
        max_products=15 if has_limit else 30,
        precondition=lambda r: mix @ r,
    )
    found = problem.solve()
    best = 0.5 * g[free, 0] @ np.linalg.solve(A[np.ix_(free, free)], g[free, 0])
    assert np.all(found.p[pinned] == 0)
    assert found.products <= 30
    assert found.decrease == pytest.approx(best, rel=1e-7)


def test_slow_conjugate_gradients_do_not_hand_rounding_on():
    # Each vector leans on the one before: orthonormal ones of all of them multiply the
    # rounding of a product by fifty each time.
    rng = np.random.default_rng(3)
    A = np.diag(np.logspace(0, -4, 60))
    Q = np.linalg.qr(rng.normal(size=(60, 20)))[0]
    span = _Span(lambda p: A @ p, (), rounding=2.2e-16)
    for k in range(20):
        v = Q[:, max(k - 1, 0)] + 0.02 * Q[:, k]
        span.multiplied(v[:, None])
    V, A_V = np.split(np.stack(span._long, axis=1), 2)
    assert V.shape[1] >= 5
    np.testing.assert_allclose(V.T @ V, np.eye(V.shape[1]), atol=1e-12)
    np.testing.assert_allclose(A_V, A @ V, atol=1e-7)
    span.multiplied(np.zeros((60, 1)))
    assert len(span._long) == V.shape[1]


def test_gauss_newton_holds_a_velocity_and_pays_for_it():
    _, path, is_cutting = rounded_square(TIME_STEP)
    problem = Problem(soft_arm(TIME_STEP), path, path, is_cutting * 1.0, TIME_STEP)
    fastest = lambda rows: np.abs(np.diff(rows, axis=0)).max() / TIME_STEP
    free = GaussNewton(30e-3)(problem)
    limit = 1.02 * float(fastest(path))
    assert fastest(np.asarray(free.command)) > 1.05 * limit
    held = GaussNewton(30e-3, max_velocity=limit)(problem)
    assert fastest(np.asarray(held.command)) == pytest.approx(limit, rel=1e-3)
    assert fastest(np.asarray(held.command)) <= limit * (1 + 1e-9)
    assert free.measures.rms < held.measures.rms < 2 * free.measures.rms
    with pytest.raises(InfeasibleLimit, match="max_velocity"):
        GaussNewton(30e-3, max_velocity=0.9 * limit)(problem)
