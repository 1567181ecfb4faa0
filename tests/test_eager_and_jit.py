"""Public functions: called as they are, compiled, traced around what is known."""

import dataclasses
import fnmatch
import functools
import inspect
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW
from slides_job import write_slides_job

import diffmill as dm
import diffmill.correction as dc
import diffmill.cutter as cutter
import diffmill.cutting as cutting
import diffmill.numerics as nm
import diffmill.process as pr
import diffmill.robot as dr
import diffmill.sim as ds
import diffmill.toolpath as dt
import diffmill.workpiece as wp

HELIX, SPEED = 0.5, 800.0
CUT = "G21 G17 G90 G94\nG0 X-5.5 Y4 Z-0.8\nG1 X-4 F6000\nM2\n"


class Call(NamedTuple):
    """A call of a public function.

    Attributes:
        function: Of what is known, and of arrays.
        known: A tree, whose floats are arrays where it is traced.
        arrays: What is differentiated.
        has_slopes: Whether it has a derivative by the arrays.
    """

    function: Callable[..., Any]
    known: Any
    arrays: tuple[Any, ...]
    has_slopes: bool = True


def rows(*shape, size=1.0):
    """Return fixed numbers without a pattern, all of about a size."""
    count = np.arange(1, math.prod(shape) + 1)
    return jnp.asarray(size * np.sin(1.7 * count).reshape(shape))


def displaced(robot, rows):
    """Return a robot with errors of its joints, and with gears that turn unevenly."""
    none = dr.LinkErrors.none(robot)
    waves = 1e-3 * jnp.ones((3, 4))
    return dataclasses.replace(
        none, displacement=rows, rotation=rows, waves=waves
    ).applied_to(robot)


def as_arrays(tree):
    """Return a tree with its floats as arrays, which a trace then takes for its own."""
    is_number = lambda x: isinstance(x, float | np.ndarray)
    return jax.tree.map(lambda x: jnp.asarray(x) if is_number(x) else x, tree)


@functools.cache
def mill():
    return as_arrays(cutter.flat_end_mill(10e-3, 2, HELIX))


@functools.cache
def bull():
    return as_arrays(cutter.bull_nose(10e-3, 2, 2e-3, HELIX, runout=20e-6))


@functools.cache
def holder():
    return cutter.ToolHolder.from_sizes(0.03, [0.02], [0.04], upper_diameters=[0.03])


@functools.cache
def arm():
    """A slide that carries two turning joints, all of them soft."""
    return dr.build(
        [
            dr.PrismaticJoint("x", (1, 0, 0), stiffness=1e6, damping=2e3),
            dr.RigidBody(5.0, (0, 0, 0.1), np.diag([0.2, 0.2, 0.1])),
            dr.RevoluteJoint("a", (0, 1, 0), stiffness=9e4, damping=20.0),
            dr.RigidBody(3.0, (0.3, 0, 0), np.diag([0.05, 0.06, 0.05])),
            dr.FixedTranslation((0.7, 0, 0)),
            dr.RevoluteJoint("b", (0, 0, 1), stiffness=4e4, damping=10.0),
            dr.RigidBody(2.0, (0.2, 0, 0), np.diag([0.02, 0.03, 0.02])),
            dr.FixedTranslation((0.5, 0, 0)),
        ]
    )


@functools.cache
def known_arm():
    """The arm as a controller knows it, which probes at four places."""
    motors = jnp.asarray(Q + 0.1 * np.sin(np.arange(12.0)).reshape(4, 3))
    tips = jax.vmap(lambda q: dr.forward_kinematics(arm(), q)[:3, 3])(motors)
    return dr.NominalRobot(arm(), jnp.eye(4), tips, motors)


Q = np.array([0.1, 0.3, -0.4])
POSE = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def bending(length):
    """A tool of which the length is an unknown."""
    return dr.BendingTool(length, 0.02, 10e-3, 10e-3)


def of_robot(name, *arrays, has_slopes=True):
    """Return the call of a function of the arm at a pose."""
    q = jnp.asarray(Q)
    return lambda: Call(getattr(dr, name), arm(), (q, *arrays), has_slopes)


def along(*vectors):
    return tuple(jnp.asarray(x) for x in vectors)


@functools.cache
def block():
    return wp.box([0, -8e-3, -2e-3], [8e-3, 8e-3, 0], 1e-3)


def pass_at(depth=1e-3):
    x = np.linspace(-4e-3, -3.4e-3, 4)
    return jnp.asarray(np.column_stack([x, 0 * x, 0 * x - depth]))


@functools.cache
def path_feed():
    x = np.linspace(0, 4e-3, 9)
    path = dt.Path.upright(4e-3 * np.arange(9.0), np.column_stack([x, x**2, 0 * x]))
    turned = np.column_stack([np.cos(50 * x), np.sin(50 * x), 0 * x])
    path = dataclasses.replace(path, tool_x=turned)
    return dt.PathFeed.of_path(path)


class Delayed(eqx.Module):
    """A plant that is pushed aside."""

    push: Any

    def __call__(self, command):
        return dc.Motion(command + self.push * jnp.tanh(command), 1e3 * command)


def late(parameters, command):
    del parameters
    return Delayed(jnp.asarray(1e-3))(command)


@functools.cache
def problem():
    x = np.linspace(0, 20e-3, 40)
    path = np.column_stack([x, 2 * x**2, 0 * x])
    return as_arrays(
        dc.Problem(Delayed(jnp.asarray(1e-3)), path, path, np.ones(40), 4e-3)
    )


@functools.cache
def spline():
    return dc.SplineOffsets(40, 4e-3, 20e-3)


def coefficients(size=1e-5):
    return rows(spline().coefficient_count, 3, size=size)


