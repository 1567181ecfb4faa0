"""Compliance and natural modes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr


def test_compliance_is_the_slope_of_the_loaded_pose(arm, difference):
    # Without gravity and from no load, so that only the springs answer.
    light = dr.Robot(**{**vars(arm), "gravity": jnp.zeros(3)})
    J = dr.jacobian(light, light.home)

    def displacement(wrench):
        q = dr.loaded_equilibrium(light, light.home, wrench)
        position = dr.forward_kinematics(light, q)[:3, 3]
        return jnp.concatenate([position, J[3:] @ (q - light.home)])

    expected = difference(displacement, np.zeros(6), 1.0)
    C = dr.cartesian_compliance(light, light.home)
    assert_allclose(C, expected, rtol=1e-6, atol=1e-13)
    assert_allclose(C, C.T, rtol=1e-12, atol=1e-20)


def two_masses(K1, K2):
    """Return two sliders in a row: the textbook chain of two masses."""
    I = np.eye(3)
    return dr.build(
        [
            dr.PrismaticJoint("first", (1, 0, 0), stiffness=K1, damping=3.0),
            dr.RigidBody(2.0, (0, 0, 0), I),
            dr.PrismaticJoint("second", (1, 0, 0), stiffness=K2, damping=0.6),
            dr.RigidBody(1.0, (0, 0, 0), I),
        ]
    )


def test_two_masses_ring_as_in_the_textbook():
    # m1 = 2, m2 = 1 kg; x1 = q1, x2 = q1 + q2; det(K - w^2 M) = 0.
    K1, K2 = 5e3, 1e3
    a, b, c = 2.0 * 1.0, -(2.0 * K2 + 1.0 * (K1 + K2)), K1 * K2
    roots = np.sort(np.roots([a, b, c]))
    found = dr.natural_frequencies(two_masses(K1, K2), [0.1, 0.2])
    assert_allclose(found, np.sqrt(roots) / (2 * np.pi), rtol=1e-12)


def test_damping_in_proportion_to_stiffness():
    # D = beta K gives each mode the ratio beta omega / 2, exactly.
    robot = two_masses(5e3, 1e3)
    assert_allclose(robot.joint_damping / robot.joint_stiffness, 6e-4)
    omega = 2 * np.pi * np.asarray(dr.natural_frequencies(robot, [0.0, 0.0]))
    ratios = dr.mode_shapes(robot, [0.0, 0.0]).damping_ratios
    assert_allclose(ratios, 6e-4 * omega / 2, rtol=1e-10)


def test_a_rigid_joint_does_not_ring():
    found = dr.natural_frequencies(two_masses(np.inf, 1e3), [0.0, 0.0])
    assert_allclose(found[0], np.sqrt(1e3) / (2 * np.pi), rtol=1e-9)
    assert found[1] > 1e6


def test_gradients_of_frequencies_and_compliance(arm, difference):
    def both(x):
        robot = arm.with_drives(stiffness=x * 1e6)
        first = dr.natural_frequencies(robot, robot.home)[:2]
        return jnp.concatenate(
            [first, 1e6 * jnp.diag(dr.cartesian_compliance(robot, robot.home))[:3]]
        )

    both = jax.jit(both)
    x = np.asarray(arm.joint_stiffness) / 1e6
    expected = difference(both, x, 1e-6)
    assert_allclose(jax.jacrev(both)(jnp.asarray(x)), expected, rtol=1e-5, atol=1e-6)


def test_modes_solve_the_equation_of_motion(soft_arm):
    # K phi = omega^2 M phi, with virtual and sliding joints among them.
    q = np.array([0.3, 0.0, -0.5, 0.1, 0.4])
    found = dr.mode_shapes(soft_arm, q)
    M, K = np.asarray(dr.mass_matrix(soft_arm, q)), np.asarray(soft_arm.joint_stiffness)
    phi = np.asarray(found.joint_shapes).T
    omega = 2 * np.pi * np.asarray(found.frequencies)
    assert_allclose(K[:, None] * phi, M @ phi * omega**2, rtol=1e-8, atol=1e-3)
    assert_allclose(phi.T @ M @ phi, np.eye(5), atol=1e-10)
    assert_allclose(found.frequencies, dr.natural_frequencies(soft_arm, q), rtol=1e-9)
    J = np.asarray(dr.jacobian(soft_arm, q))
    assert_allclose(found.tool_shapes, (J @ phi).T, atol=1e-12)
    energy = K * np.asarray(found.joint_shapes) ** 2
    shares = np.asarray(found.energy_shares)
    assert_allclose(shares, energy / energy.sum(axis=1, keepdims=True), atol=1e-10)
    largest = shares.argmax(axis=1)
    assert (np.asarray(found.joint_shapes)[np.arange(5), largest] > 0).all()


def test_damped_modes_are_poles_of_the_equation_of_motion(soft_arm):
    # Dampers that have nothing to do with the springs, by the matrix of first order.
    q = np.array([0.3, 0.0, -0.5, 0.1, 0.4])
    D = np.array([300.0, 2.0, 40.0, 900.0, 0.5])
    robot = soft_arm.with_drives(damping=D)
    M, K = np.asarray(dr.mass_matrix(robot, q)), np.asarray(robot.joint_stiffness)
    A = np.block(
        [
            [np.zeros((5, 5)), np.eye(5)],
            [-np.linalg.solve(M, np.diag(K)), -np.linalg.solve(M, np.diag(D))],
        ]
    )
    poles = np.linalg.eigvals(A)
    poles = poles[poles.imag > 1e-6]
    poles = poles[np.argsort(poles.imag)]
    found = dr.damped_modes(robot, q)
    assert_allclose(2 * np.pi * found.frequencies, poles.imag, rtol=1e-9)
    assert_allclose(found.damping_ratios, -poles.real / np.abs(poles), rtol=1e-7)
    phi = found.joint_shapes
    left = phi @ M * poles[:, None] ** 2 + phi * D * poles[:, None] + phi * K
    assert np.abs(left).max() < 1e-6 * np.abs(phi * K).max()
    assert_allclose(np.einsum("mi,ij,mj->m", phi.conj(), M, phi), 1.0, atol=1e-12)


def test_a_strong_damper_locks_its_joint():
    # The second mass rings alone, with its own small damping: the modal ratio of the
    # undamped shapes is far too large.
    robot = two_masses(5e3, 1e3).with_drives(damping=np.array([1e5, 0.6]))
    found = dr.damped_modes(robot, [0.0, 0.0])
    assert_allclose(found.frequencies, np.sqrt(1e3) / (2 * np.pi), rtol=1e-3)
    assert_allclose(found.damping_ratios, 0.6 / (2 * np.sqrt(1e3)), rtol=2e-2)
    assert dr.mode_shapes(robot, [0.0, 0.0]).damping_ratios[0] > 1.0
    # The softness of a rigid joint is an ordinary number, and it does not ring.
    rigid = dr.damped_modes(two_masses(np.inf, 1e3), [0.0, 0.0])
    assert_allclose(rigid.frequencies, np.sqrt(1e3 - 0.09) / (2 * np.pi), rtol=1e-9)
    assert_allclose(rigid.damping_ratios, 0.6 / (2 * np.sqrt(1e3)), rtol=1e-9)
    assert_allclose(rigid.energy_shares, [[0.0, 1.0]], atol=1e-12)


def test_modes_of_a_partly_rigid_arm_are_finite_numbers():
    found = dr.mode_shapes(two_masses(np.inf, 1e3), [0.0, 0.0])
    # The second mass alone on its spring, damped by c / (2 sqrt(k m)).
    assert_allclose(found.damping_ratios[0], 0.6 / (2 * np.sqrt(1e3)), rtol=1e-8)
    assert_allclose(found.energy_shares[0], [0.0, 1.0], atol=1e-12)
    assert_allclose(found.joint_shapes[0], [0.0, 1.0], atol=1e-8)


def test_deflection_of_a_bar_on_a_spring(difference):
    # A horizontal bar on one spring: K (theta - q) = m g s cos q + F L sin-like terms.
    K, m, s, L = 4e3, 6.0, 0.4, 0.9
    bar = dr.build(
        [
            dr.RevoluteJoint("pivot", (0, -1, 0), stiffness=K),
            dr.RigidBody(m, (s, 0, 0), np.diag([0.1, 0.2, 0.2])),
            dr.FixedTranslation((L, 0, 0)),
        ]
    )

    def rest(force, theta):
        q = theta
        for _ in range(60):
            q = theta + (force * L - 9.81 * m * s) * np.cos(q) / K
        return q

    sag = dr.gravity_sag(bar, [0.3])
    q = rest(0.0, 0.3)
    assert_allclose(sag[0], L * (np.cos(q) - np.cos(0.3)), rtol=1e-9)
    assert_allclose(sag[2], L * (np.sin(q) - np.sin(0.3)), rtol=1e-9)
    assert_allclose(sag[4], 0.3 - q, rtol=1e-4)  # about +y, against the pivot
    # The motor makes up for the weight, so that the bar rests at 0.3 without load.
    theta = 0.3 + 9.81 * m * s * np.cos(0.3) / K
    q = rest(50.0, theta)
    found = dr.static_deflection(bar, [0.3], [0.0, 0.0, 50.0, 0.0, 0.0, 0.0])
    assert_allclose(found[0], L * (np.cos(q) - np.cos(0.3)), rtol=1e-9)
    assert_allclose(found[2], L * (np.sin(q) - np.sin(0.3)), rtol=1e-9)


def test_deflection_is_compliance_times_wrench_for_small_loads(arm):
    light = dr.Robot(**{**vars(arm), "gravity": jnp.zeros(3)})
    wrench = np.array([3.0, -2.0, 1.0, 0.5, 0.3, -0.2])
    found = dr.static_deflection(light, arm.home, wrench)
    C = np.asarray(dr.cartesian_compliance(arm, arm.home))
    assert_allclose(found, C @ wrench, rtol=1e-3, atol=1e-9)
    # Gravity changes it by little, and the sag is that of all the weight.
    heavy = dr.static_deflection(arm, arm.home, wrench)
    assert_allclose(heavy, found, rtol=1e-2, atol=1e-7)
    assert not np.allclose(heavy, found, rtol=1e-5, atol=0.0)
    assert_allclose(dr.gravity_sag(light, arm.home), 0.0, atol=1e-12)
    assert dr.gravity_sag(arm, arm.home)[2] < -1e-4


def test_stiffness_is_the_inverse_of_the_free_compliance(arm):
    C = np.asarray(dr.cartesian_compliance(arm, arm.home))[:3, :3]
    principal = dr.principal_stiffness(arm, arm.home)
    assert_allclose(principal, np.linalg.eigvalsh(np.linalg.inv(C)), rtol=1e-9)


def test_rigid_directions_are_infinitely_stiff(planar_arm):
    found = np.asarray(dr.principal_stiffness(planar_arm, [0.4, -0.9]))
    assert np.isfinite(found[:2]).all() and found[2] == np.inf
    stiff = planar_arm.with_drives(stiffness=[np.inf, np.inf])
    assert (np.asarray(dr.principal_stiffness(stiff, [0.4, -0.9])) == np.inf).all()
    assert_allclose(dr.gravity_sag(stiff, [0.4, -0.9]), 0.0, atol=1e-15)


def test_receptance_of_one_mass_and_of_the_modes(soft_arm):
    slider = dr.build(
        [
            dr.PrismaticJoint("x", (1, 0, 0), stiffness=5e4, damping=40.0),
            dr.RigidBody(3.0, (0, 0, 0), np.eye(3)),
        ]
    )
    hertz = np.array([0.0, 5.0, 20.0, 60.0])
    omega = 2 * np.pi * hertz
    found = np.asarray(dr.receptance(slider, [0.0], hertz))
    assert_allclose(found[:, 0, 0], 1 / (5e4 + 40j * omega - 3.0 * omega**2))
    assert_allclose(np.abs(found[:, 1:]), 0.0)
    # Dampers in proportion to the springs: a sum over modes is then exact.
    beta, q = 1e-3, np.array([0.3, 0.0, -0.5, 0.1, 0.4])
    robot = soft_arm.with_drives(damping=beta * soft_arm.joint_stiffness)
    modes = dr.mode_shapes(robot, q)
    u = np.asarray(modes.tool_shapes)[:, :3]
    w = 2 * np.pi * np.asarray(modes.frequencies)
    gain = 1 / (w**2 + 1j * omega[:, None] * beta * w**2 - omega[:, None] ** 2)
    expected = np.einsum("fm,mi,mj->fij", gain, u, u)
    assert_allclose(dr.receptance(robot, q, hertz), expected, rtol=1e-8, atol=1e-14)


def test_a_rigid_joint_answers_to_no_frequency():
    found = dr.receptance(two_masses(np.inf, 1e3), [0.0, 0.0], np.array([3.0]))
    omega = 2 * np.pi * 3.0
    expected = 1 / (1e3 + 0.6j * omega - omega**2)
    assert_allclose(found[0, 0, 0], expected, rtol=1e-12)


@pytest.mark.slow
def test_statics_and_shapes_have_derivatives(planar_arm, difference):
    pose = np.array([0.4, -0.9])

    @jax.jit
    def several(x):
        robot = planar_arm.with_drives(stiffness=x * 1e3)
        wrench = jnp.array([6.0, 0.0, 10.0, 0.0, 0.5, 0.0])
        modes = dr.mode_shapes(robot, pose)
        answer = dr.receptance(robot, pose, np.array([2.0]))[0, 0, 0]
        return jnp.concatenate(
            [
                10.0 * dr.static_deflection(robot, pose, wrench),
                10.0 * dr.gravity_sag(robot, pose),
                1e-3 * dr.principal_stiffness(robot, pose)[:2],
                modes.tool_shapes[0, :3],
                modes.damping_ratios,
                1e3 * jnp.stack([answer.real, answer.imag]),
            ]
        )

    x = np.asarray(planar_arm.joint_stiffness) / 1e3
    expected = difference(several, x, 1e-6)
    # Reverse mode only: both take long to compile, and every part is plain JAX.
    found = jax.jit(jax.jacrev(several))(jnp.asarray(x))
    assert_allclose(found, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_modes_batch_over_poses(arm):
    q = np.asarray(arm.home)[None] + np.array([[0.0], [0.05]])
    both = jax.vmap(lambda row: dr.mode_shapes(arm, row))(jnp.asarray(q))
    for k in range(2):
        one = dr.mode_shapes(arm, q[k])
        assert_allclose(both.frequencies[k], one.frequencies, rtol=1e-10)
        assert_allclose(both.tool_shapes[k], one.tool_shapes, atol=1e-9)


@pytest.mark.parametrize(("rigid", "count"), [([0, 1], 4), ([0, 1, 2, 3, 4], 1)])
def test_rigid_joints_take_their_modes_away(rigid, count):
    arm = dr.load("kuka_kr210_like")
    stiffness = arm.joint_stiffness.at[jnp.array(rigid)].set(jnp.inf)
    robot, q = arm.with_drives(stiffness=stiffness), arm.home + 0.05
    modes = dr.mode_shapes(robot, q)
    for found in (modes.frequencies, dr.natural_frequencies(robot, q)):
        assert (np.asarray(found[:count]) < 1e3).all()
        assert (np.asarray(found[count:]) == np.inf).all()
    assert_allclose(modes.energy_shares.sum(axis=1), np.arange(6) < count, atol=1e-12)
    assert (np.asarray(modes.damping_ratios[count:]) == 0.0).all()
    assert len(dr.TipModes.of_robot(robot, q, np.eye(4)).frequencies) == count
    slope = np.asarray(jax.jacfwd(lambda q: dr.natural_frequencies(robot, q))(q))
    assert np.abs(slope).max() < 1e3 and (slope[count:] == 0.0).all()
