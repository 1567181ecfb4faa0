"""What the linear run of a correction costs, and steps of Gauss-Newton with it.

The small example, and its first rows where exact derivatives, which take a run each,
are held beside it; times are those that one waits, in runs of the machine.
"""

import pathlib
import tempfile
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill import correction as co, process as pr, sim
from diffmill.optimise import LevenbergMarquardt
from reporting import Report

jax.config.update("jax_enable_x64", True)

ROWS, RUNS, STEPS = 300, 3, 4


class _AnyPlant(eqx.Module):
    """A plant of which only the run is known, so that its derivatives are exact."""

    plant: co.TipPlant

    def __call__(self, command: jax.Array) -> Any:
        return self.plant(command)


def measure(report: Report) -> None:
    """Print times of the linear run, its columns, and of steps of Gauss-Newton."""
    with tempfile.TemporaryDirectory() as folder:
        file = dm.examples.copy_example("paper_small", pathlib.Path(folder))
        job = dm.load_job(file).with_precision()
    whole = job
    first = jax.tree.map(lambda x: np.asarray(x)[:ROWS], job.path)
    job = eqx.tree_at(lambda j: j.path, job, first)
    tips = jnp.asarray(job.path.positions)
    motors = sim.JobKinematics(job).motors(tips)[0]
    model = sim.MachiningProblem.of(job, pr.FrozenStock())
    machine, process = model.machine, model.process
    assert machine is not None
    run = run_time(job)
    linearise = eqx.filter_jit(lambda x: sim.linearise(machine, process, x))
    report.say(f"a run of {ROWS} rows: {run:.3f} s")
    around = linearise(motors)
    report.say(f"linear run: {spent(lambda: linearise(motors)) / run:.1f} runs")
    moves = jnp.ones((*motors.shape, 96))
    move = eqx.filter_jit(lambda around, moves: around.move(moves).ends)
    columns = spent(lambda: move(around, moves))
    report.say(f"96 directions through it: {columns / run:.2f} runs")
    needed = sim.LinearRun.needed_bytes(machine, process, motors)
    held = sum(x.nbytes for x in jax.tree.leaves(around))
    report.say(f"memory: {needed / 1e6:.1f} MB foreseen, {held / 1e6:.1f} MB held")
    weights = eqx.filter_jit(lambda around, moves: around.move(moves))(around, moves)
    pull = eqx.filter_jit(lambda around, weights: around.pull(weights))
    rows = spent(lambda: pull(around, weights))
    report.say(f"96 directions back through it: {rows / run:.2f} runs")
    exactness(report, around, lambda x: machine.run(process, x), motors)
    problem = tip_problem(job)
    command = eqx.filter_jit(problem.plant)
    command_time = spent(lambda: command(tips).actual) / run
    report.say(
        f"a run of the job, with its inverse kinematics: {command_time:.2f} runs"
    )
    plant = co.TipPlant(job, pr.ThroughPoses())
    exact = eqx.tree_at(lambda p: p.plant, problem, _AnyPlant(plant))
    steps_of(report, f"{ROWS} rows, exact derivatives", exact, run)
    steps_of(report, f"{ROWS} rows, linear run", problem, run)
    all_rows = whole.path.step_count
    step = steps_of(
        report, f"{all_rows} rows, linear run", tip_problem(whole), run_time(whole)
    )
    report.figure("a step of Gauss-Newton", step, 4.5, "runs")


def exactness(
    report: Report,
    around: sim.LinearRun,
    run: Callable[[jax.Array], Any],
    motors: jax.Array,
) -> None:
    """Print how far products with the linear run are from exact derivatives."""
    of_run = lambda x: (run(x).ends, run(x).force)
    rng = np.random.default_rng(1)
    way = 1e-5 * _smooth(rng, motors.shape)
    weights = [_smooth(rng, x.shape) for x in (around.ends, around.force)]
    # Tips in micrometres and forces in newtons weigh alike.
    weights[0] *= 1e6

    @eqx.filter_jit
    def products(around: sim.LinearRun) -> tuple[list[jax.Array], list[jax.Array]]:
        moved = around.move(way[..., None])
        change = type(moved)(*(x[..., None] for x in weights))
        mine = [moved.ends[..., 0], moved.force[..., 0], around.pull(change)[0][..., 0]]
        _, pushed = jax.jvp(of_run, (motors,), (way,))
        pulled = jax.vjp(of_run, motors)[1](tuple(weights))
        return mine, [*pushed, *pulled]

    pairs = list(zip(*products(around), strict=True))
    names = ("tips forward", "forces forward", "back")
    for name, (mine, exact) in zip(names, pairs, strict=True):
        off = jnp.linalg.norm(mine - exact) / jnp.linalg.norm(exact)
        what = f"linear run off exact products, {name}"
        report.figure(what, float(off), 1e-6, "")


def _smooth(rng: np.random.Generator, shape: tuple[int, ...]) -> jax.Array:
    """Return a few waves over the rows, of random sizes."""
    time = np.linspace(0, 1, shape[0]).reshape(-1, *(1,) * (len(shape) - 1))
    waves = [np.sin(np.pi * k * time) * rng.normal(size=shape[1:]) for k in range(1, 5)]
    return jnp.asarray(sum(waves))


def tip_problem(job: dm.Job) -> co.Problem:
    """Return the correction of a job that is commanded by tips; all rows count."""
    tips = np.asarray(job.path.positions)
    return co.Problem(
        plant=co.TipPlant(job, pr.ThroughPoses()),
        nominal=tips,
        desired=tips,
        is_cutting=np.ones(len(tips)),
        time_step=float(job.tooth_period),
    )


def run_time(job: dm.Job) -> float:
    """Return how long the machine of a job runs [s]."""
    motors = sim.JobKinematics(job).motors(jnp.asarray(job.path.positions))[0]
    model = sim.MachiningProblem.of(job, pr.FrozenStock())
    machine = model.machine
    assert machine is not None
    forward = eqx.filter_jit(lambda x: machine.run(model.process, x).ends)
    return spent(lambda: forward(motors))


def steps_of(report: Report, name: str, problem: co.Problem, run: float) -> float:
    """Tell of some steps of Gauss-Newton; return the runs that one takes."""
    method = co.GaussNewton(
        solver=LevenbergMarquardt(max_steps=STEPS, damping=1e-4, cost_rtol=1e-2)
    )
    found, times = method(problem), []
    for _ in range(RUNS if isinstance(problem.plant, co.TipPlant) else 1):
        began = time.perf_counter()
        found = method(problem)
        times.append(time.perf_counter() - began)
    took, steps = min(times) / run, len(found.history)
    report.say(
        f"{name}: {steps} steps of Gauss-Newton in {took:.0f} runs, "
        f"{1e6 * found.measures.rms:.2f} um, {found.linearisations} linear systems, "
        f"{found.forward_runs} trials"
    )
    return took / steps


def spent(function: Callable[[], Any]) -> float:
    """Return the least time of a few calls after a first one [s]."""
    times = []
    for _ in range(RUNS + 1):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    return min(times[1:])
