"""Arm and cut from one record of a robot that cuts, simulated with noise."""

import dataclasses
import math
import pathlib
import tempfile
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill import (
    cutter as ct,
    cutting,
    examples,
    identification,
    process as pr,
    robot as rb,
    sim,
    toolpath as tp,
    workpiece as wp,
)

SPEED = 8000 * 2 * math.pi / 60
PERIOD = math.pi / SPEED
STIFFNESS, MASS, ZETA = (1.5e6, 2.5e6, 1e6), 80.0, 0.08
LAW = cutting.LinearEdgeLaw(989.8e6, 337.3e6, 66.9e6, 3.0e3, 15.4e3, 4.5e3)
NOISE = 0.05
# Where the fits start, over the truth.
OFF = np.array([0.7, 1.6, 0.8, 2.0, 2.0, 1.5, 1.3, 0.8, 1.5, 0.7, 1.4, 2.0])


def slides():
    """Return three slides, the mass on the last."""
    joints = [
        rb.PrismaticJoint(
            name, tuple(axis), stiffness=K, damping=2 * ZETA * math.sqrt(K * MASS)
        )
        for name, axis, K in zip("xyz", np.eye(3), STIFFNESS, strict=True)
    ]
    return rb.build([*joints, rb.RigidBody(MASS, (0, 0, 0), np.eye(3))])


def corner(teeth, spacing, angles, substeps):
    """Return a slot along x, then along y, at three feeds each."""
    steps = np.repeat((0.05e-3, 0.15e-3, 0.3e-3), teeth)
    x = np.cumsum(np.concatenate([[0.0], steps, 0 * steps])) - 5.2e-3
    y = np.cumsum(np.concatenate([[0.0], 0 * steps, steps])) + 6e-3
    tips = np.column_stack([x, y, np.full(len(x), -2e-3)])
    with tempfile.TemporaryDirectory() as folder:
        file = examples.copy_example("paper_small", pathlib.Path(folder))
        example = dm.load_job(file)
    return dataclasses.replace(
        example,
        name="corner",
        cutter=ct.flat_end_mill(10e-3, 2, helix_angle=math.radians(30)),
        law=LAW,
        spindle_speed=SPEED,
        stock=wp.box([0, 0, -3e-3], [x[-1] + 6e-3, y[-1] + 6e-3, 0], spacing),
        path=tp.Path.upright(PERIOD * np.arange(len(x)), tips),
        robot=slides(),
        T_base_work=np.eye(4),
        joint_start=None,
        simulation=dataclasses.replace(
            example.simulation,
            angles=angles,
            substeps=substeps,
            element_height=0.3e-3,
            axial_depth=2.4e-3,
            plunges=False,
            has_bottom=False,
            axes=(),
            precision="float64",
        ),
    )


def with_factors(job, factors):
    """Return a job whose parameters are the truth's times factors."""
    log_scale = np.concatenate([np.log(factors), [0.0]])
    return job.with_precision().with_scaled(jnp.asarray(log_scale))


def noisy(values, draw):
    values = np.asarray(values)
    return values + NOISE * np.sqrt(np.mean(values**2)) * draw.normal(size=values.shape)


def show(report, what, fit, truth):
    """Print every parameter, and the largest error of those that are known."""
    report.say(f"{what}: {fit.simulations} simulations with derivatives")
    worst = 0.0
    for i, name in enumerate(fit.names):
        off = 100 * (math.exp(fit.log_scale[i]) * truth[name] - 1)
        error = 100 * math.sqrt(fit.covariance[i, i])
        known = fit.identifiable[name]
        worst = max(worst, abs(off)) if known else worst
        report.say(
            f"  {name:5} error {off:7.2f} %, standard error {error:6.2f} %, "
            f"{'known' if known else 'not identifiable'}"
        )
    for name, share in fit.explained.items():
        report.say(f"  share of the {name} explained: {share:.4f}")
    report.figure(f"{what}: largest error of what is known", worst, 5)
    known = sum(fit.identifiable.values())
    report.say(f"  known: {known} of {len(fit.names)}")


def measure(report):
    report.say("truth: rays 0.4 mm, 240 angles, 12 sub-steps; fit: 0.5 mm, 192, 8")
    report.say(f"noise: {100 * NOISE:g} % of the rms of force and of deviation")
    draw = np.random.default_rng(0)
    record = sim.simulate(corner(50, 0.4e-3, 240, 12))
    force, deviation = noisy(record.force, draw), noisy(record.deviation, draw)
    job = corner(50, 0.5e-3, 192, 8)
    start = with_factors(job, OFF)
    names = job.parameter_names[:-1]
    factors = dict(zip(names, OFF, strict=True))
    begun = time.perf_counter()
    fit = identification.fit_coupled(start, force=force, deviation=deviation)
    seconds = time.perf_counter() - begun
    report.say(f"{len(force)} tooth periods, {seconds:.0f} s, compilation included")
    show(report, "force and deviation", fit, factors)
    springs = with_factors(job, np.where(np.arange(12) < 6, OFF, 1.0))
    offset = np.array([2e-5, -3e-5, 1e-5])
    fit = identification.fit_coupled(
        springs, deviation=deviation + offset[None], has_offset=True
    )
    show(report, "deviation alone, law known, zero unknown", fit, factors)
    costs(report, start)


def costs(report, job):
    """Time derivatives by all parameters at once, one by one, and a gradient."""
    names = job.parameter_names
    motors, _ = sim.JobKinematics(job).motors(jnp.asarray(job.path.positions))

    def tips(x):
        full = jnp.concatenate([x, jnp.zeros(1)])
        scaled = job.with_scaled(full)
        return sim.MachiningProblem.of(scaled, pr.ThroughPoses()).run(motors).actual

    zero = jnp.zeros(len(names) - 1)
    first = zero.at[0].set(1.0)
    for what, f in (
        ("one simulation", tips),
        ("all columns at once", jax.jacfwd(tips)),
        ("one column", lambda x: jax.jvp(tips, (x,), (first,))[1]),
        ("one gradient, in reverse", jax.grad(lambda x: jnp.sum(tips(x) ** 2))),
    ):
        g = eqx.filter_jit(f)
        jax.block_until_ready(g(zero))
        begun = time.perf_counter()
        jax.block_until_ready(g(zero))
        report.say(f"  {what}: {time.perf_counter() - begun:.2f} s")
