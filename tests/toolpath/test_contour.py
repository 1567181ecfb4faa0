"""Contour error: known offsets, dwells, signs and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.toolpath import ContourStatistics, contour_error, contour_vector


def wave(count=60):
    s = np.linspace(0, 1, count)
    return np.stack([0.02 * s, 0.003 * np.sin(7 * s), 0.001 * s**2], axis=1)


def brute_force(actual, desired, window):
    out = []
    for k, p in enumerate(actual):
        best = None
        for i in range(max(0, k - window), min(len(desired) - 1, k + window)):
            a, d = desired[i], desired[i + 1] - desired[i]
            t = np.clip((p - a) @ d / (d @ d), 0, 1) if d @ d > 0 else 0.0
            gap = p - a - t * d
            if best is None or gap @ gap < best @ best:
                best = gap
        out.append(best)
    return np.array(out)


def test_known_offset_of_a_late_tool():
    x = np.linspace(0, 0.01, 40)
    desired = np.stack([x, 0 * x, 0 * x], axis=1)
    actual = np.roll(desired, 3, axis=0) + np.array([0, 2e-5, -1e-5])
    actual[:3] = [0, 2e-5, -1e-5]
    vector = contour_vector(actual, desired)
    np.testing.assert_allclose(vector, np.tile([0, 2e-5, -1e-5], (40, 1)), atol=1e-18)
    np.testing.assert_allclose(
        contour_error(actual, desired), np.full(40, np.sqrt(5e-10)), rtol=1e-12
    )


@pytest.mark.parametrize("window", [1, 5, 20])
def test_against_a_plain_search(window):
    rng = np.random.default_rng(0)
    desired = wave()
    actual = desired + 3e-4 * rng.standard_normal(desired.shape)
    np.testing.assert_allclose(
        contour_vector(actual, desired, window=window),
        brute_force(actual, desired, window),
        atol=1e-16,
    )


@pytest.mark.parametrize("count", [50, 65, 120])
def test_a_desired_path_of_other_length_stays_at_its_end(count):
    rows = np.minimum(np.arange(120), 59)
    desired = wave()[rows]
    noise = np.random.default_rng(0).standard_normal((count, 3))
    actual = desired[:count] + 3e-4 * noise
    found = contour_vector(actual, wave())
    np.testing.assert_allclose(found, brute_force(actual, desired, 20), atol=1e-16)
    expected = np.linalg.norm(found, axis=1)
    np.testing.assert_allclose(contour_error(actual, wave()), expected, rtol=1e-12)


def test_window_hides_another_pass():
    out = np.linspace(0, 0.01, 30)
    x = np.concatenate([out, out[::-1]])
    y = np.concatenate([np.zeros(30), np.full(30, 1e-4)])
    desired = np.stack([x, y, 0 * x], axis=1)
    actual = desired + np.array([0, 9e-5, 0])
    error = contour_error(actual, desired, window=5)
    np.testing.assert_allclose(error[:20], 9e-5, rtol=1e-9)
    assert contour_error(actual, desired, window=50)[10] < 2e-5


def test_dwell_and_zero_error_are_finite():
    desired = np.concatenate([wave(20), np.tile(wave(20)[-1], (15, 1))])
    error, gradient = jax.value_and_grad(
        lambda a: jnp.sum(contour_error(a, desired, window=4))
    )(jnp.asarray(desired))
    assert error == 0
    np.testing.assert_array_equal(gradient, 0.0)
    shifted = desired + np.array([0.0, 0.0, 1e-5])
    gradient = jax.grad(lambda a: jnp.sum(contour_error(a, desired, window=4)))(
        jnp.asarray(shifted)
    )
    assert np.all(np.isfinite(gradient))
    np.testing.assert_allclose(gradient[-10:], [[0, 0, 1]] * 10, atol=1e-12)
    at_rest = np.tile([[1e-3, 0.0, 0.0]], (12, 1))
    np.testing.assert_allclose(
        contour_error(at_rest + np.array([0, 3e-6, 4e-6]), at_rest), 5e-6, rtol=1e-9
    )


def test_sign_follows_outward():
    desired = wave()
    side = np.tile([0.0, 0.0, 1.0], (60, 1))
    lift = np.array([0, 0, 1e-6])
    up, down = desired + lift, desired - lift
    assert np.all(contour_error(up, desired, outward=side) > 0)
    assert np.all(contour_error(down, desired, outward=side) < 0)
    assert np.all(contour_error(down, desired, outward=0 * side) > 0)


@pytest.mark.parametrize("with_desired", [False, True])
def test_derivatives_against_finite_differences(with_desired):
    rng = np.random.default_rng(1)
    desired = wave()
    actual = jnp.asarray(desired + 1e-4 * rng.standard_normal(desired.shape))
    move = jnp.asarray(rng.standard_normal(desired.shape))
    weight = jnp.asarray(rng.standard_normal(60))
    desired = jnp.asarray(desired)

    @jax.jit
    def scalar(step):
        shift = step * move
        if with_desired:
            return jnp.sum(weight * contour_error(actual, desired + shift))
        return jnp.sum(weight * contour_error(actual + shift, desired))

    # A step of 1 nm against offsets of 0.1 mm.
    step = 1e-9
    central = (scalar(jnp.asarray(step)) - scalar(jnp.asarray(-step))) / (2 * step)
    zero = jnp.zeros(())
    np.testing.assert_allclose(jax.grad(scalar)(zero), central, rtol=2e-6)
    forward = jax.jvp(scalar, (zero,), (jnp.ones(()),))[1]
    np.testing.assert_allclose(forward, jax.grad(scalar)(zero), rtol=1e-12)


@pytest.mark.parametrize("beside", [0.0, 1e-5])
def test_derivatives_at_the_rows_themselves(beside):
    # Of a straight path: along it a tip is never late, across it the whole way counts.
    desired = jnp.asarray(np.arange(8.0)[:, None] * np.array([[1e-3, 0.0, 0.0]]))
    actual = desired + jnp.array([[0.0, beside, 0.0]])
    for way, wanted in ((0, 0.0), (1, 1.0), (2, 1.0)):
        moved = jnp.zeros_like(actual).at[:, way].set(1.0)
        change = jax.jvp(lambda x: contour_vector(x, desired), (actual,), (moved,))[1]
        expected = np.zeros((8, 3))
        expected[:, way] = wanted
        np.testing.assert_allclose(change[1:-1], expected[1:-1], atol=1e-12)


def test_float32_and_vmap():
    desired = jnp.asarray(wave(), jnp.float32)
    lift = jnp.asarray([[[0, 0, 1e-4]], [[0, 0, 2e-4]]], jnp.float32)
    batch = desired[None] + lift
    error = jax.jit(jax.vmap(contour_error, in_axes=(0, None)))(batch, desired)
    assert error.dtype == jnp.float32
    expected = np.stack([contour_error(a, desired) for a in batch])
    np.testing.assert_allclose(error, expected, rtol=1e-5)


def test_window_must_be_positive():
    with pytest.raises(ValueError, match="window"):
        contour_vector(wave(), wave(), window=0)


def test_statistics_count_the_rows_that_have_a_weight():
    error = np.array([3e-6, -4e-6, 1.0, 5e-6, np.nan])
    counts = np.array([True, True, False, True, False])
    found = ContourStatistics.of(error, counts)
    assert (found.mean, found.max) == pytest.approx((4e-6, 5e-6))
    assert found.rms == pytest.approx(np.sqrt(50 / 3) * 1e-6)
    assert found.p95 == pytest.approx(np.percentile(np.abs(error[counts]), 95))
    weighted = ContourStatistics.of(error, np.array([1.0, 3.0, 0.0, 0.0, 0.0]))
    assert weighted.rms == pytest.approx(np.sqrt((9 + 3 * 16) / 4) * 1e-6)
    for rows in ([True] * 5, [False] * 5):
        assert np.isnan(ContourStatistics.of(error, np.array(rows)).rms)


def test_statistics_of_a_traced_error_name_the_formula():
    rms = lambda error: ContourStatistics.of(error).rms
    with pytest.raises(TypeError, match="where=is_cutting"):
        jax.grad(rms)(jnp.ones(3))
