"""A batch of jobs on every device: time of a job and of its gradient, and what differs.

A GPU takes as long for one job as for many, until its cores are busy: from which number
on a batch pays on it, one look at the table tells. On a machine without one, the
processor alone is measured.
"""

import dataclasses
import pathlib
import tempfile
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill.examples import copy_example

# Rows of the path, and jobs in a batch of runs and in one of gradients.
ROWS = 100
COUNTS = {"run": (1, 16, 256, 2048), "gradient": (1, 256)}
RUNS = 3
# So many jobs at once are too slow on a processor to wait for.
MOST_ON_CPU = 16


def measure(report):
    """Time batches of an elastic arm in the cut, and compare the first job."""
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(copy_example("paper_small", folder))
        job = dm.load_job(file)
    job = dataclasses.replace(job, path=jax.tree.map(lambda x: x[:ROWS], job.path))
    report.say(f"{ROWS} steps of `paper_small`, an elastic arm; vmap over the jobs")
    report.say(
        f"{'device':>8}{'what':>10}{'jobs':>6}{'compile s':>11}{'s':>8}{'ms each':>9}"
    )
    devices = dict.fromkeys([jax.devices("cpu")[0], jax.devices()[0]])
    for what, counts in COUNTS.items():
        first = {}
        for device in devices:
            for count in counts:
                if device.platform == "cpu" and count > MOST_ON_CPU:
                    break
                found, compiling, seconds = _timed(job, WHAT[what], count, device)
                first[device.platform] = found
                report.say(
                    f"{device.platform:>8}{what:>10}{count:6d}{compiling:11.1f}"
                    f"{seconds:8.2f}{1e3 * seconds / count:9.2f}"
                )
        for platform, found in first.items():
            for name, rows in found.items():
                reference = first["cpu"][name]
                apart = np.abs(rows - reference).max() / np.abs(reference).max()
                report.say(f"{platform}: {name} differs from the cpu's by {apart:.1e}")


def _run(job):
    """Return force and deviation of a job."""
    solution = dm.simulate(job)
    return {"force": solution.force, "deviation": solution.deviation}


def _gradient(job):
    """Return how the squared deviations [um^2] follow the path's points."""
    where = lambda job: job.path.positions

    def squares(positions):
        moved = eqx.tree_at(where, job, positions)
        return 1e12 * jnp.sum(dm.simulate(moved).deviation ** 2)

    return {"gradient": jax.grad(squares)(where(job))}


WHAT = {"run": _run, "gradient": _gradient}


def _timed(job, run, count, device):
    """Return what the first job gives, and the seconds of the batch."""
    scales = np.linspace(1.0, 1.2, count)
    laws = [dataclasses.replace(job.law, K_tc=k * job.law.K_tc) for k in scales]
    jobs = dm.stack([dataclasses.replace(job, law=law) for law in laws])

    with jax.default_device(device):
        jobs = jax.device_put(jobs, device)
        began = time.perf_counter()
        batch = jax.jit(jax.vmap(run)).lower(jobs).compile()
        compiling = time.perf_counter() - began
        found = jax.block_until_ready(batch(jobs))
        times = []
        for _ in range(RUNS):
            began = time.perf_counter()
            jax.block_until_ready(batch(jobs))
            times.append(time.perf_counter() - began)
    first = {name: np.asarray(rows)[0] for name, rows in found.items()}
    return first, compiling, float(np.median(times))
