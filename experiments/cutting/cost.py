"""What a tool in space costs beside the upright flat one, in the coupled simulation."""

import dataclasses
import pathlib
import statistics
import tempfile
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill.examples import copy_example
from reporting import Report

jax.config.update("jax_enable_x64", True)

RUNS = 5


def measure(report: Report) -> None:
    """Time the small example with four tools, in runs that alternate."""
    with tempfile.TemporaryDirectory() as folder:
        job = dm.load_job(copy_example("paper_small", pathlib.Path(folder)))
    base = job.with_precision()
    diameter = 2 * job.cutter.nominal_radius
    teeth = job.cutter.flute_count
    ball = dm.cutter.ball_end_mill(diameter, teeth)
    tilt = ((0.0, 0.0, 1.0),)
    settings = dataclasses.replace(base.simulation, angles=96)
    tilting = dataclasses.replace(settings, axes=tilt)
    slots = base.stock.with_interval_counts((8, 8, 4))
    jobs = {
        "flat, upright": base,
        "ball, upright": changed(base, cutter=ball, simulation=settings),
        "flat, tilting": changed(base, simulation=tilting, stock=slots),
        "ball, tilting": changed(base, cutter=ball, simulation=tilting, stock=slots),
    }
    tips = jnp.asarray(base.path.positions)
    programs = {name: compiled(each, tips) for name, each in jobs.items()}
    seconds = {name: [] for name in jobs}
    for _ in range(RUNS):
        for name, run in programs.items():
            start = time.perf_counter()
            jax.block_until_ready(run(tips))
            seconds[name].append(time.perf_counter() - start)
    report.say()
    report.say(f"paper_small, {tips.shape[0]} tooth periods, coupled, float64")
    first = np.array(seconds["flat, upright"])
    for name, found in seconds.items():
        step = 1e6 * statistics.median(found) / tips.shape[0]
        report.say(f"  {name:16}{step:8.0f} us per tooth period")
        ratio = float(np.median(np.array(found) / first))
        if name != "flat, upright":
            report.figure(f"{name}: over the upright flat cutter", ratio, 2.5, "x")


def changed(job: dm.Job, **parts: object) -> dm.Job:
    """Return a job with other parts."""
    names = tuple(parts)
    return eqx.tree_at(
        lambda j: tuple(getattr(j, n) for n in names if n != "simulation"),
        dataclasses.replace(job, simulation=parts.get("simulation", job.simulation)),
        tuple(v for n, v in parts.items() if n != "simulation"),
        is_leaf=lambda x: x is None,
    )


def compiled(job: dm.Job, tips: jax.Array):
    """Return the coupled run of a job as a compiled function of its command."""

    def run(command: jax.Array) -> jax.Array:
        motors, _ = dm.sim.JobKinematics(job).motors(command)
        model = dm.sim.MachiningProblem.of(job, dm.process.ThroughPoses())
        return model.run(motors).actual

    return jax.jit(run).lower(tips).compile()
