"""Where to put the workpiece, on arms whose softness over the place is known."""

import dataclasses
import math
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import cut_rms
from scipy.spatial.transform import Rotation

import diffmill as dm
import machines
from diffmill import robot as rb, toolpath as tp, units, workpiece as wp
from diffmill.correction import InfeasibleLimit, NothingToCorrect, place_workpiece
from diffmill.examples import copy_example
from diffmill.sim import JobKinematics

STIFF = 1e15
FIXED = (0.0, 0.0)
ROWS = 12


def arm(column=STIFF, x=STIFF, y=STIFF, z=STIFF):
    """Return three slides on a column that turns about z; x has limits."""
    slide = lambda name, axis, stiffness, **more: rb.PrismaticJoint(
        name, axis, stiffness=stiffness, damping=1.0, **more
    )
    joints = [
        rb.RevoluteJoint("column", (0.0, 0.0, 1.0), stiffness=column, damping=1.0),
        slide("x", (1.0, 0.0, 0.0), x, lower=0.6, upper=2.0, home=1.2),
        slide("y", (0.0, 1.0, 0.0), y),
        slide("z", (0.0, 0.0, 1.0), z),
    ]
    return rb.build([*joints, rb.RigidBody(50.0, (0.0, 0.0, 0.0), np.eye(3))])


def job_of(robot, position=(1.2, 0.0, 0.0), length=0.05, **more):
    """Return a straight path along x of `work`; what it cuts is not looked at."""
    tips = np.zeros((ROWS, 3))
    tips[:, 0] = np.linspace(0.0, length, ROWS)
    job = machines.job_of(
        robot,
        tp.Path.upright(0.03 * np.arange(ROWS), tips),
        wp.box([0, 0, -2e-3], [4e-3, 4e-3, 0], 1e-3),
        angles=96,
        substeps=4,
    )
    job.T_base_work[:3, 3] = position
    return dataclasses.replace(job, **more)


def matrix_of(pose):
    """Return the matrix of a pose as a job file says it."""
    values = lambda key, kind: [units.quantity(text, kind) for text in pose[key]]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", values("rpy", units.ANGLE)).as_matrix()
    T[:3, 3] = values("position", units.LENGTH)
    return T


def steady(force):
    """Return a force that begins after the first two rows."""
    rows = np.tile(np.asarray(force, float), (ROWS, 1))
    rows[:2] = 0.0
    return rows


@pytest.mark.slow
def test_the_tool_turns_until_the_stiff_direction_takes_the_force():
    # symbols: a, b compliances along the slides, which the column turns with the tool
    F, (a, b, c) = np.array([30.0, 50.0, 10.0]), (1e-6, 0.25e-6, 0.1e-6)
    job = job_of(arm(x=1 / a, y=1 / b, z=1 / c), length=1e-3)
    found = place_workpiece(
        job, shift_bounds=[FIXED] * 3, rotation_bounds=(-0.9, 0.9), force=steady(F)
    )
    # Across the path, y: (a + b) / 2 F_y - (a - b) / 2 |F| cos(2 psi + atan(F_x / F_y))
    size = math.hypot(F[0], F[1])
    least = (a + b) / 2 * F[1] - (a - b) / 2 * size
    assert found.rms_before == pytest.approx(math.hypot(b * F[1], c * F[2]), rel=1e-9)
    assert found.rms_after == pytest.approx(math.hypot(least, c * F[2]), rel=1e-6)
    assert found.rotation == pytest.approx(-math.atan2(F[0], F[1]) / 2, abs=2e-3)
    assert found.at_bound == () and found.refused == 0
    lines = tomllib.loads(found.toml)
    tool = matrix_of(lines["tool_in_flange"])
    np.testing.assert_allclose(tool, found.T_flange_tool, atol=1e-9)


def test_the_work_comes_as_near_as_the_joints_allow():
    job, F, K = job_of(arm(column=1e6)), 100.0, 1e6
    found = place_workpiece(
        job, shift_bounds=[(-1.0, 0.5), FIXED, FIXED], force=steady([20.0, F, 0.0])
    )
    radius = 1.2 + np.linspace(0.0, 0.05, ROWS)
    closed = lambda r: math.sqrt(np.mean((F * r[2:] ** 2 / K) ** 2))
    assert found.rms_before == pytest.approx(closed(radius), rel=1e-8)
    assert found.rms_after == pytest.approx(closed(radius + found.shift[0]), rel=1e-8)
    assert 0.6 < 1.2 + found.shift[0] < 0.66
    assert found.refused > 0
    assert found.at_bound == ()
    lines = tomllib.loads(found.toml)
    assert set(lines) == {"work_in_base"}
    work = matrix_of(lines["work_in_base"])
    np.testing.assert_allclose(work, found.T_base_work, atol=1e-9)
    # Roll and yaw about one axis, too.
    for pitch in (0.3, math.pi / 2, -math.pi / 2, -1.2):
        work[:3, :3] = rb.rpy_matrix(2.0, pitch, -2.5)
        place = dataclasses.replace(found, T_base_work=work)
        again = matrix_of(tomllib.loads(place.toml)["work_in_base"])
        np.testing.assert_allclose(again, work, atol=1e-9)


