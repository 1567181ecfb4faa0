"""The coupled step against the cut itself, its gradient, and what that keeps.

Rows of the small example where it cuts. A step is one tooth period: times faster means
over the time that the period takes on the machine.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from equinox import tree_at

from diffmill import process, sim
from example import load_example
from timing import alternate

FIRST, ROWS, RUNS = 200, 300, 5
# Time of a step to reach [us].
MICROSECONDS = {"float64": 140, "float32": 110}


def measure(report):
    """Time runs in both precisions, and a gradient beside its run."""
    with jax.enable_x64(True):
        coupled(report, example_rows("float64"), has_gradient=True)
    with jax.enable_x64(False):
        coupled(report, example_rows("float32"))


def example_rows(precision):
    """Return the small example with some of its rows, in a precision."""
    job = load_example("paper_small")
    rows = jax.tree.map(lambda x: np.asarray(x)[FIRST : FIRST + ROWS], job.path)
    job = tree_at(lambda j: j.path, job, rows)
    settings = replace(job.simulation, precision=precision)
    return replace(job, simulation=settings).with_precision()


def coupled(report, job, *, has_gradient=False):
    """Print the time of a coupled step in a job's precision, and of its gradient."""
    precision = job.simulation.precision
    # As `simulate` runs it where nothing is differentiated.
    model = sim.MachiningProblem.of(job, process.FrozenStock())
    machine, cut = model.machine, model.process
    assert machine is not None
    motors = sim.JobKinematics(job).motors(jnp.asarray(job.path.positions))[0]
    run = jax.jit(lambda x: machine.run(cut, x).ends)
    tied = sim.MachiningProblem.of(job, process.ThroughPoses()).process
    if not has_gradient:
        (forward,) = alternate(RUNS, lambda: run(motors))
    else:
        loss = lambda x: 1e6 * jnp.sum((machine.run(tied, x).ends[:, -1]) ** 2)
        compiled = jax.jit(jax.grad(loss)).lower(motors).compile()
        forward, back = alternate(RUNS, lambda: run(motors), lambda: compiled(motors))
        analysis = compiled.memory_analysis()
        assert analysis is not None
        memory = analysis.temp_size_in_bytes * 1000 / ROWS
        report.figure("gradient over a run", back / forward, 2.5, "x")
        report.figure("memory of a gradient per 1000 rows", memory / 2**20, 60, "MiB")
    step = forward / (ROWS - 1)
    faster = float(job.tooth_period) / step
    report.say(f"  {faster:.0f} times faster than the cut, {precision}")
    report.figure(
        f"coupled step, {precision}", 1e6 * step, MICROSECONDS[precision], "us"
    )
