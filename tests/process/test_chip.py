import jax
import jax.numpy as jnp
import numpy as np
import pytest
from references.trochoid import TrochoidCut

from diffmill import cutting, process

R = 5e-3


def march_to_circle(offset, angle):
    """Return the thickness by bisection along the tooth's radius."""
    outward = np.array([np.sin(angle), np.cos(angle)])
    low, high = 0.0, 2 * R
    for _ in range(80):
        middle = (low + high) / 2
        point = outward * middle - offset
        low, high = (middle, high) if np.hypot(*point) < R else (low, middle)
    return R - low


@pytest.mark.parametrize("angle", [0.3, 1.2, 2.8])
def test_the_chip_ends_where_the_earlier_circle_does(angle):
    offset = np.array([-0.4e-3, 0.15e-3])
    chip = process.circle_chip(R, jnp.array([*offset, 0.0]), jnp.array([angle]), 0.0)
    np.testing.assert_allclose(chip[0], march_to_circle(offset, angle), atol=1e-12)


def test_the_chip_tends_to_feed_times_sine():
    phi = jnp.linspace(0.1, 3.0, 30)
    errors = []
    for feed in (2e-4, 1e-4, 5e-5):
        chip = process.circle_chip(R, jnp.array([-feed, 0.0, 0.0]), phi, 0.0)
        errors.append(float(jnp.max(jnp.abs(chip / feed - jnp.sin(phi)))))
    assert errors[0] < 0.025
    # First order in f / R.
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2, rtol=0.05)


@pytest.mark.parametrize("teeth", [1, 2, 5])
def test_the_chip_is_that_of_trochoids(teeth):
    """Right to the third order of the feed: what is left falls by 16 for half of it."""
    phi = np.linspace(0.1, 3.0, 30)
    exact, two_circles, moved = [], [], []
    for feed in (2e-4, 1e-4, 5e-5):
        cut = TrochoidCut(np.zeros(6), feed, 1e-3, 600.0, R, teeth)
        exact.append(cut.chip(phi, np.array(R), [np.array(R)]))
        offset = jnp.array([-feed, 0.0, 0.0])
        chip = lambda turn, u=offset: process.circle_chip(
            R, u, jnp.asarray(phi), 0.0, turn
        )
        two_circles.append(chip(0.0))
        moved.append(chip(teeth / (2 * np.pi)))
    left = [np.abs(h - e).max() for h, e in zip(moved, exact, strict=True)]
    np.testing.assert_allclose(np.array(left[:-1]) / left[1:], 16, rtol=0.1)
    # What two circles alone leave is f N cos(phi) / (2 pi R) of the chip.
    off = two_circles[-1] - exact[-1]
    expected = 5e-5**2 * teeth * np.sin(phi) * np.cos(phi) / (2 * np.pi * R)
    np.testing.assert_allclose(off, expected, atol=0.05 * expected.max())


def test_a_missed_circle_is_what_it_is_told_to_be_and_has_no_gradient():
    far = jnp.array([0.0, 12e-3, 0.0])

    def chip(offset):
        return process.circle_chip(R, offset, jnp.array([np.pi / 2]), 1.25)[0]

    assert float(chip(far)) == 1.25
    np.testing.assert_array_equal(jax.grad(chip)(far), 0)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_chip_gradient_matches_differences(dtype):
    phi = jnp.linspace(0.2, 2.9, 7, dtype=dtype)
    offset = jnp.array([-0.2e-3, 0.05e-3, 0.0], dtype)

    def chips(offset):
        return process.circle_chip(jnp.asarray(R, dtype), offset, phi, 0.0)

    step = 1e-6 if dtype == jnp.float64 else 2e-5
    exact = jax.jacfwd(chips)(offset)
    for axis in (0, 1):
        shift = jnp.zeros(3, dtype).at[axis].set(step)
        difference = (chips(offset + shift) - chips(offset - shift)) / (2 * step)
        tolerance = 1e-7 if dtype == jnp.float64 else 2e-2
        np.testing.assert_allclose(exact[:, axis], difference, atol=tolerance)


def test_edge_contact_is_fair_at_both_ends_of_the_cut():
    feed, step = jnp.asarray(1e-4), 0.03
    phi = jnp.arange(-0.5, np.pi + 0.5, step / 20)
    touch = process.edge_contact(jnp.sin(phi), feed, step)
    np.testing.assert_allclose(jnp.sum(touch) * step / 20, np.pi, rtol=2e-4)
    still = process.edge_contact(jnp.zeros(5), jnp.zeros(()), step)
    np.testing.assert_array_equal(still, 0)


def test_edge_contact_sums_to_its_length_at_any_phase_of_the_samples():
    feed, step = jnp.asarray(1e-4), 0.03
    start = step * np.linspace(0, 1, 17)[:, None]
    phi = jnp.asarray(start + step * np.arange(-20, 20)[None])
    length = step * jnp.sum(process.edge_contact(phi, feed, step), axis=1)
    np.testing.assert_allclose(length, start[:, 0] + 19.5 * step, atol=1e-6 * step)


def test_the_law_is_linear_with_an_edge():
    law = cutting.LinearEdgeLaw(1e9, 5e8, 1e8, 10.0, 20.0, 30.0)
    F = law.force_per_width(
        jnp.array([0.0, 1e-4]), jnp.array([0.0, 1.0]), jnp.zeros(2, jnp.int32)
    )
    np.testing.assert_allclose(
        jnp.stack(F, -1), [[0, 0, 0], [1e5 + 10, 5e4 + 20, 1e4 + 30]]
    )