def residual():
    fit = dc.residual(problem(), knot_spacing=20e-3)
    return Call(lambda args, x: fit.cost(x, args), fit.args, (coefficients(0.1),))


def cut(known, path):
    """Return the forces along a path; what cuts is sampled as of a known mill."""
    sampling = pr.choose_engagement(block(), mill(), axial_depth=1e-3, angles=24)
    stock, cutter, law = known
    run = ds.simulate_process(path, stock, cutter, law, SPEED, engagement=sampling)
    return run.force


@functools.cache
def slides(folder):
    """A job of three slides and a helical cutter, in its precision."""
    file = write_slides_job(folder, 'knot_spacing = "10 ms"', program=CUT)
    text = file.read_text()
    file.write_text(text.replace("teeth = 2", 'teeth = 2\nhelix_angle = "30 deg"'))
    return dm.load_job(file).with_precision()


def with_law(job, K_tc):
    return eqx.tree_at(lambda j: j.law.K_tc, job, K_tc)


def tips(job):
    return jnp.asarray(job.path.positions)


def plant(job):
    return dc.TipPlant(job, pr.ThroughPoses())


def offsets(job):
    """The corrections of a job as pure functions, without a run beforehand."""
    positions = np.asarray(job.path.positions)
    weights, step = np.ones(len(positions)), float(job.tooth_period)
    own = dc.Problem(plant(job), positions, positions, weights, step)
    fit = dc.residual(own, knot_spacing=10e-3)
    return Call(lambda args, x: fit.motion(x, args), fit.args, (fit.start,))


def model(job):
    adjoint = pr.ThroughPoses()
    motors = ds.JobKinematics(job).motors(tips(job)).positions
    run = lambda model, motors: model.run(motors).force
    return Call(run, ds.MachiningProblem.of(job, adjoint), (motors,))


