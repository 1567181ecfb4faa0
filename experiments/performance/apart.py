"""Segments of a run that start from the stock of the rigid cut.

python experiments/performance/run.py apart

A segment that runs in parallel to the one before has to take what the rigid tool leaves
for its stock, and begins some rows early, at rest. Printed is how far the deviation in
its own rows is off that of the whole run.
"""

import pathlib
import tempfile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill import process as pr, sim
from long import write_job

jax.config.update("jax_enable_x64", True)

# Rows of the path and of a segment; rows by which one begins early.
ROWS, LENGTH, EARLY = 6144, 1024, (128, 512)
# Intervals that the rays need.
SLOTS = 6, 6, 2


def measure(report):
    """Print the error of segments that begin by so many rows early."""
    with tempfile.TemporaryDirectory() as folder:
        job = dm.load_job(write_job(pathlib.Path(folder), 8000)).with_precision()
    job = job.with_intervals(SLOTS)
    tips = np.asarray(job.path.positions)[:ROWS]
    motors = np.asarray(sim.JobKinematics(job).motors(jnp.asarray(tips))[0])
    model = sim.MachiningProblem.of(job, pr.FrozenStock())
    assert model.machine is not None
    run = model.machine.run
    arm = jax.jit(lambda process, x: run(process, x).actual)
    whole = np.asarray(arm(model.process, motors)) - tips
    size = np.percentile(np.linalg.norm(whole, axis=1), 95)
    for early in EARLY:
        off = []
        for start in range(LENGTH, ROWS, LENGTH):
            first, own = start - early, slice(start, start + LENGTH)
            process = with_rigid_cut(job, model.process, first + 1)
            found = np.asarray(arm(process, motors[first : own.stop]))[early:]
            off.append(np.linalg.norm(found - tips[own] - whole[own], axis=1))
        error = 100 * np.concatenate(off) / size
        report.say(
            f"begun {early} rows early: deviation off by "
            f"{np.sqrt(np.mean(error**2)):.1f} % rms, "
            f"{np.percentile(error, 99):.1f} % at 99 % of the rows"
        )


def with_rigid_cut(job, process, count):
    """Process with the stock that a rigid tool leaves on its first rows."""
    first = jax.tree.map(lambda rows: np.asarray(rows)[:count], job.path)
    cut = sim.rigid_cut(job.replace(path=first), pr.FrozenStock())
    return eqx.tree_at(lambda p: p.stock.families, process, cut.stock.families)
