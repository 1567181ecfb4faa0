"""Speed, memory and compile time of the example `paper`.

Absolute times belong to the machine and to what else it does; ratios come from runs
that alternate. Compile times are taken without a persistent cache.
"""

import dataclasses
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from shared import Report, example_job
from timing import alternate

RUNS = 3
STOCK_RUNS = 5


def measure(report: Report) -> None:
    """Measure the coupled run and its gradient, float64 and then float32."""
    report.say()
    report.say(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start")
    job = example_job("paper").with_precision()
    forward, backward, compile_times = compiled_pair(job)
    report.figure("compile time of the coupled simulation", compile_times[0], 10.0, "s")
    report.figure("compile time of its gradient", compile_times[1], 25.0, "s")
    _times(report, job, forward, backward)
    _memory(report, job, forward, backward)
    _copies(report, job, forward, backward)
    _areas(report)
    _cache(report)


def error_of(job: dm.Job, tips: jax.Array) -> jax.Array:
    """Return the mean square deviation of the tip from the desired path [m^2]."""
    motors, _ = dm.sim.JobKinematics(job).motors(tips)
    actual = (
        dm.sim.MachiningProblem.of(job, dm.process.ThroughPoses()).run(motors).actual
    )
    desired = jnp.asarray(job.path.positions)
    return jnp.mean(jnp.sum((actual - desired) ** 2, axis=1))


def compiled_pair(job: dm.Job) -> tuple:
    """Return simulation and gradient, compiled, and what that took [s]."""
    arrays, rest = eqx.partition(job, eqx.is_array)
    error = lambda a, p: error_of(eqx.combine(a, rest), p)
    tips = jnp.asarray(job.path.positions)
    programs, seconds = [], []
    for function in (error, jax.value_and_grad(error, argnums=1)):
        start = time.perf_counter()
        programs.append(jax.jit(function).lower(arrays, tips).compile())
        seconds.append(time.perf_counter() - start)
    return (*programs, seconds)


def _arguments(job: dm.Job) -> tuple:
    return eqx.filter(job, eqx.is_array), jnp.asarray(job.path.positions)


def _times(report: Report, job: dm.Job, forward: Callable, backward: Callable) -> None:
    arguments = _arguments(job)
    fast, slow = alternate(
        RUNS, lambda: forward(*arguments), lambda: backward(*arguments)
    )
    steps = job.path.step_count
    period = float(job.tooth_period)
    report.say()
    report.say(f"paper, float64: {steps} tooth periods of {1e6 * period:.0f} us")
    report.say(f"  coupled simulation {1e6 * fast / steps:8.0f} us per tooth period")
    report.say(f"  with its gradient  {1e6 * slow / steps:8.0f} us per tooth period")
    start = time.process_time()
    jax.block_until_ready(forward(*arguments))
    busy = time.process_time() - start
    report.say(
        f"  processor time of the simulation {1e6 * busy / steps:.0f} us per tooth "
        "period: less than the clock's where others hold the cores"
    )
    report.at_least("faster than the cut itself", steps * period / fast, 8.0, "x")
    report.figure("gradient over forward", slow / fast, 3.0, "x")


def _memory(report: Report, job: dm.Job, forward: Callable, backward: Callable) -> None:
    thousands = job.path.step_count / 1000
    report.say()
    report.say(f"  temporaries of the simulation: {_megabytes(forward):.0f} MB in all")
    report.figure(
        "gradient's memory per 1000 steps, float64",
        _megabytes(backward) / thousands,
        150.0,
        "MB",
    )
    single = with_settings(job, precision="float32").with_precision()
    _, small, _ = compiled_pair(single)
    report.figure(
        "gradient's memory per 1000 steps, float32",
        _megabytes(small) / thousands,
        80.0,
        "MB",
    )
    value, gradient = small(*_arguments(single))
    finite = bool(np.isfinite(value)) and bool(np.isfinite(gradient).all())
    report.require("float32 gradient is finite", finite)


def with_settings(job: dm.Job, **changes: object) -> dm.Job:
    """Return a job with other numerical settings."""
    settings = dataclasses.replace(job.simulation, **changes)  # type: ignore[arg-type]
    return eqx.tree_at(lambda j: j.simulation, job, settings)


def _megabytes(program: Callable) -> float:
    return program.memory_analysis().temp_size_in_bytes / 1e6  # type: ignore[attr-defined]


def _copies(report: Report, job: dm.Job, *programs: Callable) -> None:
    """Look for copies of a family of rays in the loops of the compiled programs."""
    least = min(rays.ends.size for rays in job.stock.families)
    report.say()
    for name, program in zip(("forward", "reverse"), programs, strict=True):
        found = large_copies(program.as_text(), least)  # type: ignore[attr-defined]
        for line in found[:5]:
            report.say(f"    {line[:100]}")
        report.figure(
            f"copies of a whole family in the loops, {name}", len(found), 0, ""
        )


def large_copies(text: str, least: int) -> list[str]:
    """Return the copies of at least `least` numbers within loops of a program.

    Args:
        text: Optimised HLO.
        least: Numbers in the smallest array that counts.

    Returns:
        The lines of the copies; inside of a fusion nothing is a copy of its own.
    """
    bodies: dict[str, list[str]] = {}
    current = ""
    for line in text.splitlines():
        head = re.match(r"^(?:ENTRY )?%?([\w.\-]+) .*\{$", line)
        if head:
            current = head.group(1)
            bodies[current] = []
        elif current:
            bodies[current].append(line.strip())
    callee = (
        r"(?:body|condition|to_apply|true_computation|false_computation)=%?([\w.\-]+)"
    )
    several = r"branch_computations=\{([^}]*)\}"
    inside = {
        name
        for line in text.splitlines()
        for name in re.findall(r"body=%?([\w.\-]+)", line)
    }
    waiting = list(inside)
    while waiting:
        for line in bodies.get(waiting.pop(), []):
            names = re.findall(callee, line)
            if " call(" in line:
                names += re.findall(r"calls=%?([\w.\-]+)", line)
            for group in re.findall(several, line):
                names += [name.strip().lstrip("%") for name in group.split(",")]
            waiting += [name for name in names if name not in inside]
            inside.update(names)
    found = []
    for name in sorted(inside):
        for line in bodies.get(name, []):
            shape = re.search(r"= \(?\w+\[([\d,]*)\]", line)
            size = (
                int(np.prod([int(n) for n in shape.group(1).split(",") if n]))
                if shape
                else 0
            )
            is_copy = (
                " copy(" in line
                or " copy-start(" in line
                or "%copy" in line.split("=")[0]
            )
            if is_copy and size >= least:
                found.append(line)
    return found


def _areas(report: Report) -> None:
    """Compare the same path in a block and in one of 16 times its area."""
    job = example_job("paper_small").with_precision()
    lower, upper = np.array([0, 0, -6e-3]), np.array([42e-3, 17e-3, 0])
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    jobs = []
    for factor in (1.0, 4.0):
        # Air above the far parts of the large block, material under the path alike.
        reach = half * [factor, factor, 1.0]
        stock = dm.workpiece.box(middle - reach, middle + reach, job.stock.spacing)
        jobs.append(eqx.tree_at(lambda j: j.stock, job, stock))
    pairs = [compiled_pair(changed) for changed in jobs]
    arguments = [_arguments(changed) for changed in jobs]
    report.say()
    report.say("paper_small in a block of 42 x 17 mm and of 168 x 68 mm")
    for name, which in (("simulation", 0), ("gradient", 1)):
        small, large = alternate(
            STOCK_RUNS,
            *(
                lambda p=p[which], a=a: p(*a)
                for p, a in zip(pairs, arguments, strict=True)
            ),
        )
        steps = job.path.step_count
        report.say(
            f"  {name}: {1e6 * small / steps:.0f} and {1e6 * large / steps:.0f} us "
            "per tooth period"
        )
        report.figure(f"{name}: time for 16 times the area", large / small, 1.3, "x")


_SECOND_PROCESS = """
import json, sys, time
sys.path[:0] = [{here!r}, {common!r}]
import jax, jax.monitoring
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
events = []
jax.monitoring.register_event_listener(lambda name, **_: events.append(name))
import speed
from shared import example_job
import diffmill as dm
job = dm.sim.with_precision(example_job("paper_small"))
del events[:]
_, _, seconds = speed.compiled_pair(job)
print(json.dumps(dict(
    seconds=seconds,
    hits=sum(name.endswith("/cache_hits") for name in events),
    misses=sum(name.endswith("/cache_misses") for name in events),
)))
"""


def _cache(report: Report) -> None:
    """Compile in two processes that share a cache folder."""
    here = pathlib.Path(__file__).parent
    program = _SECOND_PROCESS.format(here=str(here), common=str(here.parent / "common"))
    report.say()
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": folder}
        found = []
        for name in ("first", "second"):
            ran = subprocess.run(
                [sys.executable, "-c", program],
                env=environment,
                capture_output=True,
                text=True,
                check=True,
            )
            answer = json.loads(ran.stdout.splitlines()[-1])
            found.append(answer)
            simulation, gradient = answer["seconds"]
            report.say(
                f"  {name} process: simulation {simulation:.1f} s, gradient "
                f"{gradient:.1f} s; {answer['hits']} found in the cache, "
                f"{answer['misses']} not"
            )
    second = found[1]
    report.require(
        "second process finds both in the persistent cache",
        second["hits"] >= 2 and second["misses"] == 0,
    )
