"""A program on a machine that its controller does not know."""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill import robot as rb

# A rectangle in the air above the block.
SQUARE = """G21 G17 G90 G94
G0 X0 Y0 Z5
G1 X24 F6000
G1 Y18
G1 X0
G1 Y0
M2
"""


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return dm.load_job(
        write_slides_job(tmp_path_factory.mktemp("job"))
    ).with_precision()


@pytest.fixture(scope="module")
def square(tmp_path_factory):
    folder = tmp_path_factory.mktemp("square")
    return dm.load_job(write_slides_job(folder, program=SQUARE)).with_precision()


def skewed(job, angle):
    """The job with the slide along y turned so far towards -x [rad]."""
    axes = {"x": (1, 0, 0), "y": (-np.sin(angle), np.cos(angle), 0), "z": (0, 0, 1)}
    slide = functools.partial(rb.PrismaticJoint, stiffness=1e6, damping=2e3)
    slides = [slide(name, axis=axis) for name, axis in axes.items()]
    body = rb.RigidBody(80.0, (0.0, 0.0, 0.0), np.eye(3))
    return dataclasses.replace(job, robot=rb.build([*slides, body, rb.Tool("tool")]))


def test_a_machine_that_its_controller_knows_is_the_model(job):
    plain, found = dm.simulate(job), dm.simulate(dm.sim.mismatched(job, job))
    np.testing.assert_allclose(found.actual, plain.actual, atol=1e-12)
    np.testing.assert_allclose(found.force, plain.force, atol=1e-6)
    np.testing.assert_allclose(found.contour.rms, plain.contour.rms, rtol=1e-8)


def test_motors_take_the_place_of_the_command(job):
    tips = np.asarray(job.path.positions) + np.array([0.0, 3e-5, 0.0])
    motors = dm.sim.JobKinematics(job).motors(jnp.asarray(tips)).positions
    asked, given = dm.simulate(job, commanded=tips), dm.simulate(job, motors=motors)
    np.testing.assert_array_equal(given.actual, asked.actual)
    with pytest.raises(ValueError, match=r"`motors` must have shape \(\d+, 3\)"):
        dm.simulate(job, motors=np.asarray(motors)[:-1])
    rigid = dataclasses.replace(job, robot=None)
    with pytest.raises(ValueError, match="`motors` must be None"):
        dm.simulate(rigid, motors=motors)


def test_a_skewed_slide_shears_the_part(square):
    """A rigid fit takes the turn of a shear away, and leaves its symmetric half.

    With the slide along y turned by a, a point p goes to p - a (p_y, 0). Half of it is
    a turn by a / 2; the other half, about the middle m of the probes, is
    -a / 2 (p_y - m_y, p_x - m_x).
    """
    angle = 1e-3
    corners = np.array([[0, 0, 5], [24, 0, 5], [24, 18, 5], [0, 18, 5]]) / 1e3
    machine = skewed(square, angle)
    probed = dataclasses.replace(square, probes=corners)
    found = dm.simulate(dm.sim.mismatched(probed, machine))
    away = np.asarray(found.desired)[:, :2] - corners[:, :2].mean(0)
    wanted = -angle / 2 * away[:, ::-1]
    # The fit of a rectangle leaves some of the other half, too.
    own = np.asarray(found.deviation) - np.asarray(dm.simulate(square).deviation)
    a, b = 12e-3, 9e-3
    turn = angle / 2 * (b**2 - a**2) / (a**2 + b**2)
    wanted = wanted - turn * np.stack([-away[:, 1], away[:, 0]], axis=1)
    np.testing.assert_allclose(own[:, :2], wanted, atol=0.05 * np.abs(wanted).max())


def test_scaled_parameters_touch_the_work_off_anew(job):
    """Softer springs sag more; touched off anew the part is where it was."""
    both = dm.sim.mismatched(job, job)
    scale = np.zeros(len(job.parameter_names))
    scale[2] = np.log(0.5)
    soft = both.with_scaled(jnp.asarray(scale))
    sag = 80 * 9.81 / 1e6
    lower = both.T_base_work[2, 3] - soft.T_base_work[2, 3]
    np.testing.assert_allclose(lower, sag, rtol=1e-6)
    still = dm.simulate(soft).deviation[0]
    np.testing.assert_allclose(still, [0, 0, 0], atol=1e-9)


def test_a_flange_spring_of_the_machine_is_not_known(job):
    spring = rb.FlangeSpring(5.0, (0.0, 0.0, 0.05), (0.1, 0.1, 0.1), (1e5, 1e5, 1e5))
    machine = dataclasses.replace(job, robot=spring.mounted_on(job.robot))
    found = dm.simulate(dm.sim.mismatched(job, machine))
    assert found.motor_positions is not None and machine.robot is not None
    assert found.motor_positions.shape[1] == machine.robot.joint_count > 3
    assert found.contour.rms > 1.05 * dm.simulate(job).contour.rms


def test_what_is_no_machine_of_the_program_is_refused(job, square):
    with pytest.raises(ValueError, match="`machine` must have the path of `model`"):
        dm.sim.mismatched(job, square)
    with pytest.raises(ValueError, match="`model` must have a robot"):
        dm.sim.mismatched(dataclasses.replace(job, robot=None), job)