# Calls of a few seconds; a name is that of the function, a note may follow it.
CALLS: dict[str, Callable[[], Call]] = {
    "numerics.clamp": lambda: Call(
        lambda low, x: nm.clamp(low, x, 0.7), jnp.asarray(-0.7), (rows(5),)
    ),
    "numerics.hat_integral": lambda: Call(
        lambda _, x: nm.hat_integral(x), None, (rows(5),)
    ),
    "numerics.ramp": lambda: Call(
        lambda width, x: nm.ramp(x, width), jnp.asarray(0.5), (rows(5),)
    ),
    "numerics.materialise": lambda: Call(
        lambda _, x: nm.materialise(x), None, (rows(5),)
    ),
    "numerics.as_scalar_code": lambda: Call(
        lambda a, x: nm.as_scalar_code(lambda a, x: jnp.sin(a * x))(a, x),
        jnp.asarray(0.5),
        (rows(4),),
        has_slopes=False,
    ),
    "numerics.batched_in_turn": lambda: Call(
        lambda a, x: nm.batched_in_turn(lambda a, x: jnp.sin(a * x))(a, x),
        jnp.asarray(0.5),
        (rows(4),),
    ),
    "numerics.small_inverse": lambda: Call(
        lambda _, A: nm.small_inverse(A @ A.T + jnp.eye(3)), None, (rows(3, 3),)
    ),
    "numerics.with_derivative_of": lambda: Call(
        lambda x0, x: nm.with_derivative_of(jnp.sin(x0), jnp.sin, x),
        rows(5),
        (rows(5),),
    ),
    "numerics.Rematerialised.of": lambda: Call(
        lambda a, x: nm.Rematerialised.of(lambda: jnp.sin(a * x))(), rows(4), (rows(4),)
    ),
    "numerics.Rematerialised.read": lambda: Call(
        lambda _, x: nm.Rematerialised.read(x), None, (rows(4),)
    ),
    "cutter.flat_end_mill": lambda: Call(
        lambda _, D, helix, runout, dish: cutter.flat_end_mill(
            D, 2, helix, nominal_diameter=10e-3, runout=runout, dish_angle=dish
        ).elements(2, 0, 2, 1e-3, D.dtype),
        None,
        along(10e-3, HELIX, 10e-6, 0.02),
    ),
    "cutter.ball_end_mill": lambda: Call(
        lambda _, D, helix, runout: cutter.ball_end_mill(
            D, 2, helix, nominal_diameter=10e-3, runout=runout
        ).elements(0, 3, 2, 1e-3, D.dtype),
        None,
        along(10e-3, HELIX, 10e-6),
    ),
    "cutter.bull_nose": lambda: Call(
        lambda _, D, corner, helix, pitch: cutter.bull_nose(
            D,
            2,
            corner,
            helix,
            nominal_diameter=10e-3,
            nominal_corner_radius=2e-3,
            pitch=pitch,
        ).elements(1, 2, 2, 1e-3, D.dtype),
        None,
        along(10e-3, 2e-3, HELIX, [3.0, 2 * math.pi - 3.0]),
    ),
    "cutter.EndMill.level": lambda: Call(
        lambda mill, p, tip, axis: mill.level(p, tip, axis),
        bull(),
        (rows(4, 3, size=8e-3), rows(1, 3, size=1e-3), along([[0.0, 0.6, 0.8]])[0]),
    ),
    "cutter.EndMill.normal": lambda: Call(
        lambda mill, p, tip, axis: mill.normal(p, tip, axis),
        bull(),
        (rows(4, 3, size=8e-3), rows(1, 3, size=1e-3), along([[0.0, 0.6, 0.8]])[0]),
    ),
    "cutter.EndMill.intersect": lambda: Call(
        lambda mill, b, c, tip: mill.intersect(2, b, c, tip),
        bull(),
        (rows(4, size=4e-3), rows(4, size=3e-3), rows(1, 3, size=1e-3)),
    ),
    "cutter.EndMill.intersect_pose": lambda: Call(
        lambda mill, b, c, tip, axis: mill.intersect_pose(2, b, c, tip, axis),
        bull(),
        (
            rows(4, size=4e-3),
            rows(4, size=3e-3),
            rows(1, 3, size=1e-3),
            along([[0.0, 0.6, 0.8]])[0],
        ),
    ),
    "cutter.EndMill.wall_slopes": lambda: Call(
        lambda mill, end, across, tip: mill.wall_slopes(0, end, across, tip),
        mill(),
        (rows(4, size=5e-3), rows(4, size=3e-3), rows(1, 3, size=1e-3)),
    ),
    "cutter.EndMill.elements": lambda: Call(
        lambda mill, height: mill.elements(1, 2, 2, height, height.dtype),
        bull(),
        along(1e-3),
    ),
    "cutter.EndMill.runout_offsets": lambda: Call(
        lambda mill, lag: mill.runout_offsets(lag), bull(), (rows(3),)
    ),
    "cutter.AbstractCutter.edge_offsets": lambda: Call(
        lambda mill, height: mill.edge_offsets(height), bull(), (rows(3, size=1e-3),)
    ),
    "cutter.AbstractCutter.delays": lambda: Call(
        lambda mill, x: x * mill.delays(x.dtype)[0], bull(), along(1.0)
    ),
    "cutter.ToolHolder.depth_in_pieces": lambda: Call(
        lambda holder, b, c, pieces, tip: holder.depth_in_pieces(
            2, b, c, pieces, tip, jnp.asarray([0.0, 0.6, 0.8])
        ),
        holder(),
        (
            rows(4, size=5e-3),
            rows(4, size=5e-3),
            along([[0.0] * 4, [0.1] * 4])[0],
            rows(3, size=1e-3),
        ),
        False,
    ),
    "cutting.LinearEdgeLaw.force_per_width": lambda: Call(
        lambda law, h, touch: law.force_per_width(h, touch, jnp.zeros(4, jnp.int32)),
        as_arrays(PAPER_LAW),
        (jnp.abs(rows(4, size=1e-4)), jnp.abs(rows(4))),
    ),
    "cutting.KienzleLaw.force_per_width": lambda: Call(
        lambda law, h, touch: law.force_per_width(h, touch, jnp.zeros(4, jnp.int32)),
        as_arrays(cutting.KienzleLaw(1e9, 4e8, 1e8, 0.2, 0.3, 0.1)),
        (jnp.abs(rows(4, size=1e-4)), jnp.abs(rows(4))),
    ),
    "cutting.AbstractForceLaw.for_bottom": lambda: Call(
        lambda law, x: law.for_bottom().force_per_width(x, x, jnp.zeros(4, jnp.int32)),
        as_arrays(PAPER_LAW),
        (jnp.abs(rows(4, size=1e-4)),),
    ),
    "process.circle_chip": lambda: Call(
        lambda mill, offset, angle: pr.circle_chip(
            mill.diameter / 2, offset, angle, jnp.asarray(1e-3)
        ),
        mill(),
        (rows(3, size=1e-4), rows(4)),
    ),
    "process.edge_contact": lambda: Call(
        lambda _, chip, feed: pr.edge_contact(chip, feed, 0.05),
        None,
        (jnp.abs(rows(4)), jnp.asarray(1e-4)),
    ),
    "process.wall_shares": lambda: Call(
        lambda known, path: pr.wall_shares(path, None, *known),
        (mill(), block()),
        (pass_at(),),
        False,
    ),
    "process.feed_angles": lambda: Call(
        lambda before, path: pr.feed_angles(path, None, before),
        jnp.asarray(0.5),
        (pass_at(),),
        False,
    ),
    "process.wall_deviation": lambda: Call(
        lambda shares, ends, path: pr.wall_deviation(ends, path, shares),
        jnp.abs(rows(4)),
        (rows(4, 3, 3), rows(4, 3)),
    ),
    "robot.forward_kinematics": of_robot("forward_kinematics"),
    "robot.jacobian": of_robot("jacobian"),
    "robot.mass_matrix": of_robot("mass_matrix"),
    "robot.gravity_forces": of_robot("gravity_forces"),
    "robot.mechanical_energy": of_robot("mechanical_energy", rows(3), rows(3)),
    "robot.inverse_dynamics": of_robot("inverse_dynamics", rows(3), rows(3), rows(6)),
    "robot.forward_dynamics": of_robot("forward_dynamics", rows(3), rows(3), rows(6)),
    "robot.rnea_derivatives": of_robot(
        "rnea_derivatives", rows(3), rows(3), rows(6), has_slopes=False
    ),
    "robot.ArmTerms.of_state": lambda: Call(
        dr.ArmTerms.of_state, arm(), (jnp.asarray(Q), rows(3))
    ),
    "robot.ArmTerms.articulated_inverse": lambda: Call(
        dr.ArmTerms.articulated_inverse, arm(), (jnp.asarray(Q), jnp.abs(rows(3)))
    ),
    "robot.ArmTerms.augmented_inverse": lambda: Call(
        lambda robot, q: dr.ArmTerms.of_state(robot, q, q).augmented_inverse(q**2),
        arm(),
        (jnp.asarray(Q),),
    ),
    "robot.cartesian_compliance": of_robot("cartesian_compliance"),
    "robot.principal_stiffness": of_robot("principal_stiffness", has_slopes=False),
    "robot.static_deflection": of_robot("static_deflection", rows(6)),
    "robot.gravity_sag": of_robot("gravity_sag"),
    "robot.natural_frequencies": of_robot("natural_frequencies"),
    "robot.mode_shapes": of_robot("mode_shapes"),
    "robot.receptance": of_robot("receptance", along([10.0, 30.0])[0]),
    "robot.motor_positions": of_robot("motor_positions"),
    "robot.loaded_equilibrium": of_robot("loaded_equilibrium", rows(6, size=100.0)),
    "robot.NominalRobot.touch_off": lambda: Call(
        lambda known, K: known[0].touch_off(known[1].with_drives(stiffness=K)),
        (known_arm(), arm()),
        (jnp.asarray(arm().joint_stiffness),),
    ),
    "robot.placed_motors": lambda: Call(
        lambda _, rows: dr.placed_motors((0, -1, 1), rows), None, (rows(4, 2),)
    ),
    "robot.rotation_matrix": lambda: Call(
        lambda _, vector: dr.rotation_matrix(vector), None, (rows(3),)
    ),
    "robot.singularity": of_robot("singularity", has_slopes=False),
    "robot.inverse_kinematics": lambda: Call(
        lambda robot, q: (
            dr.inverse_kinematics(
                robot, dr.forward_kinematics(robot, q), Q, attempts=1
            ).q
        ),
        arm(),
        (jnp.asarray(Q + 0.01),),
    ),
    "robot.inverse_kinematics_path": lambda: Call(
        lambda robot, q: (
            dr.inverse_kinematics_path(
                robot,
                jax.vmap(lambda q: dr.forward_kinematics(robot, q))(q),
                Q,
                attempts=1,
            ).q
        ),
        arm(),
        (jnp.asarray(Q + np.array([[0.01], [0.02]])),),
    ),
    "robot.Robot.gear_torque": lambda: Call(
        lambda robot, y, rate: robot.gear_torque(y, rate), arm(), (rows(3), rows(3))
    ),
    "robot.Robot.drive_deflection": lambda: Call(
        lambda robot, torque: robot.drive_deflection(torque), arm(), (rows(3),)
    ),
    "robot.Robot.backlash_deflection": lambda: Call(
        lambda robot, y: robot.with_backlash(jnp.full(3, 1e-3)).backlash_deflection(y),
        arm(),
        (rows(3, size=1e-2),),
    ),
    "robot.Robot.with_backlash": lambda: Call(
        lambda robot, gap: robot.with_backlash(gap).drive_deflection(gap),
        arm(),
        (jnp.abs(rows(3, size=1e-3)),),
    ),
    "robot.Robot.with_friction": lambda: Call(
        lambda robot, x: robot.with_friction(x, x, x).friction_torque(x),
        arm(),
        (jnp.abs(rows(3)),),
    ),
    "robot.Robot.friction_torque": lambda: Call(
        lambda robot, v: robot.with_friction(*[jnp.full(3, 2.0)] * 3).friction_torque(
            v
        ),
        arm(),
        (rows(3),),
    ),
    "robot.Robot.with_motors": lambda: Call(
        lambda robot, x: robot.with_motors(x, x, x).drive_deflection(x),
        arm(),
        (jnp.abs(rows(3)),),
    ),
    "robot.Robot.with_drives": lambda: Call(
        lambda robot, K: dr.cartesian_compliance(robot.with_drives(stiffness=K), Q),
        arm(),
        (1e5 + rows(3),),
    ),
    "robot.Robot.transmitted": lambda: Call(
        lambda robot, q: displaced(robot, rows(3, 3)).transmitted(q),
        arm(),
        (rows(3),),
    ),
    "robot.LinkErrors.applied_to": lambda: Call(
        lambda robot, d: dr.forward_kinematics(displaced(robot, d), Q),
        arm(),
        (rows(3, 3),),
    ),
    "robot.Robot.with_tool": lambda: Call(
        lambda robot, T: dr.forward_kinematics(robot.with_tool(T), Q),
        arm(),
        (jnp.asarray(POSE),),
    ),
    "robot.Robot.gravity_compensation": lambda: Call(
        lambda robot, G: robot.gravity_compensation(G), arm(), (rows(3),)
    ),
    "robot.Robot.servo_deflection": lambda: Call(
        lambda robot, x: robot.with_motors(*[jnp.ones(3)] * 3).servo_deflection(x),
        arm(),
        (rows(3),),
    ),
    "robot.Controller.motors": lambda: Call(
        lambda known, x: known.motors(x, 4e-3),
        dr.Controller(dead_time=2e-3, bandwidth=jnp.full(3, 20.0)),
        (rows(6, 3),),
    ),
    "robot.Controller.respond": lambda: Call(
        lambda known, x: known.respond(x, 4e-3),
        dr.Controller(moving_average=6e-3),
        (rows(6, 3),),
    ),
    "robot.BendingTool.tip_spring": lambda: Call(
        lambda _, length: bending(length).tip_spring(length.dtype), None, along(0.06)
    ),
    "robot.BendingTool.mounted_on": lambda: Call(
        lambda robot, length: dr.mass_matrix(
            bending(length).mounted_on(robot), np.append(Q, [0.0, 0.0])
        ),
        arm(),
        along(0.06),
    ),
    "robot.FlangeSpring.mounted_on": lambda: Call(
        lambda robot, mass: dr.mass_matrix(
            dr.FlangeSpring(
                mass,
                (0.0, 0.0, 0.1),
                (0.1, 0.1, 0.05),
                rotary_stiffness=(2e6, 3e6, 4e6),
                is_in_link=False,
            ).mounted_on(robot),
            np.append(Q, [0.0, 0.0, 0.0]),
        ),
        arm(),
        along(5.0),
    ),
    "robot.Skeleton.of_robot": lambda: Call(
        dr.Skeleton.of_robot, arm(), (jnp.asarray(Q),), False
    ),
    "robot.TipModes.receptance": lambda: Call(
        lambda modes, f: modes.receptance(f),
        dr.TipModes.of_robot(arm(), Q, POSE),
        (along([12.0, 33.0])[0],),
    ),
    "toolpath.PathFeed.tool_x": lambda: Call(
        lambda feed, x: feed.tool_x(x), path_feed(), (along([0.3, 2.4])[0],), False
    ),
    "toolpath.PathFeed.axes": lambda: Call(
        lambda feed, x: feed.axes(x), path_feed(), (along([0.3, 2.4])[0],), False
    ),
    "workpiece.Rays.lengths": lambda: Call(
        lambda stock: stock.families[2].lengths(), block(), (), False
    ),
    "workpiece.Rays.slots_in_use": lambda: Call(
        lambda stock: stock.families[2].slots_in_use(), block(), (), False
    ),
    "workpiece.Pose.frozen": lambda: Call(
        lambda _, x: wp.Pose(x).frozen().tip, None, (rows(3),), False
    ),
    "workpiece.Pose.repeated": lambda: Call(
        lambda _, x: wp.Pose(x).repeated(2, 2), None, (rows(3),)
    ),
    "workpiece.Pose.gather": lambda: Call(
        lambda at, x: wp.Pose(x).gather(at), jnp.asarray([2, 0]), (rows(3, 3),)
    ),
    "workpiece.Pose.with_rows": lambda: Call(
        lambda first, x, y: wp.Pose(x).with_rows(first, wp.Pose(y)),
        jnp.asarray(1),
        (rows(4, 3), rows(2, 3)),
    ),
    "workpiece.occupancy_in_space": lambda: Call(
        lambda known, points: wp.occupancy_in_space(
            known[0], points, 1e-4 * jnp.ones((2, 3, 3)), 1e-3, known[1]
        ),
        (block(), bull()),
        (along([[2e-3, 1e-3, -0.2e-3], [3e-3, 2e-3, -1e-3]])[0],),
        False,
    ),
    "sim.ArmState.steady": lambda: Call(
        lambda robot, q: ds.ArmState.steady(robot, q, q), arm(), (jnp.asarray(Q),)
    ),
    "sim.free_motion": lambda: Call(
        lambda robot, q: ds.free_motion(
            robot, ds.ArmState.steady(robot, q + 0.01, 0 * q), q, 1e-3, 4
        ),
        arm(),
        (jnp.asarray(Q),),
    ),
    "sim.simulate_process": lambda: Call(
        cut, (block(), mill(), as_arrays(PAPER_LAW)), (pass_at(),)
    ),
    "toolpath.contour_error": lambda: Call(
        lambda desired, actual: dt.contour_error(actual, desired),
        problem().desired,
        (problem().desired + rows(40, 3, size=1e-5),),
    ),
    "toolpath.contour_vector": lambda: Call(
        lambda desired, actual: dt.contour_vector(actual, desired),
        problem().desired,
        (problem().desired + rows(40, 3, size=1e-5),),
    ),
    "toolpath.PathFeed.instants": lambda: Call(
        lambda feed, x: feed.instants(x), path_feed(), (1 + rows(3, size=0.2),)
    ),
    "toolpath.PathFeed.places": lambda: Call(
        lambda feed, x: feed.places(x, 9), path_feed(), (1 + rows(3, size=0.2),)
    ),
    "toolpath.PathFeed.positions": lambda: Call(
        lambda feed, x: feed.positions(x), path_feed(), (along([0.3, 2.4])[0],)
    ),
    "workpiece.Stock.volume": lambda: Call(
        lambda stock, x: x * stock.volume(), block(), along(1.0)
    ),
    "workpiece.Stock.volumes": lambda: Call(
        lambda stock, x: x * stock.volumes(), block(), along(1.0)
    ),
    "workpiece.Stock.slots_in_use": lambda: Call(
        lambda stock: stock.slots_in_use(), block(), (), False
    ),
    "workpiece.Stock.astype": lambda: Call(
        lambda stock: stock.astype(jnp.dtype("float32")), block(), (), False
    ),
    "workpiece.Discs.centers": lambda: Call(
        lambda discs, x: x * discs.centers(x.dtype)[0],
        wp.Discs(3, 1e-3, 1e-3),
        along(1.0),
    ),
    "workpiece.Discs.filled_below": lambda: Call(
        lambda discs, x: discs.filled_below(x),
        wp.Discs(3, 1e-3, 1e-3),
        (jnp.abs(rows(2, 1, 4, size=1.3e-3)),),
    ),
    "workpiece.Pose.along": lambda: Call(
        lambda axes, tips: wp.Pose.along(tips, axes), rows(4, 3), (rows(4, 3),)
    ),
    "workpiece.Pose.direction": lambda: Call(
        lambda _, tips: wp.Pose.along(tips, None).direction(), None, (rows(4, 3),)
    ),
    "workpiece.Pose.frame": lambda: Call(
        lambda _, axis: wp.Pose.frame(axis / jnp.linalg.norm(axis)), None, (rows(3),)
    ),
    "workpiece.RemovalWindow.remove_poses": lambda: Call(
        lambda known, tip: (
            wp.RemovalWindow.upright(block(), mill(), 1e-3, 1e-3)
            .remove_poses(
                known[0],
                known[1],
                wp.Pose(tip),
                jnp.zeros(1, jnp.int32),
                jnp.ones(1, bool),
            )
            .volume
        ),
        (block(), mill()),
        (pass_at()[:1],),
        False,
    ),
    "correction.delayed": lambda: Call(
        lambda _, command, delay: dc.delayed(command, delay, 4e-3),
        None,
        (rows(6, 3), jnp.asarray(3e-3)),
    ),
    "correction.inverse_drive": lambda: Call(
        lambda robot, q, force: dc.inverse_drive(robot, q, force, 4e-3),
        arm(),
        (Q[None] + rows(5, 3, size=0.01), rows(5, 3, size=100.0)),
    ),
    "correction.Problem.contour": lambda: Call(
        lambda own, x: own.contour(dc.Motion(own.desired + x, x)),
        problem(),
        (rows(40, 3, size=1e-5),),
    ),
    "correction.PathObjective.errors": lambda: Call(
        lambda own, x: dc.PathObjective().errors(
            own, dc.Motion(own.desired + x, x), jnp.asarray(0.03)
        ),
        problem(),
        (rows(40, 3, size=1e-5),),
    ),
    "correction.Problem.run": lambda: Call(
        lambda own, x: own.run(x), problem(), (rows(40, 3, size=1e-3),)
    ),
    "correction.FeedProblem.prediction": lambda: Call(
        lambda feed, x: dc.FeedProblem(
            lambda tips, *turned: dc.Motion(tips + 1e-3 * jnp.tanh(tips), tips),
            feed,
            np.ones(9),
        ).prediction(x, 9),
        path_feed(),
        (1 + rows(3, size=0.2),),
        False,
    ),
    "correction.DelayedPlant.member": lambda: Call(
        lambda plant, x: plant.member(x)(rows(6, 3, size=1e-3)).actual,
        dc.DelayedPlant(late, rows(6, 3, size=1e-4), 4e-3),
        (jnp.asarray([1e-3]),),
    ),
    "correction.SplineOffsets.offsets": lambda: Call(
        lambda spline, x: spline.offsets(x), spline(), (coefficients(),)
    ),
    "correction.SplineOffsets.roughness": lambda: Call(
        lambda spline, x: spline.roughness(x), spline(), (coefficients(),)
    ),
    "correction.residual": residual,
}

