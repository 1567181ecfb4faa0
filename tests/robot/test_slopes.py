"""Slopes of the torques in closed form against derivatives of the recursion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robot.trees import random_tree

import diffmill.robot as dr


def motion(robot, rng):
    q, qd, qdd = rng.normal(size=(3, robot.joint_count))
    return tuple(map(jnp.asarray, (q, qd, 3 * qdd, 40 * rng.normal(size=6))))


def mimic_arm():
    """Return an arm whose second sliding joint follows a turning one."""
    body = lambda k: dr.RigidBody(1.0 + k, (0.1, 0.2 * k, -0.1), np.diag([1, 2, 2.5]))
    return dr.build(
        [
            dr.RevoluteJoint("turn", (0, 0, 1), stiffness=1e3),
            body(0),
            dr.FixedTranslation((0.4, 0.0, 0.3)),
            dr.RevoluteJoint("lift", (0, 1, 1), stiffness=1e3),
            body(1),
            dr.FixedTranslation((0.5, 0.1, 0.0)),
            dr.PrismaticJoint(
                "slide", (1, 0, 2), stiffness=1e3, mimic=dr.Mimic("lift", -0.6, 0.2)
            ),
            body(2),
            dr.Tool(position=(0.1, 0.2, 0.3)),
        ]
    )


@pytest.mark.parametrize("kind", ["fork", "mimic"])
def test_slopes_are_derivatives_of_the_recursion(kind, rng):
    robot = mimic_arm() if kind == "mimic" else random_tree(rng, 4, is_forked=True)
    args = motion(robot, rng)
    by_q, by_qd, by_qdd, by_F = jax.jit(
        jax.jacfwd(dr.inverse_dynamics, argnums=(1, 2, 3, 4))
    )(robot, *args)
    found = jax.jit(dr.rnea_derivatives)(robot, *args)
    for ours, theirs in (
        (found.position, by_q),
        (found.velocity, by_qd),
        (found.acceleration, by_qdd),
        (-found.wrench.T, by_F),
    ):
        np.testing.assert_allclose(ours, theirs, atol=1e-12 * np.abs(theirs).max())


def test_slopes_of_a_pendulum_are_known(rng):
    """M = m l^2, dtau/dq = -m g l cos q, dtau/dqd = 0 about a level axis."""
    m, l = 2.0, 0.7
    pendulum = dr.build(
        [
            dr.RevoluteJoint("pivot", (0, 1, 0), stiffness=1.0),
            dr.RigidBody(m, (0.0, 0.0, -l), np.zeros((3, 3))),
        ]
    )
    q = jnp.asarray(rng.normal(size=1))
    one = jnp.ones(1)
    found = dr.rnea_derivatives(pendulum, q, one, one, jnp.zeros(6))
    g = -float(pendulum.gravity[2])
    np.testing.assert_allclose(found.acceleration, [[m * l**2]], rtol=1e-14)
    np.testing.assert_allclose(found.velocity, [[0.0]], atol=1e-14)
    # It hangs down at q = 0: the torque that holds it is m g l sin q.
    np.testing.assert_allclose(found.position[0], m * g * l * np.cos(q), rtol=1e-13)


def test_a_batch_of_slides_has_the_slopes_of_each(rng):
    """Slides turn nothing: of a first one nothing depends on where the joints are."""
    slides = [
        dr.PrismaticJoint(name, axis, stiffness=1e3)
        for name, axis in (("x", (1, 0, 0)), ("z", (0, 0, 1)))
    ]
    robot = dr.build([*slides, dr.RigidBody(3.0, (0.1, 0.0, 0.2), np.eye(3))])
    args = [jnp.asarray(rng.normal(size=(5, n))) for n in (2, 2, 2, 6)]
    slopes = lambda *args: dr.rnea_derivatives(robot, *args)
    found = jax.tree.leaves(jax.vmap(slopes)(*args))
    for k in range(5):
        for batch, one in zip(
            found, jax.tree.leaves(slopes(*(x[k] for x in args))), strict=True
        ):
            np.testing.assert_allclose(batch[k], one, atol=1e-14)


def test_single_precision_has_the_same_slopes(rng):
    robot = random_tree(rng, 2, is_forked=False)
    args = motion(robot, rng)
    single = jax.tree.map(lambda x: x.astype(jnp.float32), (robot, *args))
    for a, b in zip(
        jax.tree.leaves(dr.rnea_derivatives(*single)),
        jax.tree.leaves(dr.rnea_derivatives(robot, *args)),
        strict=True,
    ):
        assert a.dtype == jnp.float32
        np.testing.assert_allclose(a, b, atol=1e-5 * np.abs(b).max())


def test_what_does_not_change_costs_nothing(planar_arm):
    """A step of constant inertias has no derivative of the recursion in it."""
    q = jnp.ones(2)
    run = lambda q: dr.forward_dynamics(planar_arm, q, q, q)
    text = str(jax.make_jaxpr(lambda q: jax.jvp(run, (q,), (q,)))(q))
    whole = lambda robot: dr.forward_dynamics(robot, q, q, q)
    other = str(jax.make_jaxpr(lambda r: jax.jvp(whole, (r,), (r,)))(planar_arm))
    assert "name=_inverse_dynamics" in other
    assert "name=_inverse_dynamics" not in text
