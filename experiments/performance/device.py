"""A batch of jobs on every device: time of a job, and what differs between devices.

A GPU takes as long for one job as for many, until its cores are busy: from which number
on a batch pays on it, one look at the table tells. On a machine without one, the
processor alone is measured.
"""

import dataclasses
import pathlib
import tempfile
import time

import jax
import numpy as np

import diffmill as dm
from diffmill.examples import copy_example

# Rows of the path, and jobs in a batch.
ROWS = 100
COUNTS = (1, 16, 256, 2048)
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
    report.say(f"{'device':>8}{'jobs':>7}{'compile s':>11}{'s':>9}{'ms per job':>12}")
    devices = dict.fromkeys([jax.devices("cpu")[0], jax.devices()[0]])
    first = {}
    for device in devices:
        for count in COUNTS:
            if device.platform == "cpu" and count > MOST_ON_CPU:
                break
            found, compiling, seconds = _timed(job, count, device)
            first[device.platform] = found
            report.say(
                f"{device.platform:>8}{count:7d}{compiling:11.1f}{seconds:9.2f}"
                f"{1e3 * seconds / count:12.2f}"
            )
    for platform, found in first.items():
        for name, rows, reference in zip(
            ("force", "deviation"), found, first["cpu"], strict=True
        ):
            apart = np.abs(rows - reference).max() / np.abs(reference).max()
            report.say(f"{platform}: {name} differs from the cpu's by {apart:.1e}")


def _timed(job, count, device):
    """Return the first job's force and deviation, and the seconds of the batch."""
    scales = np.linspace(1.0, 1.2, count)
    laws = [dataclasses.replace(job.law, K_tc=k * job.law.K_tc) for k in scales]
    jobs = dm.stack([dataclasses.replace(job, law=law) for law in laws])

    def run(job):
        solution = dm.simulate(job)
        return solution.force, solution.deviation

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
    return [np.asarray(rows)[0] for rows in found], compiling, float(np.median(times))
