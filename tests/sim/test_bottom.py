"""The ground-hollow end of a flat cutter, against the geometry of a cone."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from references import halfspaces, marching

from diffmill import RESULTS, cutter as ct, cutting, process as pr, sim, workpiece as wp

R, D, FEED, TEETH, STEPS = 3e-3, 0.25e-3, 0.1e-3, 2, 100
DISH = math.radians(2)
# Of the end.
ANNULI = 4
LAW = cutting.LinearEdgeLaw(
    K_tc=900e6, K_rc=300e6, K_ac=60e6, K_te=12e3, K_re=15e3, K_ae=0.0
)


def hollow(dish):
    return ct.flat_end_mill(2 * R, TEETH, dish_angle=dish)


MILL = hollow(DISH)
STOCK = wp.box([-4e-3, -5e-3, -6e-3], [14e-3, 5e-3, 0], D)


@functools.cache
def compiled(has_bottom=True, dish=DISH):
    mill = hollow(dish)
    plan = pr.choose_engagement(
        STOCK, mill, axial_depth=5e-3, plunges=True, has_bottom=has_bottom
    )

    @eqx.filter_jit
    def run(path):
        return sim.simulate_process(path, STOCK, mill, LAW, 837.0, engagement=plan)

    return run


def forces(path, has_bottom=True, dish=DISH):
    solution = compiled(has_bottom, dish)(path)
    assert bool(solution.result == RESULTS.successful)
    return np.asarray(solution.force)


def line(step, start=(0.0, 0.0, -1e-3)):
    return np.array(start) + np.arange(STEPS)[:, None] * np.array(step)


def of_the_end(path, dish=DISH):
    """Return the steady force of the end alone [N]."""
    with_end, without = (forces(path, has_bottom, dish) for has_bottom in (True, False))
    return (with_end - without)[-15:].mean(axis=0)


def test_a_plunge_cuts_with_the_whole_end():
    descent = 0.03e-3
    wanted = TEETH * R * (LAW.K_rc * descent + LAW.K_re)
    found = forces(line([0, 0, -descent], (1e-5, 1e-5, 0.5e-3)))
    assert found[-15:, 2] == pytest.approx(wanted, rel=1e-6)
    # The corner touches first; the center by R tan(dish) later.
    depth = -0.5e-3 + descent * np.arange(STEPS)
    part = (depth > 0.03e-3) & (depth < R * math.tan(DISH))
    assert np.all(np.diff(found[part, 2]) > 0)
    assert found[depth < 0, 2] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("pitch", [None, (2.0, 2.1, 2 * math.pi - 4.1)])
def test_a_plunge_of_three_teeth_pushes_along_the_axis_alone(pitch):
    # The side of the cutter moves along itself: it has no chip, and does not rub.
    descent, law = 0.1e-3, dataclasses.replace(LAW, K_ae=5e3)
    mill = ct.flat_end_mill(2 * R, 3, dish_angle=DISH, pitch=pitch)
    plan = pr.choose_engagement(STOCK, mill, axial_depth=5e-3, plunges=True)
    path = line([0, 0, -descent], (1e-5, 1e-5, 0.5e-3))[:50]
    run = lambda path: sim.simulate_process(
        path, STOCK, mill, law, 837.0, engagement=plan
    )
    found = np.asarray(eqx.filter_jit(run)(path).force)[-24:].reshape(-1, 3, 3).mean(1)
    wanted = 3 * R * (LAW.K_rc * descent + LAW.K_re)
    np.testing.assert_allclose(found[:, 2], wanted, rtol=2e-2)
    assert np.abs(found[:, :2]).max() < 2e-2 * wanted


@pytest.mark.parametrize("teeth", [2, 3])
def test_a_level_end_cuts_with_all_teeth_whatever_its_axis(teeth):
    # A tool that lies along x drills into the side of the block.
    feed, radius = 0.1e-3, 2e-3
    path = np.array([14.2e-3, 0.05e-3, -3e-3])
    path = path - np.outer(np.arange(12) * feed, [1, 0, 0])
    run = lambda path: sim.simulate_process(
        path,
        STOCK,
        ct.flat_end_mill(2 * radius, teeth),
        LAW,
        837.0,
        np.tile([1.0, 0, 0], (len(path), 1)),
        axial_depth=5e-3,
    )
    found = np.asarray(run(path).force)[-3:].mean(axis=0)
    wanted = teeth * radius * (LAW.K_rc * feed + LAW.K_re)
    np.testing.assert_allclose(found, [wanted, 0, 0], rtol=3e-2, atol=3e-2 * wanted)


def test_the_end_follows_the_diameter():
    plan = pr.choose_engagement(STOCK, MILL, axial_depth=5e-3, plunges=True)
    descent = 0.03e-3
    path = line([0, 0, -descent], (1e-5, 1e-5, 0.5e-3))

    def steady_force(diameter):
        wide = ct.flat_end_mill(
            diameter, TEETH, dish_angle=DISH, nominal_diameter=2 * R
        )
        run = sim.simulate_process(path, STOCK, wide, LAW, 837.0, engagement=plan)
        return run.force[-15:, 2].mean()

    diameter = jnp.asarray(2.2 * R)
    both = jax.jit(lambda D: jax.jvp(steady_force, (D,), (jnp.ones_like(D),)))
    found, slope = both(diameter)
    wanted = TEETH / 2 * (LAW.K_rc * descent + LAW.K_re)
    assert float(slope) == pytest.approx(wanted, rel=1e-6)
    assert float(found) == pytest.approx(wanted * float(diameter), rel=1e-6)


def test_a_level_end_that_descends_beside_the_work_feels_nothing():
    level = ct.flat_end_mill(2 * R, TEETH)
    plan = pr.choose_engagement(STOCK, level, axial_depth=5e-3, plunges=True)
    run = lambda path: sim.simulate_process(
        path, STOCK, level, LAW, 837.0, engagement=plan
    )
    path = line([0, 0, -1e-5], (-8e-3, 0.0, -1e-3))
    assert np.all(np.asarray(eqx.filter_jit(run)(path).force) == 0)


def test_a_level_cut_does_not_feel_the_end():
    path = line([FEED, 0, 0], (-7.1e-3, 0.3e-3, -1e-3))
    found, wanted = forces(path), forces(path, has_bottom=False)
    # The trailing corner only goes over the marks of the feed, FEED tan(DISH) high.
    assert np.abs(found - wanted).max() < 5e-3 * np.linalg.norm(wanted, axis=1).max()
    # Nor much while the tool shakes.
    sinking = path + np.outer(0.2e-6 * np.sin(np.arange(STEPS)), [0, 0, 1])
    end = forces(sinking) - forces(sinking, has_bottom=False)
    assert np.abs(end).max() < 2e-2 * np.linalg.norm(wanted, axis=1).max()


def test_waves_of_a_level_slot_are_as_smooth_as_its_slope_says():
    path = line([FEED, 0, 0], (0, 0, -1e-3))
    wave = np.outer(np.sin(np.arange(STEPS) / 7), [0, 0, 1.0])
    change = lambda s: (forces(path + s * wave) - forces(path - s * wave))[-60:, 2] / 2
    small, large = change(0.1e-6), change(10e-6)
    # 10 um are a hundred times as much; under a flat end some thousand times.
    assert np.abs(small).max() > 0.01
    assert np.abs(large).max() < 160 * np.abs(small).max()


def ramp_force(slope):
    """Return the mean axial force of the end in a ramp [N], by quadrature.

    At (r, theta) from the feed the corner passed a way s earlier. A place is cut where
    the tool has descended by more than the end is hollow since then, and the chip is
    what is left, or what the tooth before left if that is less.
    """
    r = (np.arange(400) + 0.5)[:, None] / 400 * R
    theta = (np.arange(720) + 0.5)[None] / 720 * 2 * math.pi
    s = np.sqrt(R**2 - (r * np.sin(theta)) ** 2) - r * np.cos(theta)
    rise = math.tan(DISH)
    left = slope * s - (R - r) * rise
    before = np.sqrt((r * np.cos(theta) + FEED) ** 2 + (r * np.sin(theta)) ** 2)
    h = np.minimum(left, slope * FEED + (r - before) * rise)
    h = np.where(before < R, np.maximum(h, 0), 0)
    return TEETH * R * (LAW.K_rc * h.mean() + LAW.K_re * (h > 0).mean())


@pytest.mark.parametrize("slope", [0.01, 0.02, 0.1])
def test_a_ramp_cuts_with_what_has_descended_below_its_corner(slope):
    found = of_the_end(line([FEED, 0, -slope * FEED], (0, 0, -0.5e-3)))
    assert found[2] == pytest.approx(ramp_force(slope), rel=2e-2)


def test_teeth_of_the_end_go_on_trochoids_in_a_ramp():
    # Two circles a period apart leave a chip as thick all round: no force in the plane.
    names = ("K_tc", "K_rc", "K_te", "K_re")
    K_tc, K_rc, K_te, K_re = (float(getattr(LAW, name)) for name in names)
    step = np.array([FEED, 0, -0.3 * FEED])
    found = of_the_end(line(step, (0, 0, -0.5e-3)), dish=0.0)
    wanted = marching.mean_force(
        marching.Tool(radius=R, length=5e-3, tooth_angles=marching.even_teeth(TEETH)),
        marching.LinearLaw(0, 0, 0),
        halfspaces.half_space(np.array([0, 0, 1.0]), 5e-3),
        step,
        np.array([0, 0, 1.0]),
        bottom_law=marching.LinearLaw(K_tc, K_rc, 0, K_te, K_re),
        elements=ANNULI,
        is_trochoidal=True,
    )
    assert wanted[0] > 2
    np.testing.assert_allclose(found[[0, 2]], wanted[[0, 2]], rtol=3e-2)


@pytest.mark.slow
def test_the_derivative_in_a_ramp_describes_the_force():
    path = jnp.asarray(line([FEED, 0, -0.02 * FEED], (0, 0, -0.5e-3)))
    wave = jnp.sin(jnp.arange(STEPS) / 7)[:, None] * jnp.array([[0.3, 0.2, 1.0]])
    end = lambda s: compiled()(path + s * wave).force[-40:, 2].sum()
    _, slope = jax.jvp(end, (jnp.zeros(()),), (jnp.ones(()),))
    step = 0.5e-6
    rise = (end(jnp.asarray(step)) - end(jnp.asarray(-step))) / (2 * step)
    assert float(slope) == pytest.approx(float(rise), rel=5e-2)
