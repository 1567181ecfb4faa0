"""Batches that a CPU computes one element after the other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW
from numpy.testing import assert_allclose

from diffmill import cutter as ct, process as pr, sim, workpiece as wp
from diffmill.numerics import batched_in_turn


@batched_in_turn
def grown(values, *, scale, is_large, power="cube"):
    """A sum that takes one of two branches, in a tree with a text."""
    assert power == "cube"
    large, small = (lambda x: (scale * x) ** 3), jnp.sin
    found = jax.lax.cond(is_large, large, small, values["x"])
    return {"y": found, "number": values["number"] + 1, "power": power}


def by_x(x, is_large):
    values = {"x": x, "number": jnp.arange(2)}
    return grown(values, scale=jnp.asarray(2.0), is_large=is_large)["y"]


IS_LARGE = jnp.asarray([True, False, True])
X = jnp.asarray([0.5, 0.25, 1.5])
CUBE, SINE = 8 * X**3, jnp.sin(X)


def test_a_batch_takes_one_branch_for_each_element():
    batch = jax.vmap(by_x)
    assert_allclose(batch(X, IS_LARGE), jnp.where(IS_LARGE, CUBE, SINE), rtol=1e-14)
    text = str(jax.make_jaxpr(batch)(X, IS_LARGE))
    assert "cond" in text and "select_n" not in text
    twice = jax.vmap(jax.vmap(by_x))(X[None], IS_LARGE[None])
    assert_allclose(twice[0], batch(X, IS_LARGE), rtol=0)


def test_what_is_not_batched_stays_one_for_all():
    values = {"x": X[0], "number": jnp.arange(2)}
    run = lambda scale: grown(values, scale=scale, is_large=IS_LARGE[0])
    found = jax.vmap(lambda scale: run(scale)["y"])(jnp.asarray([1.0, 2.0]))
    assert_allclose(found, [0.125, 1.0], rtol=1e-14)
    alone = run(jnp.asarray(1.0))
    assert alone["power"] == "cube" and alone["number"].tolist() == [1, 2]
    assert isinstance(alone["number"], jax.Array)


@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd, jax.jacrev])
def test_derivatives_are_those_of_the_function(derivative):
    slopes = jax.vmap(derivative(by_x))(X, IS_LARGE)
    expected = jnp.where(IS_LARGE, 24 * X**2, jnp.cos(X))
    assert_allclose(slopes, expected, rtol=1e-14)
    second = jax.grad(derivative(by_x))
    assert_allclose(second(X[0], IS_LARGE[0]), 48 * X[0], rtol=1e-13)


def test_runs_of_a_batch_are_those_in_turn():
    stock = wp.box([0, 0, -2e-3], [8e-3, 12e-3, 0], 1e-3)
    mill = ct.flat_end_mill(10e-3, 2)
    plan = pr.choose_engagement(stock, mill, axial_depth=1e-3, angles=24, substeps=2)

    def force(feed):
        x = -5e-3 + feed * jnp.arange(12.0)
        tips = jnp.stack([x, jnp.full(12, 6e-3), jnp.full(12, -1e-3)], axis=1)
        law, speed = PAPER_LAW, 838.0
        run = sim.simulate_process(tips, stock, mill, law, speed, engagement=plan)
        return run.force

    feeds = jnp.asarray([1e-4, 5e-4])
    batch = jax.jit(jax.vmap(force))(feeds)
    in_turn = jax.jit(lambda feeds: jax.lax.map(force, feeds))(feeds)
    np.testing.assert_array_equal(batch, in_turn)
    assert np.abs(batch).max() > 1
