import jax.numpy as jnp
import numpy as np
import pytest
from vibrations import ring_down

from diffmill import identification, robot as rb


def test_two_modes_of_a_ring_down():
    t = np.arange(2000) / 1000
    f, zeta = np.array([9.0, 14.0]), np.array([0.03, 0.015])
    y = ring_down(t, list(zip(f, zeta, (1.0, 0.6), strict=True)), (0.3, 1.0))
    y = y + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    fit = identification.fit_ring_down(t, y, [13.0, 9.5])
    assert (np.abs(fit.frequencies - f) < 4 * fit.frequency_errors).all()
    assert (np.abs(fit.damping_ratios - zeta) < 4 * fit.damping_errors).all()
    assert (fit.damping_errors < 0.02 * zeta).all() and fit.explained > 0.99


def test_dampers_from_the_damping_of_modes():
    robot = rb.load("kuka_kr210_like")
    draw = np.random.default_rng(0)
    q = np.asarray(robot.home)[None] + draw.uniform(-0.5, 0.5, (6, 6))
    ratios = np.stack(
        [rb.mode_shapes(robot, jnp.asarray(row)).damping_ratios for row in q]
    )
    fit = identification.fit_joint_damping(robot, q, ratios)
    assert fit.identifiable.all()
    np.testing.assert_allclose(fit.damping, robot.joint_damping, rtol=1e-6)
    # The lowest modes alone do not bend the wrist.
    noisy = ratios[:, :3] * (1 + 0.05 * draw.normal(size=(6, 3)))
    fit = identification.fit_joint_damping(robot, q, noisy)
    assert fit.identifiable[:1].all() and not fit.identifiable[5]


def test_shapes_are_checked():
    with pytest.raises(ValueError):
        identification.fit_ring_down(np.arange(4.0), np.zeros(4), [1.0])
    robot = rb.load("kuka_kr210_like")
    with pytest.raises(ValueError, match="`damping_ratios`"):
        identification.fit_joint_damping(robot, np.zeros((2, 6)), np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("value", "fault"),
    [(0.0, "must vary"), (3.0, "must vary"), (np.nan, "finite"), (np.inf, "finite")],
)
@pytest.mark.parametrize("guess", [None, np.array([9.0])])
def test_a_dead_channel_is_no_ring_down(guess, value, fault):
    t = np.arange(400) / 1000
    y = np.full(400, value) if np.isfinite(value) else np.sin(60 * t)
    y[7] = value
    ring = identification.RingDown("ring.csv", t, y, 1, guess, None, ())
    with pytest.raises(ValueError, match=f"Argument `signal` .*{fault}"):
        ring.fit()


def test_a_guess_of_no_frequency_is_refused():
    t = np.arange(400) / 1000
    with pytest.raises(ValueError, match="Argument `frequencies`"):
        identification.fit_ring_down(t, np.sin(60 * t), [9.0, 0.0])
