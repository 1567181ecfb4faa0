"""Several jobs in one program: `vmap` and `lax.map` against call after call."""

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from timing import alternate

JOBS = 16
RUNS = 3
# Time of a batch over that of its elements in turn, to reach.
OVER_MAP = 1.1
# Depth of the stock and spacing of its rays [m], angles, and sub-steps.
SIZES = ((1e-3, 0.5e-3, 64, 4), (1e-3, 0.2e-3, 180, 8), (4e-3, 0.2e-3, 180, 8))


def measure(report):
    """Time a process alone with sixteen feeds, in one batch and in turn."""
    report.say(
        "depth mm, spacing mm, angles: time over that of one call after the other"
    )
    for depth, spacing, angles, substeps in SIZES:
        by_vmap, by_map = over_calls(depth, spacing, angles, substeps)
        report.say(
            f"{1e3 * depth:.1f}, {1e3 * spacing:.1f}, {angles:3d}: "
            f"vmap {by_vmap:.2f}, lax.map {by_map:.2f}"
        )
        report.figure("vmap over lax.map", by_vmap / by_map, OVER_MAP, "x")


def over_calls(depth, spacing, angles, substeps):
    """Return the time of slots by `vmap`, and by `lax.map`, over that of calls."""
    cutter = dm.cutter.flat_end_mill(10e-3, 2)
    law = dm.cutting.LinearEdgeLaw(K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6)
    stock = dm.workpiece.box([0, 0, -depth - 1e-3], [12e-3, 12e-3, 0], spacing)
    plan = dm.process.choose_engagement(
        stock, cutter, axial_depth=depth, angles=angles, substeps=substeps
    )

    def force(feed):
        x = -5e-3 + feed * jnp.arange(60)
        tips = jnp.stack([x, jnp.full(60, 6e-3), jnp.full(60, -depth)], axis=1)
        return dm.sim.simulate_process(
            tips, stock, cutter, law, 838.0, engagement=plan
        ).force

    feeds = np.linspace(0.1e-3, 0.2e-3, JOBS)
    one, many = jax.jit(force), jax.jit(jax.vmap(force))
    mapped = jax.jit(lambda feeds: jax.lax.map(force, feeds))
    batch, turn, calls = alternate(
        RUNS,
        lambda: many(feeds),
        lambda: mapped(feeds),
        lambda: [one(feed) for feed in feeds],
    )
    return batch / calls, turn / calls
