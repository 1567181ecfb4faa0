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
    with pytest.raises(ValueError, match=r"turn, lift: 2\), but has shape \(5,\)"):
        dr.forward_kinematics(follower, np.zeros(5))


def test_all_quantities_fold(follower, free, rng):
    q, qd, qdd = rng.normal(size=(3, 2))
    wrench = rng.normal(size=6)
    all_q, all_qd, all_qdd = G @ q + OFFSET, G @ qd, G @ qdd
    close = lambda a, b: assert_allclose(a, b, rtol=1e-12, atol=1e-12)
    close(dr.forward_kinematics(follower, q), dr.forward_kinematics(free, all_q))
    close(dr.jacobian(follower, q), dr.jacobian(free, all_q) @ G)
    close(dr.mass_matrix(follower, q), G.T @ dr.mass_matrix(free, all_q) @ G)
    close(dr.gravity_forces(follower, q), G.T @ dr.gravity_forces(free, all_q))
    close(dr.bias_forces(follower, q, qd), G.T @ dr.bias_forces(free, all_q, all_qd))
    tau = dr.inverse_dynamics(follower, q, qd, qdd, wrench)
    close(tau, G.T @ dr.inverse_dynamics(free, all_q, all_qd, all_qdd, wrench))
    close(dr.forward_dynamics(follower, q, qd, tau, wrench), qdd)
    terms = dr.arm_terms(follower, q, qd)
    close(terms.mass_matrix, dr.mass_matrix(follower, q))


def test_jacobian_is_the_derivative_of_the_position(follower, difference):
    q = np.array([0.4, -0.7])
    position = lambda q: dr.forward_kinematics(follower, q)[:3, 3]
    by_difference = difference(position, q, 1e-6)
    assert_allclose(dr.jacobian(follower, q)[:3], by_difference, atol=1e-9)
    by_mode = jax.jacrev(position)(jnp.asarray(q))
    assert_allclose(dr.jacobian(follower, q)[:3], by_mode, atol=1e-14)


def test_statics_and_single_precision(follower):
    single = jax.tree.map(lambda x: x.astype(jnp.float32), follower)
    theta = np.array([0.2, 0.1])
    q = dr.loaded_equilibrium(follower, theta)
    residual = 50.0 * (theta - q) - dr.gravity_forces(follower, q)
    # Two Newton steps on a soft arm: the equilibrium of the folded torques.
    assert_allclose(residual, 0.0, atol=1e-3)
    found = dr.mass_matrix(single, theta)
    assert found.dtype == jnp.float32
    assert_allclose(found, dr.mass_matrix(follower, theta), rtol=1e-5)
    assert dr.natural_frequencies(follower, q).shape == (2,)


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
    with pytest.raises(ValueError, match="mimics itself"):
        arm(mimics)


def test_a_multiplier_must_be_a_number():
    with pytest.raises(ValueError, match="must be finite"):
        dr.Mimic("turn", np.nan)
    assert dataclasses.astuple(dr.Mimic("turn")) == ("turn", 1.0, 0.0)
