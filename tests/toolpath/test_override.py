"""The same way, travelled faster or slower, within the acceleration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.toolpath import (
    Move,
    Path,
    PathFeed,
    Program,
    retime,
    sample_program,
)

T = 2e-3
LIMIT = 0.5


def line(x0, y0, x1, y1, number, **more):
    start, end = (float(x0), float(y0), 0.0), (float(x1), float(y1), 0.0)
    return Move(start=start, end=end, line=number, **more)


@pytest.fixture(scope="module")
def path():
    """Return an L with a rounded corner and a rapid move back."""
    moves = (
        line(0, 0, 20e-3, 0, 1, feed=40e-3),
        line(20e-3, 0, 20e-3, 10e-3, 2, feed=40e-3),
        line(20e-3, 10e-3, 0, 10e-3, 3, is_rapid=True),
    )
    return sample_program(
        Program(moves),
        T,
        acceleration=LIMIT,
        rapid_feed=80e-3,
        corner_tolerance=0.5e-3,
    )


def acceleration_of(path):
    return np.linalg.norm(np.diff(path.positions, 2, axis=0), axis=1) / T**2


def test_an_override_of_one_is_the_path_itself(path):
    same = retime(path, 1.0)
    for name in ("time", "positions", "axes", "is_rapid", "line"):
        np.testing.assert_allclose(
            getattr(same, name), getattr(path, name), atol=1e-12, err_msg=name
        )


def test_half_the_feed_takes_twice_the_time_and_passes_every_row(path):
    only = Path.upright(path.time, path.positions)
    slow = retime(only, 0.5)
    assert slow.step_count == 2 * path.step_count - 1
    np.testing.assert_allclose(slow.positions[::2], path.positions, atol=1e-12)
    # Rapid moves are not overridden.
    rapid = int(np.sum(path.is_rapid))
    kept = retime(path, 0.5)
    assert kept.step_count < slow.step_count - 0.9 * rapid
    assert np.unique(kept.line).tolist() == [1, 2, 3]


def test_a_faster_feed_keeps_the_acceleration_and_takes_the_time_of_trapezoids():
    length, speed, override = 40e-3, 30e-3, 2.0
    program = Program((line(0, 0, length, 0, 1, feed=speed),))
    options = {"acceleration": LIMIT, "rapid_feed": 1.0, "corner_tolerance": 0.0}
    slow = sample_program(program, T, **options)
    fast = retime(slow, override, acceleration=LIMIT)
    v = override * speed
    wanted = length / v + v / LIMIT
    feed = PathFeed.of_path(slow, acceleration=LIMIT)
    assert feed.cycle_time(override) == pytest.approx(wanted, abs=2 * T)
    # Where a motion begins or ends within a row, the difference sees some more.
    assert acceleration_of(fast).max() < 1.15 * LIMIT
    steps = np.linalg.norm(np.diff(fast.positions, axis=0), axis=1)
    assert steps.sum() == pytest.approx(length, rel=1e-9)
    assert steps.max() / T == pytest.approx(v, rel=1e-6)


def test_an_override_above_one_keeps_the_lateral_acceleration(path):
    fast = retime(path, 3.0, acceleration=LIMIT)
    assert fast.duration < path.duration
    # A corner may use both limits at once, along and across, as a program may.
    assert acceleration_of(fast).max() < np.sqrt(2) * LIMIT


def test_rows_after_the_end_stand_still(path):
    long = retime(path, 1.2, step_count=path.step_count + 5)
    np.testing.assert_array_equal(long.positions[-5:], long.positions[-1:].repeat(5, 0))
    with pytest.raises(ValueError, match="`step_count`"):
        retime(path, 0.5, step_count=path.step_count)


def test_derivatives_of_time_and_tips_against_differences(path):
    feed = PathFeed.of_path(path)
    x = np.log([0.7, 0.9, 0.6, 0.8])

    @jax.jit
    def f(x):
        override = jnp.exp(x)
        tips = feed.positions(feed.places(override, 900))
        return feed.instants(override)[-1], tips[150:600:50]

    columns = jax.jit(jax.jacfwd(f))(jnp.asarray(x))
    h = 1e-7
    for k in range(x.size):
        up, down = f(x + h * np.eye(4)[k]), f(x - h * np.eye(4)[k])
        for found, a, b in zip(columns, up, down, strict=True):
            wanted = (np.asarray(a) - np.asarray(b)) / (2 * h)
            np.testing.assert_allclose(found[..., k], wanted, rtol=1e-4, atol=1e-6)


def test_derivative_at_rest_is_finite_and_float32_agrees(path):
    feed = PathFeed.of_path(path)
    gradient = jax.jit(jax.grad(lambda o: feed.instants(o)[-1]))(jnp.ones(3))
    assert np.isfinite(gradient).all()
    ones = jnp.full(3, 0.8, jnp.float32)
    tips = jax.jit(lambda override: feed.positions(feed.places(override, 400)))
    single, double = tips(ones), tips(jnp.full(3, 0.8))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, double, atol=1e-6)


def test_faults_are_named(path):
    with pytest.raises(ValueError, match="`override`"):
        retime(path, [1.0, 0.0])
    with pytest.raises(ValueError, match="at most 1000000"):
        retime(path, 1e-9)
    even = Path.upright(T * np.arange(5.0), np.linspace([0, 0, 0], [1, 0, 0], 5))
    with pytest.raises(ValueError):
        retime(even, 0.5)
    with pytest.raises(ValueError):
        retime(path, 0.5, acceleration=0.0)
    still = Path.upright(T * np.arange(5.0), np.zeros((5, 3)))
    with pytest.raises(ValueError):
        retime(still, 0.5)
