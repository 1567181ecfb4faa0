"""Articulated bodies against composite bodies, which share no line with them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from robot.trees import random_tree

import diffmill.robot as dr
from diffmill.robot import ArmTerms


def both(robot, *args):
    return [
        np.asarray(dr.forward_dynamics(robot, *args, algorithm=name))
        for name in ("crba", "aba")
    ]


@pytest.mark.parametrize(
    ("count", "is_forked"),
    [
        (1, False),
        (2, False),
        (6, True),
        pytest.param(12, False, marks=pytest.mark.slow),
    ],
)
def test_both_algorithms_agree_on_random_trees(rng, count, is_forked):
    robot = random_tree(rng, count, is_forked=is_forked)
    q, qd, tau = rng.normal(size=(3, count))
    composite, articulated = both(robot, q, qd, 10 * tau, rng.normal(size=6) * 30)
    np.testing.assert_allclose(
        articulated, composite, rtol=0, atol=1e-10 * np.abs(composite).max()
    )


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["crba", "aba"])
def test_derivatives_are_central_differences(soft_arm, rng, difference, algorithm):
    n = soft_arm.joint_count
    x0 = np.concatenate([rng.uniform(-1, 1, 3 * n), rng.normal(size=6) * 10])
    # Zero angles: nothing may divide by them.
    x0[:2] = 0.0

    @jax.jit
    def function(x):
        q, qd, tau, wrench = jnp.split(x, [n, 2 * n, 3 * n])
        return dr.forward_dynamics(soft_arm, q, qd, tau, wrench, algorithm=algorithm)

    expected = difference(function, x0, 1e-5)
    row, along = jnp.asarray(rng.normal(size=n)), jnp.asarray(rng.normal(size=x0.size))
    x0 = jnp.asarray(x0)
    size = np.abs(expected).max()
    slope = jax.jit(jax.grad(lambda x: row @ function(x)))(x0)
    np.testing.assert_allclose(slope, row @ expected, rtol=1e-6, atol=1e-8 * size)
    _, change = jax.jit(lambda x: jax.jvp(function, (x,), (along,)))(x0)
    np.testing.assert_allclose(change, expected @ along, rtol=1e-6, atol=1e-8 * size)


@pytest.mark.slow
def test_derivatives_by_masses_and_of_second_order_agree(planar_arm, rng):
    n = planar_arm.joint_count
    q, qd, tau = map(jnp.asarray, rng.uniform(-1, 1, (3, n)))

    def energy(algorithm):
        def function(robot, q):
            a = dr.forward_dynamics(robot, q, qd, tau, algorithm=algorithm)
            return jnp.sum(a**2)

        @jax.jit
        def both_orders(q):
            curve = lambda q: jax.grad(function, 1)(planar_arm, q)
            return jax.grad(function)(planar_arm, q), jax.jvp(curve, (q,), (qd,))[1]

        return both_orders(q)

    (slope, bend), (slope_aba, bend_aba) = energy("crba"), energy("aba")
    np.testing.assert_allclose(bend_aba, bend, rtol=1e-8, atol=1e-9)
    assert np.abs(slope.link_masses).min() > 0
    for a, b in zip(jax.tree.leaves(slope_aba), jax.tree.leaves(slope), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8 * (1 + np.abs(b).max()))


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["crba", "aba"])
def test_the_augmented_inverse_inverts(soft_arm, rng, difference, algorithm):
    n = soft_arm.joint_count
    q, d = rng.uniform(-1, 1, n), rng.uniform(0.1, 2.0, n)

    @jax.jit
    def inverse(x):
        if algorithm == "aba":
            return ArmTerms.articulated_inverse(soft_arm, x[:n], x[n:])
        return ArmTerms.of_state(soft_arm, x[:n], x[:n]).augmented_inverse(x[n:])

    x = np.concatenate([q, d])
    matrix = dr.mass_matrix(soft_arm, q) + np.diag(d)
    np.testing.assert_allclose(inverse(jnp.asarray(x)) @ matrix, np.eye(n), atol=1e-12)
    expected = difference(inverse, x, 1e-6)
    found = jax.jacfwd(inverse)(jnp.asarray(x))
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_batches_have_the_single_results(planar_arm, rng):
    # One lane block, several with a rest, a batch of batches, a batch of robots.
    q = jnp.asarray(rng.uniform(-1, 1, (600, 2)))
    run = lambda robot, q: dr.forward_dynamics(robot, q, q, q, algorithm="aba")
    expected = jax.vmap(lambda q: dr.forward_dynamics(planar_arm, q, q, q))(q)
    many = jax.jit(jax.vmap(run, (None, 0)))
    np.testing.assert_allclose(many(planar_arm, q), expected, rtol=1e-10, atol=1e-10)
    nested = jax.jit(jax.vmap(jax.vmap(run, (None, 0)), (None, 0)))
    found = nested(planar_arm, q[:6].reshape(2, 3, 2)).reshape(6, 2)
    np.testing.assert_allclose(found, expected[:6], rtol=1e-10, atol=1e-10)
    robots = jax.tree.map(lambda x: jnp.stack([x, x, x]), planar_arm)
    found = jax.jit(jax.vmap(run))(robots, q[:3])
    np.testing.assert_allclose(found, expected[:3], rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_a_rollout_and_its_gradient_agree(planar_arm):
    def roll(algorithm, q):
        def step(state, _):
            q, v = state
            a = dr.forward_dynamics(planar_arm, q, v, -50 * q, algorithm=algorithm)
            return (q + 1e-3 * v, v + 1e-3 * a), q

        return jnp.sum(jax.lax.scan(step, (q, 0.1 * q), length=20)[1][-1])

    q = jnp.asarray([0.4, -0.3])
    values = [
        jax.jit(jax.value_and_grad(lambda q, name=name: roll(name, q)))(q)
        for name in ("crba", "aba")
    ]
    np.testing.assert_allclose(values[1][0], values[0][0], rtol=1e-10)
    np.testing.assert_allclose(values[1][1], values[0][1], rtol=1e-10)


def test_massless_ends_are_refused_by_name(rng):
    body = dr.RigidBody(2.0, (0.1, 0.0, 0.0), 0.01 * np.eye(3))
    first = dr.RevoluteJoint("first", (0, 0, 1))
    robot = dr.build([first, body, dr.RevoluteJoint("light", (1, 0, 0))])
    with pytest.raises(ValueError, match="light"):
        dr.forward_dynamics(robot, [0.1, 0.2], [0, 0], [1, 1], algorithm="aba")
    # A body at the end makes up for a link without mass.
    slide = dr.PrismaticJoint("slide", (0, 1, 0))
    robot = dr.build([dr.RevoluteJoint("light", (1, 0, 0)), slide, body])
    composite, articulated = both(robot, [0.1, 0.2], [1.0, 2.0], [3.0, 4.0])
    np.testing.assert_allclose(articulated, composite, rtol=1e-12)


def test_coincident_axes_are_refused():
    body = dr.RigidBody(2.0, (0.1, 0.0, 0.0), 0.01 * np.eye(3))
    axis = dr.FixedRotation(dr.rpy_matrix(0.3, 0.2, 0.1))
    twice = [dr.RevoluteJoint(name, (0, 0, 1)) for name in ("a", "b")]
    robot = dr.build([axis, *twice, body])
    with pytest.raises(ValueError):
        dr.forward_dynamics(robot, [0.1, 0.2], [0, 0], [1, 1], algorithm="aba")


def test_single_precision_stays_single(planar_arm):
    low = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), planar_arm)
    q = np.array([0.3, -0.2])
    found = dr.forward_dynamics(low, q, q, q, algorithm="aba")
    assert found.dtype == jnp.float32
    expected = dr.forward_dynamics(planar_arm, q, q, q)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_mimic_joints_need_composite_bodies(arm):
    mimics = (*arm.mimics[:5], (0, 1.0, 0.0))
    follower = dr.Robot(
        **{**vars(arm), "mimics": mimics, "joint_names": arm.joint_names[:5]}
    )
    with pytest.raises(ValueError, match="'crba'"):
        dr.forward_dynamics(follower, *np.zeros((3, 5)), algorithm="aba")


@pytest.mark.parametrize("algorithm", ["crba", "aba"])
def test_links_next_to_massless_move_as_the_mass_matrix_says(algorithm):
    parts = []
    for i, (axis, mass) in enumerate((((0, 0, 1), 5.0), ((0, 1, 0), 1e-11))):
        inertia = mass * np.diag([0.02, 0.03, 0.025])
        parts += [
            dr.RevoluteJoint(f"{i}", axis),
            dr.RigidBody(mass, (0.1, 0.02, 0.05), inertia),
            dr.FixedTranslation((0.3, 0.1, 0.2)),
        ]
    robot = dr.build(parts)
    q, still = np.array([0.3, -0.5]), np.zeros(2)
    M = np.asarray(dr.mass_matrix(robot, q))
    tau = np.array([1.0, 2.0])
    # In units of each joint's own inertia the matrix is well conditioned.
    scale = 1 / np.sqrt(np.diag(M))
    left = tau - np.asarray(dr.gravity_forces(robot, q))
    expected = scale * np.linalg.solve(scale[:, None] * M * scale, scale * left)
    found = dr.forward_dynamics(robot, q, still, tau, algorithm=algorithm)
    assert_allclose(found, expected, rtol=1e-13)
