"""Compiled functions that another core compiles before they are called."""

import threading

import jax
import jax.numpy as jnp
import pytest

from diffmill.numerics import CachedJit


def test_what_is_prepared_is_traced_once_and_by_another_thread():
    traced = []

    @CachedJit
    def twice(x):
        traced.append(threading.current_thread())
        return 2 * x

    twice.prepare(jnp.zeros(3))
    assert twice(jnp.ones(3)).tolist() == [2.0, 2.0, 2.0]
    assert twice(4 * jnp.ones(3)).tolist() == [8.0, 8.0, 8.0]
    assert len(traced) == 1


def test_other_shapes_than_prepared_are_right_too():
    total = CachedJit(lambda x: x.sum())
    total.prepare(jnp.zeros(3))
    assert float(total(jnp.ones(5))) == 5.0


def test_what_fails_fails_where_it_is_called():
    @CachedJit
    def fails(x):
        raise RuntimeError("no")

    fails.prepare(jnp.zeros(3))
    with pytest.raises(RuntimeError):
        fails(jnp.zeros(3))


def test_a_call_does_not_wait_for_what_has_not_begun():
    may_end, has_begun = threading.Event(), threading.Event()

    @CachedJit
    def slow(x):
        has_begun.set()
        may_end.wait()
        return x

    quick = CachedJit(lambda x: x + 1)
    # As many as there may be threads, so that none is left.
    blocked = [CachedJit(lambda x, _=i: slow(x)) for i in range(64)]
    for each in blocked:
        each.prepare(jnp.zeros(3))
    has_begun.wait()
    quick.prepare(jnp.zeros(3))
    assert quick(jnp.zeros(3)).tolist() == [1.0, 1.0, 1.0]
    may_end.set()
    assert blocked[0](jnp.ones(3)).tolist() == [1.0, 1.0, 1.0]


def test_derivatives_pass_through():
    square = CachedJit(lambda x: x**2)

    def outer(x):
        square.prepare(x)
        return square(x)

    assert float(jax.grad(outer)(3.0)) == 6.0
