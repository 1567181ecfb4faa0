"""Joints that follow another: against the same arm with every joint of its own."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

# Followers before and behind what they follow, sliding ones after turning ones, a
# chain, and a branch that does not carry the tool.
FOLLOWED = {
    "first": dr.Mimic("turn", -0.5, 0.3),
    "slide": dr.Mimic("first", 0.4, -0.1),
    "side": dr.Mimic("lift", 2.0),
}
# q of all joints = G q + offset; rows: first, turn, side, lift, slide.
G = np.array([[-0.5, 0], [1, 0], [0, 2], [0, 1], [-0.2, 0]])
OFFSET = np.array([0.3, 0.0, 0.0, 0.0, 0.02])


def arm(mimics):
    """Return an arm whose joints follow as `mimics` says."""
    rng = np.random.default_rng(3)

    def body():
        root = rng.normal(size=(3, 3)) * 0.2
        return dr.RigidBody(2.0, rng.normal(size=3) * 0.2, root @ root.T + np.eye(3))

    def joint(kind, name, axis):
        return kind(name, axis, stiffness=50.0, damping=1.0, mimic=mimics.get(name))

    return dr.build(
        [
            joint(dr.RevoluteJoint, "first", (0, 1, 1)),
            body(),
            dr.FixedTranslation((0.3, 0.1, 0.4)),
            joint(dr.RevoluteJoint, "turn", (1, 0, 0)),
            body(),
            dr.FixedRotation(dr.rpy_matrix(0.3, -0.2, 0.5)),
            dr.Fork([[joint(dr.RevoluteJoint, "side", (0, 1, 0)), body()]]),
            joint(dr.RevoluteJoint, "lift", (0, 1, 0)),
            body(),
            dr.FixedTranslation((0.2, 0.0, 0.1)),
            joint(dr.PrismaticJoint, "slide", (1, 2, 0)),
            body(),
            dr.Tool(position=(0.1, 0.2, 0.3)),
        ]
    )


@pytest.fixture(scope="module")
def follower():
    return arm(FOLLOWED)


@pytest.fixture(scope="module")
def free():
    return arm({})


def test_only_independent_joints_are_counted(follower, free):
    assert follower.joint_names == ("turn", "lift")
    assert follower.joint_kinds == ("revolute", "revolute")
    assert (follower.joint_count, follower.body_count) == (2, 5)
    assert follower.has_mimics and not free.has_mimics
    assert free.joint_kinds == ("revolute",) * 4 + ("prismatic",)
    assert follower.joint_stiffness.shape == follower.home.shape == (2,)
    with pytest.raises(ValueError, match=r"turn, lift: 2\).*\(5,\)"):
        dr.forward_kinematics(follower, np.zeros(5))


@jax.jit
def all_quantities(robot, q, qd, qdd, wrench):
    """Return all in one program, which compiles faster than many."""
    terms = dr.ArmTerms.of_state(robot, q, qd)
    tau = dr.inverse_dynamics(robot, q, qd, qdd, wrench)
    return {
        "T": terms.T_base_tool,
        "J": terms.jacobian,
        "M": terms.mass_matrix,
        "bias": terms.bias_forces,
        "G": dr.gravity_forces(robot, q),
        "tau": tau,
        "qdd": dr.forward_dynamics(robot, q, qd, tau, wrench),
    }


def test_all_quantities_fold(follower, free, rng):
    q, qd, qdd = rng.normal(size=(3, 2))
    wrench = rng.normal(size=6)
    found = all_quantities(follower, q, qd, qdd, wrench)
    full = all_quantities(free, G @ q + OFFSET, G @ qd, G @ qdd, wrench)
    close = lambda a, b: assert_allclose(a, b, rtol=1e-12, atol=1e-12)
    close(found["T"], full["T"])
    close(found["J"], full["J"] @ G)
    close(found["M"], G.T @ full["M"] @ G)
    for torques in ("bias", "G", "tau"):
        close(found[torques], G.T @ full[torques])
    close(found["qdd"], qdd)


def test_jacobian_is_the_derivative_of_the_position(follower, difference):
    at = lambda q: all_quantities(follower, q, *np.zeros((2, 2)), np.zeros(6))
    q = np.array([0.4, -0.7])
    by_difference = difference(lambda q: at(q)["T"][:3, 3], q, 1e-6)
    assert_allclose(at(q)["J"][:3], by_difference, atol=1e-9)


def test_statics_and_single_precision(follower):
    at = lambda robot, q: all_quantities(robot, q, *np.zeros((2, 2)), np.zeros(6))
    theta = np.array([0.2, 0.1])
    q = dr.loaded_equilibrium(follower, theta)
    # Two Newton steps on a soft arm: the equilibrium of the folded torques.
    assert_allclose(50.0 * (theta - q), at(follower, np.asarray(q))["G"], atol=1e-3)
    single = jax.tree.map(lambda x: x.astype(jnp.float32), follower)
    found = dr.mass_matrix(single, theta)
    assert found.dtype == jnp.float32
    assert_allclose(found, at(follower, theta)["M"], rtol=1e-5)


@pytest.mark.parametrize(
    ("mimics", "message"),
    [
        ({"slide": dr.Mimic("none")}, "'slide' mimics 'none', which is no moving"),
        ({"slide": dr.Mimic("slide")}, "'slide' mimics itself"),
        (
            {"slide": dr.Mimic("side"), "side": dr.Mimic("slide")},
            "'side' mimics itself by 'side'",
        ),
    ],
)
def test_what_cannot_be_followed_is_refused(mimics, message):
    with pytest.raises(ValueError, match=message):
        arm(mimics)


def test_a_follower_of_a_cycle_is_refused():
    mimics = {
        "lift": dr.Mimic("slide"),
        "slide": dr.Mimic("side"),
        "side": dr.Mimic("slide"),
    }
    with pytest.raises(ValueError):
        arm(mimics)


def test_a_multiplier_must_be_a_number():
    with pytest.raises(ValueError):
        dr.Mimic("turn", np.nan)
    assert dataclasses.astuple(dr.Mimic("turn")) == ("turn", 1.0, 0.0)
