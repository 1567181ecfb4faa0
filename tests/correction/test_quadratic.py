"""Bounded quadratic programs against scipy's bounded linear least squares."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from diffmill.correction import solve_bounded_quadratic


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("bound", [0.02, 0.2, 2.0])
def test_agrees_with_scipy(seed, bound):
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(30, 12)) * np.logspace(0, -1.5, 12)
    r = rng.normal(size=30)
    lower = -bound * rng.uniform(0, 1, 12)
    upper = bound * rng.uniform(0.1, 1, 12)
    lower[0] = 0.0
    expected = lsq_linear(J, -r, (lower - 1e-300, upper), tol=1e-14)
    found = solve_bounded_quadratic(
        lambda p: J.T @ (J @ p), J.T @ r, lower, upper, rtol=1e-10, max_products=2000
    )
    assert np.all(found.p >= lower) and np.all(found.p <= upper)
    np.testing.assert_allclose(found.p, expected.x, atol=2e-6 * bound)
    assert found.relative_gradient <= 1e-10
    assert found.decrease == pytest.approx(0.5 * r @ r - expected.cost, rel=1e-9)


def test_without_bounds_it_ends_after_as_many_products_as_unknowns():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(40, 8))
    g = rng.normal(size=8)
    far = np.full(8, np.inf)
    found = solve_bounded_quadratic(
        lambda p: J.T @ (J @ p), g, -far, far, rtol=1e-9, max_products=100
    )
    assert found.products <= 9
    np.testing.assert_allclose(found.p, -np.linalg.solve(J.T @ J, g), atol=1e-8)


def test_keeps_the_budget_and_still_descends_within_the_bounds():
    rng = np.random.default_rng(1)
    J = rng.normal(size=(60, 50))
    g = J.T @ rng.normal(size=60)
    calls = []

    def product(p):
        calls.append(1)
        return J.T @ (J @ p)

    bound = np.full(50, 0.01)
    found = solve_bounded_quadratic(product, g, -bound, bound, max_products=3)
    assert found.products == len(calls) <= 3
    assert found.decrease > 0
    assert np.all(np.abs(found.p) <= bound)


def test_a_zero_gradient_needs_nothing():
    found = solve_bounded_quadratic(lambda p: p, np.zeros(3), -np.ones(3), np.ones(3))
    assert found.products == 0
    assert np.all(found.p == 0)
