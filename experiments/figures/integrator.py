"""The robot's integrator: one mode alone, and the headline at half the sub-step."""

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


def measure(report: Report) -> None:
    """Measure one mode and the effect of the sub-step on the small example."""
    frequency, ratio = ring_down()
    report.say()
    report.say(f"Ring-down of one mode of {FREQUENCY:g} Hz, damping {100 * RATIO:g} %,")
    report.say("default sub-steps, fitted over 15 periods by linear prediction")
    report.say(f"  found {frequency:.4f} Hz, {100 * ratio:.4f} %")
    report.figure("frequency off", 100 * abs(frequency / FREQUENCY - 1), 0.5)
    report.figure("damping off", 100 * abs(ratio / RATIO - 1), 5.0)
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
    plan = dm.sim.process_plan(air, mill, axial_depth=1e-3)
    theta = np.full((round(PERIODS / FREQUENCY / TOOTH_PERIOD), 1), 1e-3)
    theta[0] = 0.0

    @jax.jit
    def run(motors):
        return dm.sim.simulate_coupled(
            motors, robot, np.eye(4), air, mill, LAW, TOOTH_PERIOD, plan,
            dm.sim.Traced(),
        ).actual[:, 0]  # fmt: skip

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
    solution = dm.simulate(job, adjoint=dm.sim.Traced())
    error = np.asarray(solution.contour_error)[np.asarray(solution.is_cutting)]
    return float(np.sqrt(np.mean(error**2)))
