"""Speed of the dynamics beside other programs, of a six-joint arm in one run."""

import os

import jax
import numpy as np

import diffmill.robot as dr
from arm import sdf_of, serial_arm, urdf_of
from clock import in_turn
from ours import BATCHES, Job, our_jobs
from peers import jaxsim_jobs, mjx_jobs, mujoco_jobs, pinocchio_jobs
from reporting import Report, relative

jax.config.update("jax_enable_x64", True)

ROWS = (
    "mass matrix",
    "forward dynamics",
    "its derivatives",
    "rollout, a step",
    "with its gradient",
    *(f"batch of {batch}" for batch in BATCHES),
)


def measure(report: Report) -> None:
    """Print microseconds per evaluation, and the times to compile."""
    robot = serial_arm(6)
    urdf = urdf_of(robot)
    _check_the_arm(report, robot, urdf)
    programs: dict[str, dict[str, Job] | None] = {
        "diffmill crba": our_jobs(robot, "crba"),
        "diffmill aba": our_jobs(robot, "aba"),
        "pinocchio": pinocchio_jobs(urdf, 6),
        "mujoco": mujoco_jobs(urdf, 6),
        "mjx": mjx_jobs(urdf, 6),
        "jaxsim": jaxsim_jobs(sdf_of(robot)),
    }
    for name, jobs in programs.items():
        if jobs is None:
            report.say(f"{name}: not installed")
    there = {name: jobs for name, jobs in programs.items() if jobs is not None}
    # One row after the other, so that programs of one row share the machine's mood.
    found: dict[tuple[str, str], float] = {}
    for row in ROWS:
        runs = {name: jobs[row][0] for name, jobs in there.items() if row in jobs}
        for name, seconds in in_turn(runs).items():
            found[name, row] = seconds / there[name][row][1]
    report.say(
        "microseconds per evaluation, float64; pinocchio and mujoco: a call from"
    )
    report.say(
        "Python (pinocchio's batches: its own loop on all cores); in JAX: inside a"
    )
    report.say("scan, and one call of `vmap` for a batch")
    report.say(f"{'':18}" + "".join(f"{name:>15}" for name in there))
    for row in ROWS:
        cells = [found.get((name, row)) for name in there]
        report.say(f"{row:18}" + "".join(_cell(c and c * 1e6) for c in cells))
    report.say("seconds to trace and compile")
    for row in ROWS:
        cells = [there[n][row][2] if row in there[n] else None for n in there]
        report.say(f"{row:18}" + "".join(_cell(c or None) for c in cells))
    _judge(report, found, there)


def _cell(value: float | None) -> str:
    return f"{'-':>15}" if value is None else f"{value:15.2f}"


def _check_the_arm(report: Report, robot: dr.Robot, urdf: str) -> None:
    """Say whether Pinocchio finds the same accelerations."""
    try:
        import pinocchio as pin
    except ModuleNotFoundError:
        return
    model = pin.buildModelFromXML(urdf)
    q, v, tau = np.random.default_rng(0).normal(size=(3, 6))
    wanted = pin.aba(model, model.createData(), q, v, tau)
    for algorithm in ("crba", "aba"):
        ours = dr.forward_dynamics(robot, q, v, tau, algorithm=algorithm)
        report.figure(
            f"accelerations against pinocchio, {algorithm}",
            relative(ours, wanted),
            1e-10,
            "",
        )


def _judge(
    report: Report,
    found: dict[tuple[str, str], float],
    there: dict[str, dict[str, Job]],
) -> None:
    """Set the figures beside their limits."""
    ours = lambda row: found["diffmill aba", row]
    report.figure(
        "forward dynamics in a scan", ours("forward dynamics") * 1e6, 3.5, "us"
    )
    ratio = ours("with its gradient") / ours("rollout, a step")
    report.figure("rollout with gradient over rollout", ratio, 4.0, "")
    for row in ("rollout, a step", "with its gradient"):
        report.figure(f"compile: {row}", there["diffmill aba"][row][2], 5.0, "s")
    for batch in (1024, 8192):
        rate = 1e-6 / ours(f"batch of {batch}")
        report.at_least(f"evaluations, batch of {batch}", rate, 1.0, "M/s")
        if ("pinocchio", f"batch of {batch}") in found:
            # As if its loop were as many times faster as there are cores.
            peer = found["pinocchio", f"batch of {batch}"] / (os.cpu_count() or 1)
            ratio = peer / ours(f"batch of {batch}")
            report.at_least(f"pinocchio on all cores over ours, {batch}", ratio, 1.0)
    for peer in ("mjx", "jaxsim"):
        if (peer, "forward dynamics") in found:
            ratio = found[peer, "forward dynamics"] / ours("forward dynamics")
            report.at_least(f"{peer} over ours, forward dynamics", ratio, 1.0)
