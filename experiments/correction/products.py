"""What a product with the Jacobian costs, in forward runs."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

import diffmill as dm
from diffmill import process as pr, sim
from diffmill.correction import StoredProducts
from part_jobs import part_job
from timing import alternate

RUNS = 5
PARTS = ("paper_small", "freeform")


def measure(report: Any) -> None:
    """Print times and memory of products that compute again and that keep slopes."""
    report.say("times in forward runs (medians, run in turn); memory per 1000 rows;")
    report.say("a step: a linearisation and 60 products")
    report.say(
        f"{'part':14}{'slopes':10}{'us a row':>9}{'linearise':>10}{'J v':>8}"
        f"{'J^T w':>8}{'a step':>8}{'MB':>8}"
    )
    for part in PARTS:
        job = sim.with_precision(part_job(part))
        costs = [_programs(job, keeps) for keeps in (False, True)]
        times = alternate(RUNS, *(f for functions, _ in costs for f in functions))
        run, count = times[0], job.path.step_count
        for k, name in enumerate(("again", "kept")):
            linearise, forward, transpose = (
                t / run for t in times[4 * k + 1 : 4 * k + 4]
            )
            total = linearise + 30 * (forward + transpose)
            memory = costs[k][1] / count / 1e3
            report.say(
                f"{part:14}{name:10}{1e6 * run / count:9.0f}{linearise:10.2f}"
                f"{forward:8.2f}{transpose:8.2f}{total:8.1f}{memory:8.0f}"
            )


def _residual(tips: jax.Array, args: tuple[dm.Job, pr.AbstractAdjoint]) -> jax.Array:
    job, adjoint = args
    motors, _ = sim.command_motors(job, tips)
    actual = sim.run_motors(job, motors, adjoint).actual
    return (actual - jnp.asarray(job.path.positions)).reshape(-1)


run = eqx.filter_jit(_residual)


def _programs(
    job: dm.Job, keeps_jacobian: bool
) -> tuple[list[Callable[[], Any]], float]:
    """Return what is to be timed, and the size of the linear program [byte]."""
    products, args = (
        StoredProducts(),
        (job, pr.ThroughPoses(keeps_jacobian=keeps_jacobian)),
    )
    tips = jnp.asarray(job.path.positions)
    residual, linear = products.linearise(_residual, tips, args)
    size = sum(x.nbytes for x in jax.tree.leaves(linear) if hasattr(x, "nbytes"))
    return [
        lambda: run(tips, args),
        lambda: products.linearise(_residual, tips, args),
        lambda: products.forward(linear, tips),
        lambda: products.transpose(linear, tips, residual),
    ], size