# Calls of a job, which take long to compile: alone their traces are quick.
JOBS: dict[str, Callable[[dm.Job], Call]] = {
    "sim.simulate": lambda job: Call(
        lambda job, tips, K: (
            dm.simulate(with_law(job, K), commanded=tips, throw=False).force
        ),
        job,
        # The rigid cut of a job that is known would be run.
        (tips(job), jnp.asarray(9e8)),
    ),
    "sim.rigid_cut": lambda job: Call(
        lambda job, K: ds.rigid_cut(with_law(job, K), pr.ThroughRays()).force,
        job,
        along(9e8),
    ),
    "sim.MachiningProblem.run": model,
    "sim.JobKinematics.motors": lambda job: Call(
        lambda job, tips: ds.JobKinematics(job).motors(tips).positions,
        job,
        (tips(job),),
    ),
    "sim.JobKinematics.motor_positions_from_joints": lambda job: Call(
        lambda job, joints: ds.JobKinematics(job).motor_positions_from_joints(joints),
        job,
        (ds.JobKinematics(job).joints(tips(job))[0],),
    ),
    "sim.JobKinematics.joints": lambda job: Call(
        lambda job, tips: ds.JobKinematics(job).joints(tips)[0], job, (tips(job),)
    ),
    "sim.JobKinematics.poses": lambda job: Call(
        lambda job, tips: ds.JobKinematics(job).poses(tips), job, (tips(job),)
    ),
    "correction.TipPlant.motors": lambda job: Call(
        lambda plant, tips: plant.motors(tips), plant(job), (tips(job),)
    ),
    "correction.TipPlant.__call__": lambda job: Call(
        lambda plant, tips: plant(tips), plant(job), (tips(job),)
    ),
    "correction.residual of a job": offsets,
}


