"""From how many joints on articulated bodies are faster than composite bodies."""

import functools

import jax
import jax.numpy as jnp

import diffmill.robot as dr
from arm import serial_arm
from clock import compiled, in_turn
from reporting import Report, relative

jax.config.update("jax_enable_x64", True)

COUNTS = (2, 3, 4, 6, 8, 12, 16, 20, 30)
STEPS = 500


def measure(report: Report) -> None:
    """Print the time of one forward dynamics inside a scan, and the compile time."""
    report.say("one forward dynamics inside a scan, float64, medians in turn")
    report.say("joints   crba [us]   aba [us]   aba/crba   compile crba, aba [s]")
    slower = 0
    for count in COUNTS:
        robot = serial_arm(count)
        q = jnp.linspace(-0.5, 0.5, count)

        programs = {
            name: compiled(functools.partial(_run, name), robot, q)
            for name in ("crba", "aba")
        }
        ends = [program(robot, q)[1] for program, _ in programs.values()]
        assert relative(ends[1], ends[0]) < 1e-8, relative(ends[1], ends[0])
        jobs = {
            name: functools.partial(program, robot, q)
            for name, (program, _) in programs.items()
        }
        crba, aba = (t / STEPS * 1e6 for t in in_turn(jobs).values())
        spent = ", ".join(f"{seconds:.1f}" for _, seconds in programs.values())
        report.say(
            f"{count:6d} {crba:11.2f} {aba:10.2f} {aba / crba:10.2f}   {spent:>16}"
        )
        if aba >= crba:
            slower = count
    found = next((count for count in COUNTS if count > slower), None)
    report.say(f"aba is the faster from this number of joints on: {found}")


def _run(algorithm: str, robot: dr.Robot, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the state of a sprung arm after some steps."""

    def step(state, _):
        q, v = state
        a = dr.forward_dynamics(robot, q, v, -100 * q, algorithm=algorithm)
        v = v + 1e-5 * a
        return (q + 1e-5 * v, v), None

    return jax.lax.scan(step, (q, 0 * q), length=STEPS)[0]
