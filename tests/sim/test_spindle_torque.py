"""Torque of the spindle: in closed form, and as power over the removal rate."""

import math

import jax
import numpy as np
import pytest

import diffmill as dm
from diffmill import cutter as ct, cutting, workpiece as wp

SPEED = 8000 * math.pi / 30
R, TEETH, FEED, DEPTH = 5e-3, 2, 0.1e-3, 1e-3
K_TC, K_TE = 900e6, 12e3


def rows(start, feed, count=100):
    """Tips, one for each tooth."""
    return np.asarray(start) + np.arange(count)[:, None] * np.asarray(feed)


def steady(run):
    """Mean torque of the spindle where the cut is steady [N m]."""
    return np.asarray(run.spindle_torque)[-20:].mean()


@pytest.mark.parametrize("chip", ["near_far", "point_cloud"])
def test_the_torque_of_a_slot_in_closed_form(chip):
    law = cutting.LinearEdgeLaw(K_tc=K_TC, K_rc=300e6, K_ac=60e6, K_te=K_TE, K_re=14e3)
    run = dm.sim.simulate_process(
        rows([-2e-3, 6e-3, -DEPTH], [FEED, 0, 0], 60),
        wp.box([0, 0, -2e-3], [12e-3, 12e-3, 0], 0.25e-3, interval_counts=(4, 4, 1)),
        ct.flat_end_mill(diameter=2 * R, teeth=TEETH),
        law,
        SPEED,
        angles=360,
        axial_depth=DEPTH,
        chip=chip,
    )
    # The chip is f_z sin(phi) from 0 to pi.
    mean = TEETH * R * DEPTH / (2 * math.pi) * (2 * K_TC * FEED + math.pi * K_TE)
    assert steady(run) == pytest.approx(mean, rel=0.02)
    assert np.asarray(run.spindle_torque)[0] == 0


@pytest.mark.parametrize(
    ("cutter", "feed"),
    [
        (ct.flat_end_mill(diameter=2 * R, teeth=TEETH), [0, 0, -0.01e-3]),
        (ct.ball_end_mill(diameter=2 * R, teeth=TEETH), [FEED, 0, 0]),
        (
            ct.bull_nose(diameter=2 * R, corner_radius=1e-3, teeth=TEETH),
            [FEED, 0, 0],
        ),
    ],
)
def test_without_edge_forces_the_power_is_that_of_the_chips(cutter, feed):
    law = cutting.LinearEdgeLaw(K_tc=K_TC, K_rc=0.0, K_ac=0.0)
    start = [-2e-3, 8e-3, -2e-3] if feed[0] else [8e-3, 8e-3, -0.1e-3]
    run = dm.sim.simulate_process(
        rows(start, feed),
        wp.box([0, 0, -4e-3], [16e-3, 16e-3, 0], 0.25e-3, interval_counts=(4, 4, 2)),
        cutter,
        law,
        SPEED,
        angles=360,
        bottom_law=law,
    )
    tooth_period = 2 * math.pi / (SPEED * TEETH)
    area = math.pi * R**2
    if feed[0]:
        a = 2e-3
        r = cutter.corner_radius
        low = min(a, float(r))
        # Across the way: the corner's segment, the flat end, and what is above both.
        half = lambda z: R - r + np.sqrt(max(r**2 - (r - z) ** 2, 0.0))
        z = (np.arange(2000) + 0.5) / 2000 * a
        area = a * np.mean([2 * (half(x) if x < low else R) for x in z])
    rate = area * np.linalg.norm(feed) / tooth_period
    assert steady(run) * SPEED == pytest.approx(K_TC * rate, rel=0.03)


def test_the_torque_has_no_derivative():
    stock = wp.box([0, 0, -2e-3], [8e-3, 6e-3, 0], 0.5e-3, interval_counts=(4, 4, 2))
    tips = rows([-4.5e-3, 3e-3, -DEPTH], [FEED, 0, 0], 20)

    def torque(K_tc):
        law = cutting.LinearEdgeLaw(K_tc=K_tc, K_rc=300e6, K_ac=60e6)
        cutter = ct.flat_end_mill(diameter=2 * R, teeth=TEETH)
        run = dm.sim.simulate_process(
            tips, stock, cutter, law, SPEED, angles=96, axial_depth=DEPTH
        )
        return run.spindle_torque[-1]

    value, slope = jax.jit(jax.value_and_grad(torque))(K_TC)
    assert value > 0 and slope == 0
