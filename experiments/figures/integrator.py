"""The robot's integrator: one mode, the free arm, the headline at half the sub-step."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from shared import LAW, TOOTH_PERIOD, Report, example_job

FREQUENCY, RATIO, MASS = 10.0, 0.02, 80.0
PERIODS = 15
# Sub-steps of a tooth period that `choose_engagement` and the example choose.
SUBSTEPS = 8


def measure(report: Report) -> None:
    """Measure one mode and the effect of the sub-step on the small example."""
    frequency, ratio = ring_down()
    report.say()
    report.say(f"Ring-down of one mode of {FREQUENCY:g} Hz, damping {100 * RATIO:g} %,")
    report.say("default sub-steps, fitted over 15 periods by linear prediction")
    report.say(f"  found {frequency:.4f} Hz, {100 * ratio:.4f} %")
    report.figure("frequency off", 100 * abs(frequency / FREQUENCY - 1), 0.5)
    report.figure("damping off", 100 * abs(ratio / RATIO - 1), 5.0)
    step = TOOTH_PERIOD / SUBSTEPS
    shift = (2 * math.pi * FREQUENCY * step) ** 2 / 12
    report.say(f"  frequency lowered by {100 * (1 - frequency / FREQUENCY):.4f} %;")
    report.say(f"  the midpoint rule's (omega h)^2 / 12 is {100 * shift:.4f} %")
    report.say(f"  damping added: {100 * (ratio - RATIO):.4f} % of the critical")
    report.say()
    undamped(report)
    report.say()
    job = example_job("paper_small")
    found = {}
    for factor in (1, 2):
        changed = with_substeps(job, factor * job.simulation.substeps)
        found[factor] = headline(changed)
        report.say(
            f"  paper_small, {changed.simulation.substeps:2d} sub-steps, "
            f"{changed.simulation.angles} angles: contour error "
            f"{1e6 * found[factor]:.3f} um rms"
        )
    change = 100 * abs(found[2] / found[1] - 1)
    report.figure("halving the sub-step changes the rms contour error by", change, 1.0)


def undamped(report: Report) -> None:
    """Say how much energy the undamped arm of the paper loses in 10 s."""
    arm = dm.robot.load("reis_rv130_like")
    arm = arm.with_drives(damping=np.zeros(arm.joint_count))
    lowest = float(dm.robot.natural_frequencies(arm, arm.home)[0])
    report.say("Energy of the undamped arm, released 1 mrad off in every joint, 10 s,")
    report.say(f"{SUBSTEPS} sub-steps; lowest mode {lowest:.1f} Hz")
    for held, what, bound in (
        (1, "terms of every step's middle", 0.1),
        (SUBSTEPS, "terms held for a tooth period, as in the coupled step", 0.1),
    ):
        drift = energy_drift(arm, held)
        report.figure(f"energy drift, {what}", 100 * drift, bound)
        # Energy falls as exp(-2 zeta omega t).
        ratio = drift / (2 * 2 * math.pi * lowest * 10)
        report.say(f"    like {100 * ratio:.5f} % damping of the lowest mode")


def energy_drift(arm: dm.robot.Robot, held: int) -> float:
    """Return the largest change of the swinging arm's energy in 10 s, as a share."""
    theta = dm.robot.motor_positions(arm, arm.home)
    step = TOOTH_PERIOD / SUBSTEPS
    rows = round(10 / step) // held
    start = dm.sim.ArmState(arm.home + 1e-3, jnp.zeros(arm.joint_count))
    motion = jax.jit(
        lambda s: dm.sim.free_motion(arm, s, theta, step, rows, held=held)
    )(start)
    energy = jax.vmap(lambda q, v: dm.robot.mechanical_energy(arm, q, v, theta))(
        motion.joint_positions, motion.joint_velocities
    )
    rest = np.zeros(arm.joint_count)
    swinging = energy - dm.robot.mechanical_energy(arm, arm.home, rest, theta)
    return float(jnp.max(jnp.abs(swinging / swinging[0] - 1)))


def ring_down() -> tuple[float, float]:
    """Return frequency [Hz] and damping ratio of a slide after a step of its motor."""
    omega = 2 * math.pi * FREQUENCY
    slide = dm.robot.PrismaticJoint(
        "slide",
        axis=(1, 0, 0),
        stiffness=MASS * omega**2,
        damping=2 * RATIO * omega * MASS,
    )
    body = dm.robot.RigidBody(MASS, (0.0, 0.0, 0.0), np.eye(3))
    robot = dm.robot.build([slide, body, dm.robot.Tool("tool")])
    mill = dm.cutter.flat_end_mill(10e-3, 2)
    # A block far below the tip: the tool is in the air.
    air = dm.workpiece.box([0, 0, -1.0], [5e-3, 5e-3, -0.99], 1e-3)
    plan = dm.process.choose_engagement(air, mill, axial_depth=1e-3)
    theta = np.full((round(PERIODS / FREQUENCY / TOOTH_PERIOD), 1), 1e-3)
    theta[0] = 0.0

    process = dm.process.Process(air, mill, LAW, math.pi / TOOTH_PERIOD, plan)
    arm = dm.sim.ElasticArm(robot, np.eye(4))

    @jax.jit
    def run(motors):
        return arm.run(process, motors).actual[:, 0]

    x = np.asarray(run(jnp.asarray(theta)))[2:] - 1e-3
    # x[k+2] = a x[k+1] + b x[k] holds exactly for one mode; its roots are the poles.
    (a, b), *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:], rcond=None)
    pole = np.log(np.roots([1, -a, -b]).astype(complex)[0]) / TOOTH_PERIOD
    return abs(pole) / (2 * math.pi), -pole.real / abs(pole)


def with_substeps(job: dm.Job, substeps: int) -> dm.Job:
    """Return a job with another number of sub-steps and angles that fit it."""
    block = job.cutter.flute_count * substeps
    settings = dataclasses.replace(
        job.simulation,
        substeps=substeps,
        angles=block * math.ceil(job.simulation.angles / block),
    )
    return eqx.tree_at(lambda j: j.simulation, job, settings)


def headline(job: dm.Job) -> float:
    """Return the rms contour error over the rows that cut [m]."""
    return dm.simulate(job, adjoint=dm.process.ThroughPoses()).contour.rms
