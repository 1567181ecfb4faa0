"""Bounded Levenberg-Marquardt against scipy, and its bookkeeping."""

import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from diffmill import RESULTS
from diffmill.correction import (
    HeldRows,
    LevenbergMarquardt,
    StoredProducts,
    least_squares,
)

EXACT = LevenbergMarquardt(
    max_steps=100, max_products=60, cost_rtol=1e-16, kkt_rtol=1e-10, inner_rtol=1e-8
)


def rosenbrock(x, args):
    return jnp.stack([10 * (x[1] - x[0] ** 2), args - x[0]])


def curved(x, args):
    A, b = args
    return jnp.sin(A @ x) + 0.1 * (A @ x) - b


def curved_problem(seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(20, 6)) * 0.4, rng.normal(size=20)


def test_finds_the_minimum_of_rosenbrock():
    solution = least_squares(
        rosenbrock, jnp.array([-1.2, 1.0]), jnp.array(1.0), solver=EXACT
    )
    np.testing.assert_allclose(solution.x, [1.0, 1.0], atol=1e-7)
    assert solution.result is RESULTS.successful


def test_rosenbrock_with_an_active_bound():
    # With x <= 0.5 the valley ends at (0.5, 0.25).
    solution = least_squares(
        rosenbrock,
        jnp.array([-1.2, 1.0]),
        jnp.array(1.0),
        upper=np.array([0.5, 2.0]),
        solver=EXACT,
    )
    assert float(solution.x[0]) == 0.5
    assert float(solution.x[1]) == pytest.approx(0.25, abs=1e-7)
    assert solution.history[-1].bound_count == 1


def test_agrees_with_scipy_within_bounds():
    A, b = curved_problem()
    scale = np.array([1.0, 0.1, 10.0, 1.0, 1.0, 3.0])
    solver = LevenbergMarquardt(100, 60, 1e-15, 1e-9, 1e-6, 1e-6)
    solution = least_squares(
        curved,
        jnp.zeros(6),
        (jnp.asarray(A), jnp.asarray(b)),
        lower=-0.3,
        upper=0.4,
        scale=scale,
        solver=solver,
    )
    expected = optimize.least_squares(
        lambda x: np.sin(A @ x) + 0.1 * (A @ x) - b,
        np.zeros(6),
        bounds=(-0.3, 0.4),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-14,
    )
    assert np.sum(expected.active_mask != 0) > 0
    assert solution.cost == pytest.approx(expected.cost, rel=1e-9)
    np.testing.assert_allclose(solution.x, expected.x, atol=1e-5)
    x = np.asarray(solution.x)
    assert np.all((x >= -0.3) & (x <= 0.4))


def test_counts_what_it_spends(monkeypatch):
    A, b = curved_problem(1)
    traces, trials = [], []
    module = importlib.import_module("diffmill.correction._least_squares")
    evaluate = module.evaluate
    monkeypatch.setattr(
        module, "evaluate", lambda *at: trials.append(1) or evaluate(*at)
    )

    def counted(x, args):
        traces.append(1)
        return curved(x, args)

    told = []
    solution = least_squares(
        counted,
        jnp.zeros(6),
        (jnp.asarray(A), jnp.asarray(b)),
        solver=LevenbergMarquardt(max_steps=8, max_products=9),
        on_progress=told.append,
    )
    history = solution.history
    assert len(history) >= 2
    assert told == list(history)
    # One trace of the residual for the trial points and one for the linearisations.
    assert len(traces) == 2
    spent = np.diff([step.products for step in history])
    assert np.all(spent <= 9)
    accepted = sum(step.is_accepted for step in history)
    assert solution.forward_runs == 1 + len(trials) + accepted
    # A refused step has been tried again.
    assert accepted == len(history) < len(trials)
    costs = [step.cost for step in history]
    assert np.all(np.diff(costs) <= 0)
    assert solution.cost == costs[-1]


def test_a_progress_call_can_end_it():
    solution = least_squares(
        rosenbrock,
        jnp.array([-1.2, 1.0]),
        jnp.array(1.0),
        solver=EXACT,
        on_progress=lambda step: step.step == 2,
    )
    assert len(solution.history) == 2
    assert solution.result is RESULTS.not_converged


def test_a_start_that_is_not_finite_is_told():
    solution = least_squares(lambda x, args: jnp.log(x), jnp.array([-1.0, 2.0]))
    assert solution.result is RESULTS.non_finite


def test_a_trial_that_is_not_finite_is_refused():
    # The first Gauss-Newton step from 3 leads to a negative logarithm.
    solution = least_squares(
        lambda x, args: jnp.log(x) + 1.0, jnp.array([3.0]), solver=EXACT
    )
    assert solution.history[0].forward_runs > 3
    assert float(solution.x[0]) == pytest.approx(np.exp(-1), rel=1e-6)


def test_products_are_the_jacobian():
    products = StoredProducts()
    A, b = curved_problem(2)
    args = (jnp.asarray(A), jnp.asarray(b))
    rng = np.random.default_rng(0)
    x, v, w = (jnp.asarray(rng.normal(size=n)) for n in (6, 6, 20))
    _, linear = products.linearise(curved, x, args)
    J = jax.jacobian(curved)(x, args)
    J_v = products.forward(linear, v)
    J_w = products.transpose(linear, x, w)
    np.testing.assert_allclose(J_v, J @ v, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(J_w, J.T @ w, rtol=1e-12, atol=1e-12)


def test_refuses_crossed_bounds():
    with pytest.raises(ValueError, match="lower"):
        least_squares(rosenbrock, jnp.zeros(2), jnp.array(1.0), lower=1.0, upper=0.0)


def test_a_shorter_trial_costs_no_product():
    """Not where a row is held either, whose push on the step would be one."""
    solver = LevenbergMarquardt(
        max_steps=1, max_products=9, cost_rtol=1e-16, kkt_rtol=1e-10
    )
    spent = {}
    for slope in (0.1, 3.0):
        # The deeper, the further beyond the linear model leads.
        solution = least_squares(
            lambda x, at: jnp.stack([jnp.arctan(at * x[0]), x[0]]),
            jnp.array([1.0]),
            slope,
            held=HeldRows(np.array([-5.0]), np.array([5.0])),
            solver=solver,
        )
        (step,) = solution.history
        spent[slope] = (step.forward_runs - step.is_accepted, step.products)
    assert spent[0.1][0] == 2 < spent[3.0][0]
    assert spent[0.1][1] >= spent[3.0][1] > 0
