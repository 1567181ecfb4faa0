"""Mass matrix, bias forces and accelerations against closed forms and each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffmill.robot as dr


def at_link(robot, link):
    """Return the robot with its tool in the centre of mass of a link."""
    T = np.eye(4)
    T[:3, 3] = robot.link_centers[link]
    place = {"flange_joint": link, "T_joint_flange": jnp.asarray(T)}
    return dr.Robot(**{**vars(robot), **place, "T_flange_tool": jnp.eye(4)})


def planar_closed_form(q, qd):
    """Return M, C + G of the planar arm; textbook form, angles from +x upwards."""
    l1, c1, c2, m1, m2, i1, i2, g = 0.7, 0.3, 0.2, 3.0, 2.0, 0.06, 0.03, 9.81
    a = i1 + i2 + m1 * c1**2 + m2 * (l1**2 + c2**2)
    b, d = m2 * l1 * c2, i2 + m2 * c2**2
    M = np.array(
        [[a + 2 * b * np.cos(q[1]), d + b * np.cos(q[1])], [d + b * np.cos(q[1]), d]]
    )
    h = -b * np.sin(q[1])
    C = np.array([h * qd[1] * (2 * qd[0] + qd[1]), -h * qd[0] ** 2])
    upper = m2 * c2 * g * np.cos(q[0] + q[1])
    G = np.array([(m1 * c1 + m2 * l1) * g * np.cos(q[0]) + upper, upper])
    return M, C, G


@pytest.mark.parametrize("q", [(0.3, 0.9), (-1.2, 2.5), (2.0, -0.4)])
def test_planar_arm_has_its_closed_form(planar_arm, q):
    q, qd = np.array(q), np.array([0.8, -1.7])
    M, C, G = planar_closed_form(q, qd)
    np.testing.assert_allclose(dr.mass_matrix(planar_arm, q), M, atol=1e-13)
    np.testing.assert_allclose(dr.gravity_forces(planar_arm, q), G, atol=1e-12)
    np.testing.assert_allclose(
        dr.ArmTerms.of_state(planar_arm, q, qd).bias_forces, C + G, atol=1e-12
    )


def test_a_sliding_mass_is_weighed(rng):
    slider = dr.build(
        [
            dr.PrismaticJoint("lift", (0.0, 0.0, 2.0)),
            dr.RigidBody(4.0, (0.3, 0.1, 0.0), np.eye(3)),
        ]
    )
    np.testing.assert_allclose(dr.mass_matrix(slider, [0.2]), [[4.0]], rtol=1e-14)
    np.testing.assert_allclose(
        dr.inverse_dynamics(
            slider, [0.2], [1.0], [0.5], np.array([0, 0, 3.0, 0, 0, 0])
        ),
        [4.0 * (9.81 + 0.5) - 3.0],
        rtol=1e-14,
    )


def test_the_mass_matrix_is_the_sum_over_the_bodies(arm, rng):
    # Sum of m Jv^T Jv + Jw^T I Jw, the Jacobians taken of the bodies one by one.
    q = rng.uniform(-1.0, 1.0, 6)
    total = np.zeros((6, 6))
    for link in range(6):
        cut = at_link(arm, link)
        J = np.asarray(dr.jacobian(cut, q))
        R = np.asarray(dr.forward_kinematics(cut, q))[:3, :3]
        I = R @ np.asarray(arm.link_inertias[link]) @ R.T
        total += arm.link_masses[link] * J[:3].T @ J[:3] + J[3:].T @ I @ J[3:]
    np.testing.assert_allclose(dr.mass_matrix(arm, q), total, rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize(
    "algorithm", ["crba", pytest.param("aba", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", ["arm", "soft_arm"])
def test_forward_inverts_inverse_dynamics(name, algorithm, request, rng):
    robot = request.getfixturevalue(name)
    n = robot.joint_count
    q, qd, qdd = rng.uniform(-1, 1, (3, n))
    wrench = rng.normal(size=6) * 50
    tau = dr.inverse_dynamics(robot, q, qd, qdd, wrench)
    found = dr.forward_dynamics(robot, q, qd, tau, wrench, algorithm=algorithm)
    np.testing.assert_allclose(found, qdd, rtol=1e-10, atol=1e-10)


def test_power_of_all_forces_changes_the_kinetic_energy(soft_arm, rng):
    n = soft_arm.joint_count
    q, qd, tau = rng.uniform(-1, 1, (3, n))
    wrench = rng.normal(size=6) * 20
    qdd = dr.forward_dynamics(soft_arm, q, qd, tau, wrench)
    energy = lambda q, qd: 0.5 * qd @ dr.mass_matrix(soft_arm, q) @ qd
    args = (jnp.asarray(q), jnp.asarray(qd))
    _, change = jax.jvp(energy, args, (jnp.asarray(qd), qdd))
    J = dr.jacobian(soft_arm, q)
    power = qd @ np.asarray(tau + J.T @ wrench - dr.gravity_forces(soft_arm, q))
    np.testing.assert_allclose(change, power, rtol=1e-10)


def test_gravity_is_the_slope_of_the_potential_energy(soft_arm, rng, difference):
    # A slow lift needs the power G qd; heights from forward kinematics alone.
    q = rng.uniform(-1, 1, soft_arm.joint_count)

    def energy(q):
        total = 0.0
        for link in range(soft_arm.joint_count):
            cut = at_link(soft_arm, link)
            height = float(dr.forward_kinematics(cut, q)[2, 3])
            total += float(soft_arm.link_masses[link]) * 9.81 * height
        return np.array(total)

    np.testing.assert_allclose(
        dr.gravity_forces(soft_arm, q), difference(energy, q, 1e-5), atol=1e-7
    )


def test_arm_terms_are_those_of_the_single_functions(soft_arm, rng):
    q, qd = rng.uniform(-1, 1, (2, soft_arm.joint_count))
    terms = dr.ArmTerms.of_state(soft_arm, q, qd)
    expected = [
        dr.forward_kinematics(soft_arm, q),
        dr.jacobian(soft_arm, q),
        dr.mass_matrix(soft_arm, q),
        dr.inverse_dynamics(soft_arm, q, qd, np.zeros_like(q)),
    ]
    found = [terms.T_base_tool, terms.jacobian, terms.mass_matrix, terms.bias_forces]
    for have, want in zip(found, expected, strict=True):
        np.testing.assert_allclose(have, want, rtol=1e-12, atol=1e-12)


def test_gradient_of_forward_dynamics(soft_arm, rng, difference):
    n = soft_arm.joint_count
    q, qd, tau, row = rng.uniform(-1, 1, (4, n))
    F = rng.normal(size=6)

    @jax.jit
    def function(x):
        return row @ dr.forward_dynamics(soft_arm, x[:n], x[n:], tau, F)

    x = jnp.concatenate([jnp.asarray(q), jnp.asarray(qd)])
    expected = difference(function, x, 1e-6)
    assert np.abs(expected).min() > 1e-3
    np.testing.assert_allclose(jax.grad(function)(x), expected, rtol=1e-6, atol=1e-6)
    along = jnp.asarray(rng.normal(size=2 * n))
    _, slope = jax.jvp(function, (x,), (along,))
    np.testing.assert_allclose(slope, expected @ along, rtol=1e-6)


def test_gradient_by_a_mass_of_the_robot(planar_arm):
    # d tau / d m_2 of the closed form: only the gravity of the second body at rest.
    def torque(robot):
        return dr.gravity_forces(robot, [0.4, 0.0])[1]

    slope = jax.grad(torque)(planar_arm)
    np.testing.assert_allclose(slope.link_masses[1], 0.2 * 9.81 * np.cos(0.4))
    np.testing.assert_allclose(slope.link_masses[0], 0.0, atol=1e-15)


def test_vmap_gives_the_single_results(arm, rng):
    q, qd, tau = rng.uniform(-1, 1, (3, 4, 6))
    batch = jax.vmap(lambda *x: dr.forward_dynamics(arm, *x))(
        *map(jnp.asarray, (q, qd, tau))
    )
    for k in range(4):
        single = dr.forward_dynamics(arm, q[k], qd[k], tau[k])
        np.testing.assert_allclose(batch[k], single, rtol=1e-10)


def test_single_precision_stays_single(arm, rng):
    q = rng.uniform(-1, 1, 6)
    low = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), arm)
    terms = dr.ArmTerms.of_state(low, q, np.zeros(6))
    assert {leaf.dtype for leaf in jax.tree.leaves(terms)} == {np.dtype("float32")}
    np.testing.assert_allclose(
        terms.mass_matrix, dr.mass_matrix(arm, q), rtol=1e-3, atol=1e-2
    )


def test_wrong_arguments_are_named(arm):
    with pytest.raises(ValueError, match="`qd`"):
        dr.ArmTerms.of_state(arm, np.zeros(6), [0.0, 1.0])
    with pytest.raises(ValueError, match=r"`algorithm`.*'crba'.*'aba'"):
        dr.forward_dynamics(arm, arm.home, arm.home, arm.home, algorithm="magic")
    with pytest.raises(ValueError, match=r"`wrench`.* 6 "):
        dr.inverse_dynamics(arm, arm.home, arm.home, arm.home, [1.0, 2.0, 3.0])


def test_the_slope_of_gravity_is_the_derivative_of_its_torques(soft_arm, rng):
    follower = dr.build(
        [
            dr.RevoluteJoint("turn", (0, 1, 0.2)),
            dr.RigidBody(3.0, (0.3, 0.1, 0.0), np.eye(3)),
            dr.FixedTranslation((0.5, 0.0, 0.1)),
            dr.RevoluteJoint("follow", (0, 1, 0), mimic=dr.Mimic("turn", -0.7, 0.2)),
            dr.RigidBody(2.0, (0.2, 0.0, 0.1), np.eye(3)),
        ]
    )
    for robot in (soft_arm, follower):
        q = jnp.asarray(rng.uniform(-1.0, 1.0, robot.joint_count))
        slope = jax.jacfwd(lambda q, robot=robot: dr.gravity_forces(robot, q))(q)
        found = dr.ArmTerms.of_state(robot, q, jnp.ones_like(q)).gravity_stiffness
        np.testing.assert_allclose(found, slope, atol=1e-11)