def floats(tree):
    """Return the leaves that may have a derivative, real and imaginary parts apart."""
    leaves = [jnp.asarray(x) for x in jax.tree.leaves(tree) if eqx.is_array_like(x)]
    parts = [
        p for x in leaves for p in ((x.real, x.imag) if x.dtype.kind == "c" else (x,))
    ]
    return [x for x in parts if x.dtype.kind == "f"]


def assert_alike(found, wanted):
    """Compare trees, numbers to rounding in the size of each array."""
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True)
    for one, other in pairs:
        one, other = np.asarray(one), np.asarray(other)
        assert one.shape == other.shape and one.dtype == other.dtype
        size = np.max(np.abs(other[np.isfinite(other)]), initial=0)
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9 * float(size))


def check_compiled(call):
    """Compare a call with one whose arguments are traced, all or the arrays alone."""
    eager = call.function(call.known, *call.arrays)
    assert_alike(eqx.filter_jit(call.function)(call.known, *call.arrays), eager)


def check_around_known(call):
    """Trace a call by its arrays alone: what is known is a constant of the trace."""
    run = lambda *arrays: eqx.filter(call.function(call.known, *arrays), eqx.is_array)
    assert jax.tree.leaves(jax.eval_shape(run, *call.arrays))


def check_slopes(call):
    """Hold forward and reverse mode against each other, none of them compiled."""

    def cost(*arrays):
        parts = floats(call.function(call.known, *arrays))
        # Numbers of all units count.
        scales = [
            1 / (jnp.max(jnp.abs(jax.lax.stop_gradient(x))) + 1e-12) for x in parts
        ]
        return sum(
            jnp.sum(scale * x * rows(*x.shape).astype(x.dtype))
            for scale, x in zip(scales, parts, strict=True)
        )

    changes = [rows(*x.shape) * (jnp.abs(x) + 1e-9) for x in call.arrays]
    _, forward = jax.jvp(cost, call.arrays, tuple(changes))
    gradients = jax.grad(cost, argnums=tuple(range(len(changes))))(*call.arrays)
    terms = [float(jnp.sum(g * x)) for g, x in zip(gradients, changes, strict=True)]
    size = sum(abs(x) for x in terms)
    assert np.all(np.isfinite(terms))
    assert float(forward) == pytest.approx(sum(terms), rel=1e-6, abs=1e-8 * size)


