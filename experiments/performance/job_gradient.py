"""Print the seconds that the gradient of a job's deviation takes.

python experiments/performance/job_gradient.py JOB

It is that of `simulate` as it stands, `ThroughRays`. Only names that every version has
are used, so that versions can be compared.
"""

import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp

import diffmill as dm


def main():
    """Time a call after the first."""
    jax.config.update("jax_enable_x64", True)
    job = dm.load_job(sys.argv[1])
    where = lambda job: job.path.positions

    @jax.jit
    @jax.grad
    def slope(positions):
        moved = eqx.tree_at(where, job, positions)
        return 1e6 * jnp.sum(dm.simulate(moved).deviation ** 2)

    positions = jnp.asarray(where(job))
    jax.block_until_ready(slope(positions))
    start = time.perf_counter()
    found = jax.block_until_ready(slope(positions))
    assert bool(jnp.isfinite(found).all())
    print(time.perf_counter() - start)


if __name__ == "__main__":
    main()