def test_the_cut_turns_to_be_pushed_along_the_stiff_radius():
    found = place_workpiece(
        job_of(arm(column=1e6), length=1e-3),
        shift_bounds=[FIXED] * 3,
        angle_bounds=(-0.5, 0.8),
        force=steady([0.0, 100.0, 0.0]),
    )
    # Only the part of the force along the column's circle moves the tool, along it.
    assert found.angle == pytest.approx(0.8, abs=1e-3)
    assert found.at_bound == ("angle",)
    share = found.rms_after / found.rms_before
    assert share == pytest.approx(math.cos(0.8) ** 2, rel=2e-3)


def test_a_place_out_of_reach_is_refused():
    with pytest.raises(InfeasibleLimit, match="all 5 places"):
        place_workpiece(
            job_of(arm()),
            shift_bounds=[(3.0, 4.0), (-0.1, 0.1), FIXED],
            starts=4,
            force=steady([0.0, 100.0, 0.0]),
        )


@pytest.mark.parametrize(
    ("bounds", "more", "message"),
    [
        ({"shift_bounds": [FIXED] * 3}, {}, "leave something free"),
        ({"shift_bounds": [(0.1, -0.1), FIXED, FIXED]}, {}, "a least and a largest"),
        ({"shift_bounds": [FIXED]}, {}, "a pair for each of x, y and z"),
        (
            {"shift_bounds": [FIXED] * 3, "rotation_bounds": (-1.0, 1.0)},
            {"tool_rotation": "free"},
            "turns it as it suits",
        ),
    ],
)
def test_bounds_without_sense_are_refused(bounds, more, message):
    with pytest.raises(ValueError, match=message):
        place_workpiece(job_of(arm(), **more), force=steady([0.0, 1.0, 0.0]), **bounds)


def test_a_rigid_machine_and_a_cut_in_air_are_refused():
    job, bounds = job_of(arm()), [(-0.1, 0.1), FIXED, FIXED]
    with pytest.raises(ValueError, match=r"`job`.*robot"):
        place_workpiece(dataclasses.replace(job, robot=None), shift_bounds=bounds)
    with pytest.raises(NothingToCorrect):
        place_workpiece(job, shift_bounds=bounds, force=steady([0.0, 0.0, 0.0]))


def test_the_derivative_over_the_place_is_that_of_differences():
    """Of the deflection under a force that keeps its direction in the work."""
    job = job_of(rb.load("reis_rv130_like"), (1.5, 0.1, 0.9))
    T = job.T_base_work
    force = steady([40.0, 60.0, 10.0])
    # Into the cell and up, and turned.
    push = jnp.zeros((4, 4)).at[:3, 3].set(jnp.array([1.0, 0.5, 0.7]))
    push = push.at[0, 1].set(-1.0).at[1, 0].set(1.0)

    @jax.jit
    def moved(T):
        def deviation(T):
            placed = JobKinematics(dataclasses.replace(job, T_base_work=T))
            q, _ = placed.joints(jnp.asarray(job.path.positions))
            C = jax.vmap(lambda q: rb.cartesian_compliance(placed.robot, q)[:3, :3])(q)
            return jnp.einsum("ba,rbc,cd,rd->ra", T[:3, :3], C, T[:3, :3], force)

        return jax.jvp(deviation, (T,), (push,))

    exact, h = moved(jnp.asarray(T))[1], 1e-5
    differences = (moved(T + h * push)[0] - moved(T - h * push)[0]) / (2 * h)
    np.testing.assert_allclose(exact, differences, atol=1e-6 * np.abs(exact).max())


@pytest.mark.slow
def test_the_simulated_error_falls_as_predicted(tmp_path):
    job = dm.load_job(copy_example("paper_small", tmp_path))
    still = dataclasses.replace(job.simulation, mode="quasistatic")

    def rms(job):
        solution = dm.simulate(job)
        return cut_rms(solution), solution.rigid.force

    before, force = rms(job)
    static, _ = rms(dataclasses.replace(job, simulation=still))
    found = place_workpiece(
        job,
        shift_bounds=[(-0.3, 0.3)] * 3,
        angle_bounds=(-math.pi, math.pi),
        force=force,
    )
    share = found.rms_after / found.rms_before
    assert share < 0.8
    # Without inertia it is the prediction.
    assert static == pytest.approx(found.rms_before, rel=0.05)
    moved = found.moved(job)
    after, _ = rms(dataclasses.replace(moved, simulation=still))
    assert after / static == pytest.approx(share, rel=0.05)
    # The whole arm swings about that, which does not grow: the squares add up.
    assert before**2 - rms(moved)[0] ** 2 > 0.9 * (static**2 - after**2)
    # The lines of the job file are that place.
    file = copy_example("paper_small", tmp_path / "moved")
    text = file.read_text().splitlines()
    text = [found.toml if line.startswith("work_in_base") else line for line in text]
    file.write_text("\n".join(text))
    np.testing.assert_allclose(
        dm.load_job(file).T_base_work, found.T_base_work, atol=1e-9
    )
