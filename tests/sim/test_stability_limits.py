"""Stability at default settings against published limits of fast modes."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from references import semidiscretisation
from spindle_cut import (
    DIAMETER,
    DOWN,
    FEED,
    FREQUENCY,
    K_R,
    K_T,
    MASS,
    PUBLISHED,
    RATIO,
    SLOT,
    UP,
    modes,
    reference,
    spindle,
    straight_cut,
)

from diffmill import (
    cutting,
    process as pr,
    robot as rb,
    sim,
)


def modal_growth(rpm, axes, arc, depth, **cutter):
    """Return what the library says of the spindle's modes in a straight cut."""
    tips = np.zeros((61, 3))
    tips[:, 0], tips[:, 2] = 1e-3 + FEED * np.arange(61), -depth
    machine, tips = sim.ModalMachine(modes(axes)), jnp.asarray(tips)
    process = straight_cut(rpm, arc, **cutter)
    return sim.Stability.along(machine, process, tips, tips, [60])


def growth(rpm, robot, arc, depth):
    """Return what the library says of a robot in a straight cut."""
    path = np.zeros((61, robot.joint_count))
    path[:, 0] = 1e-3 + FEED * np.arange(61)
    frame = np.eye(4)
    frame[:3, 3] = rb.forward_kinematics(robot, np.zeros(robot.joint_count))[:3, 3]
    frame[2, 3] += depth
    return sim.Stability.along(
        sim.ElasticArm(robot, frame),
        straight_cut(rpm, arc),
        jnp.asarray(path),
        jnp.asarray(path),
        [60],
    )


@pytest.mark.parametrize(
    ("rpm", "axes", "arc", "limit"),
    [PUBLISHED[0], *(pytest.param(*c, marks=pytest.mark.slow) for c in PUBLISHED[1:])],
)
def test_published_limits_at_default_settings(rpm, axes, arc, limit):
    below, above = (
        growth(rpm, spindle(axes), arc, share * limit) for share in (0.97, 1.03)
    )
    assert not below.is_unstable[0] and above.is_unstable[0]
    assert 0.9 * FREQUENCY < above.frequency[0] < 1.6 * FREQUENCY
    assert above.fastest_mode == pytest.approx(FREQUENCY, rel=1e-3)


@pytest.mark.parametrize(
    ("rpm", "axes", "arc", "limit"),
    [PUBLISHED[0], *(pytest.param(*c, marks=pytest.mark.slow) for c in PUBLISHED[1:])],
)
def test_modes_at_the_tip_have_the_published_limits(rpm, axes, arc, limit):
    below, above = (
        modal_growth(rpm, axes, arc, share * limit) for share in (0.97, 1.03)
    )
    assert not below.is_unstable[0] and above.is_unstable[0]
    assert 0.9 * FREQUENCY < above.frequency[0] < 1.6 * FREQUENCY


# Speed [rpm], pitch [deg], axes, arc, depth [m]: uneven teeth calm, or excite.
UNEVEN = [
    (5000, (170, 190), (0,), SLOT, 0.6e-3),
    (6500, (160, 200), (0,), SLOT, 0.6e-3),
    (8000, (165, 195), (0, 1), DOWN, 0.6e-3),
]


@pytest.mark.parametrize(
    ("rpm", "pitch", "axes", "arc", "depth"),
    [UNEVEN[0], *(pytest.param(*c, marks=pytest.mark.slow) for c in UNEVEN[1:])],
)
def test_uneven_teeth_calm_as_another_method_says(rpm, pitch, axes, arc, depth):
    cut = reference(rpm, axes, arc, pitch=tuple(np.radians(pitch)))
    wanted = semidiscretisation.growth(cut, depth, 100)
    even = semidiscretisation.growth(dataclasses.replace(cut, pitch=None), depth, 100)
    assert abs(np.log(wanted / even)) > 0.1
    found = modal_growth(rpm, axes, arc, depth, pitch=pitch)
    assert np.log(found.radius[0]) == pytest.approx(np.log(wanted), rel=0.05, abs=0.03)
    assert found.frequency[0] == pytest.approx(FREQUENCY, rel=0.05)


def test_a_tooth_that_stands_back_by_more_than_the_feed_is_none():
    """The other one is alone then, and cuts what it left a turn before."""
    depth = 0.5e-3
    alone = semidiscretisation.Cut(5000 / 60, 1, K_T, K_R, MASS, FREQUENCY, RATIO)
    wanted = semidiscretisation.growth(alone, depth, 200) ** 0.5
    found = modal_growth(5000, (0,), SLOT, depth, runout=0.75 * FEED)
    assert np.log(found.radius[0]) == pytest.approx(np.log(wanted), rel=0.05, abs=0.01)
    both = modal_growth(5000, (0,), SLOT, depth)
    assert abs(np.log(both.radius[0] / wanted)) > 0.1