# Names, or patterns of them, of what takes long to compile.
LONG = (
    "correction.inverse_drive",
    "robot.BendingTool.mounted_on",
    "robot.FlangeSpring.mounted_on",
    "robot.forward_dynamics",
    "robot.inverse_kinematics*",
    "robot.mode_shapes",
    "robot.receptance",
    "robot.rnea_derivatives",
    "robot.static_deflection",
    "robot.TipModes.receptance",
    "sim.free_motion",
    "sim.simulate_process",
    "workpiece.RemovalWindow.remove_poses",
    "workpiece.occupancy_in_space",
)
LONG_SLOPES = (*LONG, "robot.[a-z]*", "robot.ArmTerms.*", "toolpath.contour_*")


def marked(long):
    """Return the names of all calls, those that take long as slow tests."""
    is_slow = lambda name: any(fnmatch.fnmatchcase(name, some) for some in long)
    slow = lambda name: pytest.param(name, marks=pytest.mark.slow)
    return [slow(name) if is_slow(name) else name for name in CALLS]


@pytest.mark.parametrize("name", marked(LONG))
def test_compiled_functions_return_what_they_do_by_themselves(name):
    check_compiled(CALLS[name]())


@pytest.mark.parametrize("name", CALLS)
def test_what_is_known_may_stand_in_a_trace(name):
    check_around_known(CALLS[name]())


