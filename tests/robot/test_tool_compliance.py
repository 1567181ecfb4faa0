"""Bending tools and springs at the flange, against beams and levers."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

E, DENSITY, L, D = 600e9, 14.5e3, 60e-3, 10e-3
PLAIN = dr.BendingTool(L, 0.0, D, D)
STEPPED = dr.BendingTool(L, 25e-3, D, 12e-3)
AREA, SECOND_MOMENT = math.pi * D**2 / 4, math.pi * D**4 / 64
SPINDLE = dr.FlangeSpring(
    mass=30.0,
    center_of_mass=(0.0, 0.0, 0.17),
    inertia=(0.75, 0.75, 0.2),
    linear_stiffness=(4e7, 5e7, 6e7),
    rotary_stiffness=(2e6, 3e6, 4e6),
)


@pytest.fixture(scope="module")
def bending(arm):
    return PLAIN.mounted_on(arm)


@pytest.fixture(scope="module")
def sprung(arm):
    return SPINDLE.mounted_on(arm)


def padded(robot, q):
    return np.concatenate([q, np.zeros(robot.joint_count - len(q))])


def compliance(robot, arm):
    """Return the tip's compliance in the tool's own axes."""
    R = np.kron(np.eye(2), np.asarray(dr.forward_kinematics(arm, arm.home))[:3, :3])
    C = dr.cartesian_compliance(robot, padded(robot, arm.home))
    return R.T @ np.asarray(C) @ R


def test_a_beam_in_series_with_the_arm(arm, bending):
    more = compliance(bending, arm) - compliance(arm, arm)
    shift, turn = L**3 / (3 * E * SECOND_MOMENT), L**2 / (2 * E * SECOND_MOMENT)
    assert_allclose(np.diag(more)[:3], [shift, shift, 0.0], rtol=1e-9, atol=1e-15)
    # A force along x turns the tip about y, one along y about -x; up is +z.
    assert_allclose(abs(more[4, 0]), turn, rtol=1e-9)
    assert_allclose(abs(more[3, 1]), turn, rtol=1e-9)
    # The tool is longer than the hinge is high: the tip leans the way it moves.
    assert more[4, 0] < 0 < more[3, 1]


def test_frequency_of_a_plain_cantilever():
    # On a mass that stays: the first mode of a beam has cos b cosh b = -1.
    anchor = dr.build(
        [
            dr.PrismaticJoint("anchor", (1, 0, 0), stiffness=1e15),
            dr.RigidBody(1e3, (0, 0, 0), np.eye(3)),
        ]
    )
    robot = PLAIN.mounted_on(anchor)
    found = np.asarray(dr.natural_frequencies(robot, np.zeros(3)))[:2]
    b = 1.875104068711961
    assert abs(math.cos(b) * math.cosh(b) + 1) < 1e-12
    omega = b**2 * math.sqrt(E * SECOND_MOMENT / (DENSITY * AREA * L**4))
    assert_allclose(found, omega / (2 * math.pi), rtol=2e-2)
    # Rayleigh's quotient of the static shape is an upper bound.
    assert np.all(found > omega / (2 * math.pi))
    mass = PLAIN.tip_spring().mass
    assert_allclose(mass, 33 / 140 * DENSITY * AREA * L, rtol=1e-12)
    assert_allclose(
        dr.mode_shapes(robot, np.zeros(3)).damping_ratios[:2], 0.02, rtol=1e-6
    )


def test_a_stepped_beam_by_plain_integration():
    x = np.linspace(0, L, 200_001)
    fluted = x > L - 25e-3
    d = np.where(fluted, 0.8 * D, 12e-3)
    curvature = (L - x) / (E * math.pi * d**4 / 64)
    step = x[1] - x[0]
    integral = lambda y: np.concatenate([[0], np.cumsum((y[1:] + y[:-1]) / 2)]) * step
    slope = integral(curvature)
    w = integral(slope)
    found = STEPPED.tip_spring()
    assert_allclose(1 / found.stiffness, w[-1], rtol=1e-4)
    assert_allclose(found.hinge_height, w[-1] / slope[-1], rtol=1e-4)
    moving = DENSITY * math.pi / 4 * integral((d * w / w[-1]) ** 2)[-1]
    assert_allclose(found.mass, moving, rtol=1e-4)


def test_slope_of_the_compliance_in_the_overhang(arm):
    def tip(overhang):
        tool = dr.BendingTool(overhang, 0.0, D, D)
        robot = tool.mounted_on(arm)
        q = jnp.concatenate([arm.home, jnp.zeros(2)])
        return jnp.trace(dr.cartesian_compliance(robot, q)[:3, :3])

    slope = jax.jit(jax.grad(tip))(L)
    assert_allclose(slope, 2 * L**2 / (E * SECOND_MOMENT), rtol=1e-9)


def test_springs_at_the_flange_act_on_their_levers(arm, sprung):
    more = compliance(sprung, arm) - compliance(arm, arm)
    k, kr = SPINDLE.linear_stiffness, SPINDLE.rotary_stiffness
    assert k is not None and kr is not None
    lever = 0.45
    # The tool's x is the flange's x, its y and z are opposite.
    wanted = [1 / k[0] + lever**2 / kr[1], 1 / k[1] + lever**2 / kr[0], 1 / k[2]]
    wanted += [1 / kr[0], 1 / kr[1], 1 / kr[2]]
    assert_allclose(np.diag(more), np.asarray(wanted, float), rtol=1e-9)


def test_a_spring_that_turns_nothing_has_derivatives(arm):
    def dampers(factor):
        spindle = dr.FlangeSpring(
            10.0,
            (0.0, 0.0, 0.1),
            (0.1, 0.1, 0.0),
            rotary_stiffness=tuple(factor * 1e6),
            is_in_link=False,
        )
        return spindle.mounted_on(arm).joint_damping[-3:]

    at = jnp.ones(3)
    slope = jax.jacfwd(dampers)(at)
    # A root of the stiffness: half of the damper; none about the spindle's own axis.
    assert_allclose(slope, np.diag(dampers(at) / 2), rtol=1e-12)
    assert dampers(at)[0] > 0 and dampers(at)[2] == 0


def test_the_spindle_moves_behind_the_springs_and_is_not_counted_twice(arm, sprung):
    q = np.linspace(0.1, 0.6, 6)
    M = np.asarray(dr.mass_matrix(sprung, padded(sprung, q)))
    scale = np.abs(M).max()
    assert_allclose(M[:6, :6], dr.mass_matrix(arm, q), atol=1e-9 * scale)
    assert_allclose(np.diag(M)[6:9], 30.0)
    G = dr.gravity_forces(sprung, padded(sprung, q))
    assert_allclose(G[:6], dr.gravity_forces(arm, q), atol=1e-9 * scale)
    # A pure force at the spindle's centre of mass: its weight.
    assert_allclose(np.linalg.norm(G[6:9]), 30.0 * 9.81)


@pytest.mark.slow
def test_with_both_the_tool_reaches_its_poses(arm):
    linear = dataclasses.replace(SPINDLE, rotary_stiffness=None)
    robot = STEPPED.mounted_on(linear.mounted_on(arm))
    assert robot.joint_names[6:] == (
        *("flange_x", "flange_y", "flange_z"),
        *("tool_x", "tool_y"),
    )
    T = dr.forward_kinematics(arm, arm.home)
    assert_allclose(dr.forward_kinematics(robot, robot.home), T, atol=1e-12)
    start = padded(robot, arm.home + 0.05)
    found = dr.inverse_kinematics(robot, T, start)
    assert bool(found.converged)
    assert_allclose(found.q, robot.home, atol=1e-9)
    theta = dr.motor_positions(robot, robot.home)
    assert_allclose(theta[6:], 0.0)
    # The springs without a motor keep their sag; a force adds compliance times force.
    F = np.array([100.0, -50.0, 30.0, 0.0, 0.0, 0.0])
    rest = dr.loaded_equilibrium(robot, theta)
    pushed = dr.loaded_equilibrium(robot, theta, F)
    moved = (dr.forward_kinematics(robot, pushed) - dr.forward_kinematics(robot, rest))[
        :3, 3
    ]
    C = dr.cartesian_compliance(robot, rest)[:3, :3]
    assert_allclose(moved, C @ F[:3], rtol=5e-3)
    assert np.all(np.abs(np.asarray(rest)[6:]) < 1e-3)


def test_what_is_refused(arm, sprung, bending):
    for again in (
        lambda: SPINDLE.mounted_on(sprung),
        lambda: PLAIN.mounted_on(bending),
    ):
        with pytest.raises(ValueError):
            again()
    with pytest.raises(ValueError):
        dr.FlangeSpring(1.0, (0, 0, 0), (1, 1, 1))
    heavy = dr.FlangeSpring(99.0, (0, 0, 0.1), (1, 1, 1), rotary_stiffness=(1, 1, 1))
    with pytest.raises(ValueError, match=r"`mass`.* 36\.6 kg"):
        heavy.mounted_on(arm)
    # All of the link, but not where that is.
    mass, at = float(arm.link_masses[-1]), (0.0, 0.5, 0.17)
    whole = dr.FlangeSpring(mass, at, (1, 1, 1), rotary_stiffness=(1, 1, 1))
    with pytest.raises(ValueError, match="`center_of_mass`"):
        whole.mounted_on(arm)
    big = dr.FlangeSpring(30.0, (0, 0, 0.1), (9, 9, 9), rotary_stiffness=(1, 1, 1))
    with pytest.raises(ValueError):
        big.mounted_on(arm)
    with pytest.raises(ValueError, match="`overhang`"):
        dr.BendingTool(0.0, 0.0, D, D)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass", -1.0),
        ("mass", np.inf),
        ("center_of_mass", (0.0, 0.1)),
        ("inertia", (0.1, -0.1, 0.1)),
        ("linear_stiffness", (1e7, 0.0, 1e7)),
        ("rotary_stiffness", np.full((3, 1), 1e6)),
        ("rotary_stiffness", (1e6, np.nan, 1e6)),
        ("damping_ratio", -0.02),
    ],
)
def test_a_spring_of_impossible_numbers_is_refused(name, value, monkeypatch):
    # As users run it, without types looked at.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    usual = {
        "mass": 30.0,
        "center_of_mass": (0.0, 0.0, 0.1),
        "inertia": (0.1, 0.1, 0.1),
        "linear_stiffness": (1e7, 1e7, 1e7),
    }
    dr.FlangeSpring(**usual)
    with pytest.raises(ValueError, match=f"`{name}` must"):
        dr.FlangeSpring(**usual | {name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("overhang", np.inf),
        ("cutter_diameter", jnp.asarray(-0.01)),
        ("young_modulus", np.nan),
        ("flute_length", -0.01),
        ("damping_ratio", [0.02, 0.02]),
    ],
)
def test_a_tool_that_is_no_beam_is_refused(name, value, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    usual = dict(
        zip(
            ("overhang", "flute_length", "cutter_diameter", "shank_diameter"),
            (0.04, 0.02, 0.01, 0.01),
            strict=True,
        )
    )
    dr.BendingTool(**usual)
    with pytest.raises(ValueError, match=f"`{name}` must"):
        dr.BendingTool(**usual | {name: value})