def test_teeth_of_other_coefficients_are_judged_by_the_turn():
    """Not by the tooth that a row meets."""
    process = straight_cut(5000, SLOT)
    law = cutting.LinearEdgeLaw(
        K_tc=K_T * np.array([1.5, 0.5]),
        K_rc=K_R * np.array([1.5, 0.5]),
        K_ac=0.0,
        K_te=0,
        K_re=0,
        K_ae=0,
    )
    assert process.repeats_after == 1
    process = eqx.tree_at(lambda p: p.side_law, process, law)
    assert process.repeats_after == 2
    tips = np.zeros((61, 3))
    tips[:, 0], tips[:, 2] = 1e-3 + FEED * np.arange(61), -0.5e-3
    machine, tips = sim.ModalMachine(modes((0,))), jnp.asarray(tips)
    found = sim.Stability.along(machine, process, tips, tips, [59, 60])
    even = modal_growth(5000, (0,), SLOT, 0.5e-3).radius
    np.testing.assert_allclose(np.log(found.radius), np.log(even[0]), atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pitch", "is_calm"), [((180, 180), False), ((170, 190), True)]
)
def test_a_simulated_vibration_grows_by_the_factor_of_the_stability(pitch, is_calm):
    depth, steps, count = 0.6e-3, 120, 34
    process = straight_cut(5000, SLOT, pitch=pitch)
    plan = pr.choose_engagement(
        process.stock,
        process.cutter,
        axial_depth=1.3e-3,
        angles=2 * steps,
        substeps=steps,
    )
    process = eqx.tree_at(lambda p: p.engagement, process, plan)
    machine, tips = sim.ModalMachine(modes((0,))), np.zeros((count, 3))
    tips[:, 0], tips[:, 2] = 3e-3 + FEED * np.arange(count), -depth
    ends = jax.jit(lambda path: machine.run(process, path).ends)
    kicked, kick = tips.copy(), 1e-8
    kicked[20:, 0] += kick
    swing = np.asarray(ends(jnp.asarray(kicked)) - ends(jnp.asarray(tips)))[..., 0]
    size = np.abs(swing - kick)[22:].max(axis=1)
    found = np.log(size[-1] / size[0]) / (len(size) - 1)
    wanted = modal_growth(5000, (0,), SLOT, depth, pitch=pitch).radius[0]
    assert found == pytest.approx(np.log(wanted), rel=0.15)
    assert (found < 0) == is_calm


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rpm", "axes", "arc"),
    [(5000, (0,), UP), (8000, (0, 1), UP), (8000, (0, 1), DOWN), (6000, (0,), DOWN)],
)
def test_modes_at_the_tip_have_the_limits_of_another_method(rpm, axes, arc):
    cut = reference(rpm, axes, arc)
    rough = limit_of(cut, 0.02e-3, first_unstable(cut), 100)
    limit = limit_of(cut, 0.9 * rough, 1.05 * rough, 300)
    below, above = (
        modal_growth(rpm, axes, arc, share * limit) for share in (0.97, 1.03)
    )
    assert not below.is_unstable[0] and above.is_unstable[0]


def first_unstable(cut):
    """Return the least of some depths at which a cut is unstable [m]."""
    depths = np.arange(0.05e-3, 3e-3, 0.05e-3)
    return next(d for d in depths if semidiscretisation.growth(cut, d, 100) > 1)


def limit_of(cut, stable, unstable, steps):
    """Return the depth between two at which vibrations begin to grow [m]."""
    while unstable - stable > 1e-3 * stable:
        middle = (stable + unstable) / 2
        if semidiscretisation.growth(cut, middle, steps) > 1:
            unstable = middle
        else:
            stable = middle
    return stable


@pytest.mark.slow
@pytest.mark.parametrize(("rpm", "axes", "arc", "limit"), PUBLISHED[:3])
def test_growth_is_that_of_another_method(rpm, axes, arc, limit):
    cut = reference(rpm, axes, arc)
    for share in (0.6, 1.4):
        wanted = semidiscretisation.growth(cut, share * limit)
        found = growth(rpm, spindle(axes), arc, share * limit).radius[0]
        assert np.log(found) == pytest.approx(np.log(wanted), rel=0.1, abs=0.02)


@pytest.mark.slow
def test_a_bending_tool_chatters_at_default_settings():
    slide = rb.PrismaticJoint("slide", (1, 0, 0), stiffness=1e10, damping=1e6)
    body = rb.RigidBody(1e3, (0, 0, 0), np.eye(3))
    tool = rb.BendingTool(50e-3, 0.0, DIAMETER, DIAMETER, damping_ratio=RATIO)
    robot = tool.mounted_on(rb.build([slide, body, rb.Tool("tool")]))
    frequency = float(rb.natural_frequencies(robot, np.zeros(3))[2])
    soft = float(rb.cartesian_compliance(robot, np.zeros(3))[1, 1])
    mass = 1 / (soft * (2 * math.pi * frequency) ** 2)
    cut = semidiscretisation.Cut(
        8000 / 60, 2, K_T, K_R, mass, frequency, RATIO, (0, 1), *SLOT
    )
    for depth in (0.1e-3, 0.4e-3):
        found = growth(8000, robot, SLOT, depth)
        wanted = semidiscretisation.growth(cut, depth, 300)
        assert found.radius[0] == pytest.approx(wanted, rel=0.01)
    assert found.is_unstable[0]  # pyright: ignore[reportPossiblyUnbound]
    # Eight sub-steps cannot follow a mode that turns eleven times in a period.
    assert "[simulation] substeps = 88" in found.visibility()  # pyright: ignore[reportPossiblyUnbound]