def test_sizes_of_a_cutter_that_are_known_may_stand_in_a_trace():
    helix, runout, limit = along(HELIX, 10e-6, 1.2)

    def run(height):
        mill = cutter.bull_nose(10e-3, 2, 2e-3, helix, runout=runout)
        assert mill.has_helix and mill.has_runout
        return mill.elements(1, 2, 2, height, height.dtype, limit)

    assert_alike(jax.jit(run)(*along(1e-3)), run(*along(1e-3)))


@pytest.mark.slow
def test_forces_of_a_helix_that_is_traced_are_those_of_the_known_one():
    def force(helix):
        mill = cutter.flat_end_mill(10e-3, 2, helix)
        run = ds.simulate_process(pass_at(), block(), mill, PAPER_LAW, SPEED, angles=24)
        return run.force

    known = np.asarray(force(HELIX))
    np.testing.assert_allclose(jax.jit(force)(HELIX), known, atol=1e-3 * known.max())


@pytest.mark.parametrize("name", marked(LONG_SLOPES))
def test_slopes_need_no_compiler(name):
    call = CALLS[name]()
    if call.has_slopes:
        check_slopes(call)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return slides(tmp_path_factory.mktemp("slides"))


@pytest.mark.parametrize("name", JOBS)
def test_a_job_that_is_known_may_stand_in_a_trace(name, job):
    check_around_known(JOBS[name](job))


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
def test_compiled_functions_of_a_job_return_what_they_do_by_themselves(name, job):
    check_compiled(JOBS[name](job))


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
def test_slopes_of_a_job_need_no_compiler(name, job):
    check_slopes(JOBS[name](job))


