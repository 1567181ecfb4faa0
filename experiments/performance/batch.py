"""Several jobs at once: `vmap` against one after the other, over the size of the job."""

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from timing import alternate

JOBS = 8
RUNS = 3
# Depth of the stock and spacing of its rays [m], angles, and sub-steps.
SIZES = ((1e-3, 0.5e-3, 64, 4), (1e-3, 0.2e-3, 180, 8), (4e-3, 0.2e-3, 180, 8))


def measure(report):
    """Time a process alone with eight feeds, in one batch and in turn."""
    cutter = dm.cutter.flat_end_mill(10e-3, 2)
    law = dm.cutting.LinearEdgeLaw(K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6)
    feeds = np.linspace(0.1e-3, 0.2e-3, JOBS)
    report.say(
        f"{'depth mm':>9} {'spacing mm':>11} {'angles':>7} {'batch / in turn':>16}"
    )
    for depth, spacing, angles, substeps in SIZES:
        stock = dm.workpiece.box([0, 0, -depth - 1e-3], [12e-3, 12e-3, 0], spacing)
        plan = dm.sim.process_plan(
            stock, cutter, axial_depth=depth, angles=angles, substeps=substeps
        )

        def forces(feed, stock=stock, plan=plan, depth=depth):
            x = -5e-3 + feed * jnp.arange(60)
            tips = jnp.stack([x, jnp.full(60, 6e-3), jnp.full(60, -depth)], axis=1)
            run = dm.sim.simulate_process(tips, stock, cutter, law, 838.0, plan=plan)
            return run.force

        one, many = jax.jit(forces), jax.jit(jax.vmap(forces))
        batch, turn = alternate(
            RUNS, lambda: many(feeds), lambda: [one(feed) for feed in feeds]
        )
        ratio = batch / turn
        report.say(
            f"{1e3 * depth:9.1f} {1e3 * spacing:11.2f} {angles:7d} {ratio:16.2f}"
        )