# Why a public function is in neither table; names may be patterns.
LEFT_OUT = {
    "reads or writes files and texts": (
        "campaign.*",
        "config.*",
        "examples.*",
        "io.*",
        "units.*",
        "cutting.material*",
        "robot.built_in_models",
        "robot.drive_classes",
        "robot.load",
        "robot.spindle_note",
        "use_compile_cache",
        "workpiece.from_mesh",
        "workpiece.load_stock",
        "workpiece.save",
        "*.to_data*",
    ),
    "draws, or prepares what is drawn": ("viz.*", "sim.Replay.*"),
    "takes a job, and decides by what its runs return": (
        "correction.correct",
        "correction.Correction.*",
        "correction.feed_tradeoff",
        "correction.fastest_feed",
        "correction.place_workpiece",
        "correction.SegmentRows.*",
        "correction.tune_feed",
        "correction.JointLimits.*",
        "correction.TipPlant.run",
        "correction.TipPlant.linearised",
        "learning.*",
        "sim.drawn_machine",
        "sim.TrueErrors.*",
        "sim.DrivenRun.*",
        "sim.error_band",
        "sim.mismatch",
        "sim.simulate_with_slot_growth",
        "sim.sensitivity",
        "sim.stability",
        "sim.Stability.*",
        "sim.stability_lobes",
        "sim.StabilityLobes.*",
        "sim.ToolContacts.along",
        "sim.Solution.raise_unless_successful",
        "sim.stack",
        "Job.*",
    ),
    "looks for a command on the host, run by run": (
        "correction.Adam.__call__",
        "correction.Ensemble.*",
        "correction.FeedPoint.curve",
        "correction.FeedProblem.smoothed",
        "correction.GaussNewton.*",
        "correction.GivenCommand.__call__",
        "correction.*Mirror.__call__",
        "correction.DelayedPlant.with_delays",
        "correction.LinearLimits.*",
        "correction.PathParts.*",
        "correction.RecedingHorizon.*",
        "correction.SplineOffsets.fit",
        "correction.SplineOffsets.normal_band",
        "correction.SplineOffsets.window",
        "correction.*.for_step",
        "correction.project",
        "correction.row_weights",
        "correction.shaped",
        "optimise.*",
    ),
    "holds a surface against poses: host, but for errors in a loop of the optimiser": (
        "correction.FinishedSurface.*",
        "correction.SurfaceBounds.*",
        "correction.SurfaceObjective.errors",
    ),
    "measured records and their fits, in NumPy": ("identification.*",),
    "an interface; what implements it is called": (
        "correction.Abstract*",
        "cutter.AbstractCutter.elements",
        "cutter.AbstractCutter.intersect*",
        "cutter.AbstractCutter.level",
        "cutter.AbstractCutter.normal",
        "cutter.AbstractCutter.runout_offsets",
        "cutter.AbstractCutter.w*",
        "cutting.AbstractForceLaw.force_per_width",
        "process.Abstract*",
        "sim.AbstractMachine.*",
    ),
    "makes or describes a model, in Python": (
        "cutter.EndMill.with_sizes_as_leaves",
        "cutter.ToolHolder.feet",
        "cutter.ToolHolder.from_sizes",
        "process.choose_engagement",
        "process.default_element_height",
        "process.Immersion.*",
        "robot.NominalRobot.motor_places",
        "robot.NominalRobot.probe_errors",
        "robot.Robot.ancestry",
        "robot.Robot.light_joints",
        "robot.Robot.*_mask",
        "robot.StiffnessMap.*",
        "robot.TipModes.of_robot",
        "robot.build",
        "robot.LinkErrors.none",
        "robot.LinkErrors.with_more_joints",
        "robot.rpy_*",
        "sim.MachiningProblem.of",
        "sim.MachiningProblem.padded",
        "sim.mismatched",
        "toolpath.BlockEnds.*",
        "toolpath.ContourStatistics.of",
        "toolpath.Move.*",
        "toolpath.Path.*",
        "toolpath.PathFeed.cycle_time",
        "toolpath.PathFeed.of_path",
        "toolpath.PathFeed.row_count",
        "toolpath.Program*",
        "toolpath.TimedProgram.*",
        "toolpath.TimingLimits.check",
        "toolpath.reduce_path",
        "toolpath.retime",
        "toolpath.sample_program",
        "workpiece.Mesh.*",
        "workpiece.RemovalWindow.tilted",
        "workpiece.RemovalWindow.reach",
        "workpiece.RemovalWindow.upright",
        "workpiece.Stock.as_raw",
        "workpiece.Stock.ray_ends",
        "workpiece.Stock.memory_of_block",
        "workpiece.Stock.memory_with",
        "workpiece.Stock.to_mesh",
        "workpiece.Stock.with_interval_counts",
        "workpiece.StockPieces.*",
        "workpiece.SurfaceError.*",
        "workpiece.box",
    ),
    "a search, a filter or a cache of programs on the host": (
        "numerics.CachedJit.*",
        "numerics.lowpass",
        "robot.configurations",
        "robot.damped_modes",
        "robot.path_starts",
        "robot.Controller.span",
    ),
    "a part of what a run or a controller does, which is called as a whole": (
        "correction.ScaledPlant.member",
        "process.EdgeElementsInSpace.*",
        "process.EdgeSamples.at",
        "process.Process.*",
        "process.ProcessState.ended",
        "process.RemovedVolume.*",
        "process.FrozenStock.*",
        "process.Through*",
        "robot.Controller.begin",
        "robot.Controller.follow",
        "workpiece.CutInterval.is_apart",
        "workpiece.CutInterval.joined",
        "workpiece.CutInterval.none",
        "workpiece.RemovalWindow.remove_together",
        "sim.ElasticArm.*",
        "sim.JobKinematics.motor_slopes",
        "sim.JobKinematics.solve",
        "sim.JobKinematics.tool_command",
        "sim.LinearRun.*",
        "sim.Run.*",
        "sim.Midpoint.*",
        "sim.ModalMachine.*",
        "sim.QuasiStaticArm.*",
        "sim.RungeKutta4.*",
        "sim.Solution.of_command",
        "sim.drive_torques",
        "sim.linearise",
        "workpiece.CutInterval.subtract_from",
        "workpiece.Discs.occupancy",
        "workpiece.PoseTrack.*",
        "workpiece.Rays.ends_at",
        "workpiece.Rays.numbered",
        "workpiece.Rays.places",
        "workpiece.RemovalWindow.remove_passes",
        "workpiece.RemovedPieces.of_pass",
        "workpiece.ToothPass.*",
    ),
    "a type": ("robot.ToolRotation", "toolpath.Point"),
}


def public_functions():
    """Yield the names of all public functions, and of the methods of classes."""
    modules = {}
    for area in dir(dm):
        part = getattr(dm, area)
        is_ours = inspect.ismodule(part) and part.__name__ == f"diffmill.{area}"
        if is_ours and not area.startswith("_"):
            modules[area] = part
    known = []
    for area, part in modules.items():
        for name in dir(part):
            found = getattr(part, name)
            is_public = not (name.startswith("_") or inspect.ismodule(found))
            # Commands, and the modules of settings, which know no JAX.
            if is_public and area not in ("cli", "settings"):
                known.append(found)
                yield from of_object(f"{area}.{name}", found)
    for name in dir(dm):
        found = getattr(dm, name)
        is_new = not any(found is one for one in known)
        if not (name.startswith("_") or inspect.ismodule(found)) and is_new:
            yield from of_object(name, found)


def of_object(name, found):
    """Yield the name of a function, or those of the methods of a class."""
    if not inspect.isclass(found):
        if callable(found):
            yield name
        return
    for own, value in list(vars(found).items()):
        is_public = not own.startswith("_") or own == "__call__"
        is_method = callable(getattr(found, own)) and not inspect.isclass(value)
        if is_public and is_method and own not in getattr(found, "__annotations__", ()):
            yield f"{name}.{own}"


def test_every_public_function_is_called_here_or_left_out_for_a_reason():
    called = {name.partition(" ")[0] for name in [*CALLS, *JOBS]}
    public = set(public_functions())
    patterns = [pattern for some in LEFT_OUT.values() for pattern in some]
    is_left_out = lambda name: any(fnmatch.fnmatchcase(name, p) for p in patterns)
    assert not called - public
    assert not {name for name in called if is_left_out(name)}
    unused = [p for p in patterns if not fnmatch.filter(public, p)]
    assert not unused
    assert not sorted(name for name in public - called if not is_left_out(name))
